"""Points of SfM against a wall at x = 8 whose texture is known everywhere."""

import numpy as np
import pytest

from baselines.gaussians.sfm import _near_others, triangulate

ASIDE = [(0.0, 0.5 * frame, 1.6) for frame in range(4)]


@pytest.fixture(scope="module")
def wall_points(views_of_wall):
    return triangulate(views_of_wall(ASIDE))


def test_points_lie_on_the_wall_and_have_its_colours(views_of_wall, wall_points):
    xyz, rgb = wall_points
    assert len(xyz) > 100
    assert xyz.dtype == rgb.dtype == np.float32
    assert np.median(np.abs(xyz[:, 0] - 8)) < 0.02
    assert np.abs(xyz[:, 0] - 8).max() < 0.5
    # The front camera looks along x and sees 8 * 72 / 70 metres across; y falls with the column.
    views = views_of_wall(ASIDE)
    image = views.image("front", 0)
    columns = (36 - 70 * xyz[:, 1] / 8).astype(int)
    rows = (24 - 70 * (xyz[:, 2] - 1.6) / 8).astype(int)
    inside = (columns >= 0) & (columns < 72) & (rows >= 0) & (rows < 48)
    assert inside.mean() > 0.5
    errors = np.abs(image[rows[inside], columns[inside]] - rgb[inside])
    assert np.median(errors) < 0.03
    assert np.abs((rgb[inside] - image[rows[inside], columns[inside]]).mean()) < 0.01  # no bias


def test_the_same_views_give_the_same_bytes(views_of_wall, wall_points):
    for once, again in zip(wall_points, triangulate(views_of_wall(ASIDE)), strict=True):
        assert once.tobytes() == again.tobytes()


def test_two_images_are_enough_if_they_are_apart(views_of_wall):
    xyz, _ = triangulate(views_of_wall(ASIDE[:2]))
    assert len(xyz) > 50
    assert np.median(np.abs(xyz[:, 0] - 8)) < 0.05


@pytest.mark.parametrize(
    ("centres", "coloured"),
    [(ASIDE, False), (ASIDE[:1] * 3, True), (ASIDE[:1], True)],
    ids=["no features", "no motion", "one image"],
)
def test_nothing_found_is_no_points(views_of_wall, centres, coloured):
    xyz, rgb = triangulate(views_of_wall(centres, coloured))
    assert xyz.shape == rgb.shape == (0, 3)


def test_pycolmap_is_quiet(views_of_wall, capfd):
    triangulate(views_of_wall(ASIDE[:2]))
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_an_isolated_point_is_an_outlier():
    # Ten points a centimetre apart, and one a metre away, 5 m from the cameras: by 10 % of 5 m, it
    # is alone; at 50 m it would not be.
    xyz = np.zeros((11, 3))
    xyz[:, 0] = [*np.arange(10) * 0.01, 1.0]
    assert _near_others(xyz, np.full(11, 5.0)).tolist() == [True] * 10 + [False]
    assert _near_others(xyz, np.full(11, 50.0)).all()
