"""The commands `new-source` and `check-source`, and the measurements that checks stand on."""

import importlib
import sys

import numpy as np
import pytest

import geoevs.scenes.sources
from geoevs.core.errors import GeoEvsError
from geoevs.core.images import read_image
from geoevs.scenes.boxes import Box
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import find_sources
from geoevs.source_check.edges import Profile, find_outlines, symmetric_shift
from geoevs.source_check.pictures import BOX, overlay
from geoevs.source_check.template import new_source
from geoevs.source_check.world import disagreement


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """An empty repository whose sources are found beside the real ones."""
    folder = tmp_path / "geoevs/scenes/sources"
    folder.mkdir(parents=True)
    paths = [*geoevs.scenes.sources.__path__, str(folder)]
    monkeypatch.setattr(geoevs.scenes.sources, "__path__", paths)
    importlib.invalidate_caches()
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("geoevs.scenes.sources.my_first")]:
        del sys.modules[name]


def test_a_new_source_passes_and_a_broken_one_does_not(repository, geoevs, tmp_path):
    written = new_source("my-first_data", repository)
    assert [str(path.relative_to(repository)) for path in written] == [
        "geoevs/scenes/sources/my_first_data/source.py",
        "geoevs/scenes/sources/my_first_data/__init__.py",
        "tests/scenes/test_my_first_data.py",
    ]
    assert "my-first-data" in find_sources()
    assert len(written[0].read_text().splitlines()) < 150
    size = ("--height", 60, "--width", 90, "--frames", 2)
    given = ("check-source", "my-first-data", "drive@2-3", *size, "--out", tmp_path / "pictures")
    code, text, errors = geoevs(*given)
    assert (code, errors) == (0, "")
    assert "✓ ok  reading: 2 frames of 3 cameras, " in text
    assert "✓ ok  boxes hold points: boxes hold " in text
    assert "– not checked  half a pixel: " in text
    for name in ("front", "front_left", "front_right"):
        assert read_image(tmp_path / f"pictures/{name}.png").shape == (60, 90, 3)
    code, text, _ = geoevs("check-source", "my-first-data", "drive@7-99")
    start = "✗ wrong  reading: my-first-data scene 'drive' has no frame 99; its frames are 0 to 11"
    assert (code, text) == (1, f"{start}, so choose a range of those\n")
    with pytest.raises(GeoEvsError, match="exists already"):
        new_source("my-first-data", repository)


@pytest.mark.parametrize("name", ["../evil", "a/b", "Upper", "1st", "", "class", "x.y", "-x"])
def test_illegal_names_are_refused(repository, name):
    with pytest.raises(GeoEvsError, match="name"):
        new_source(name, repository)
    assert not list((repository / "geoevs/scenes/sources").iterdir())


@pytest.mark.parametrize("name", ["street", "made-up"])
def test_taken_names_are_refused(repository, name):
    (repository / "geoevs/scenes/sources/made_up.py").write_text("")
    with pytest.raises(GeoEvsError, match="exists already"):
        new_source(name, repository)


def test_unknown_sources_and_options_are_named(geoevs):
    code, _, errors = geoevs("check-source", "strete", "curve-1")
    assert (code, "did you mean 'street'?" in errors) == (1, True)
    code, _, errors = geoevs("check-source", "street", "curve-1", "--options", '{"frame": 1}')
    assert (code, "has no option 'frame'; did you mean 'frames'?" in errors) == (1, True)
    code, text, _ = geoevs("check-source", "street", "curvy-1")
    assert (code, "wrong  reading: street scene 'curvy-1' is not of the form" in text) == (1, True)


def camera(width: int = 200, height: int = 100) -> Camera:
    """At the world's origin, looking along x, 100 pixels of focal length."""
    pose = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    K = [[100, 0, width / 2], [0, 100, height / 2], [0, 0, 1]]
    return Camera(K, pose, height, width, "front")


def test_outlines_are_where_a_near_thing_ends():
    # At 10 m a metre is 10 pixels: a plate from y = -1 to 1, with a wall at 20 m behind.
    y = np.linspace(-1, 1, 21)
    plate = np.stack([np.full(21, 10.0), y, np.zeros(21)], axis=1)
    wall = np.stack([np.full(41, 20.0), np.linspace(-8, 8, 41), np.zeros(41)], axis=1)
    wall = wall[np.abs(wall[:, 1]) > 2.1]  # hidden behind the plate
    outlines = find_outlines(np.concatenate([plate, wall]), camera(), axis=0)
    # y = 1 is left of the middle, at u = 100 - 10: there the plate begins.
    assert outlines.ends.tolist() == [False, True]
    np.testing.assert_allclose(outlines.uv, [[90, 50], [110, 50]], atol=1e-9)


@pytest.mark.parametrize("shift", [-1.25, 0.0, 0.5])
def test_the_shift_is_where_ends_mirror_beginnings(shift):
    places = np.arange(-24, 25) * 0.25

    def beside(x):  # lop-sided, with its peak 1.3 pixels beyond the outline
        return np.exp(-np.square(x - 1.3)) + 0.3 * (x < 0)

    profile = Profile(places, beside(shift - places), beside(places - shift), (1, 1))
    assert symmetric_shift(profile, 2.0) == pytest.approx(shift, abs=0.051)


def test_disagreement_is_the_motion_between_two_clouds():
    rng = np.random.default_rng(0)
    sides = []
    for axis, (low, high) in enumerate([(-12, 15), (-9, 8), (0, 6)]):
        for wall in (low, high):
            points = rng.uniform([-12, -9, 0], [15, 8, 6], (4000, 3))
            points[:, axis] = wall
            sides.append(points)
    room = np.concatenate(sides)
    angle = np.radians(2.0)
    cos, sin = np.cos(angle), np.sin(angle)
    turned = room @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]).T + (0.8, -0.3, 0)
    metres, degrees = disagreement(room, turned, np.zeros(3))
    # Undone by turning back after shifting back, so by as far at the world's origin.
    assert metres == pytest.approx(np.hypot(0.8, 0.3), abs=0.02)
    assert degrees == pytest.approx(2.0, abs=0.05)
    assert disagreement(room[::2], room[1::2], np.zeros(3))[0] < 0.02


def test_pictures_have_points_and_boxes():
    image = np.zeros((100, 200, 3), np.uint8)
    ahead = Box(0, "a", "car", 10, 0, 0, 2, 2, 2, 0.0, False)
    around = ahead._replace(x=0.0, length=4.0)  # half of it behind the camera
    near, far = overlay(image, camera(), np.array([[3.0, 1, 0], [60.0, -12, 0]]), [])[
        [50, 50], [66, 120]
    ]
    assert near[0] > near[2]  # red
    assert far[2] > far[0]  # blue
    drawn = overlay(image, camera(), np.zeros((0, 3)), [ahead])
    # The rear face at x = 9: its corner y = 1, z = 1 at u = 100 - 100 / 9, v = 50 - 100 / 9.
    assert (drawn[38:41, 88:91].max(axis=(0, 1)) > 200).all()
    assert BOX == (255, 255, 255)
    assert (overlay(image, camera(), np.zeros((0, 3)), [ahead._replace(x=-9.0)]) == 40).all()
    assert (overlay(image, camera(), np.zeros((0, 3)), [around]) != 40).any()
