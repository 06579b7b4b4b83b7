"""`check-source` passes the source that `new-source` writes, and finds what is planted there."""

import functools
import importlib.util

import pytest

from geoevs.scenes.sources import made_up
from geoevs.source_check import check
from geoevs.source_check.template import SOURCE

SIZE = made_up.HEIGHT, made_up.WIDTH


@pytest.fixture(scope="module", autouse=True)
def drawn_once():
    """The drive's images and sweeps, which all sources here share."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("image", "sweep"):
            patch.setattr(made_up, name, functools.cache(getattr(made_up, name)))
        yield


@pytest.fixture
def found(tmp_path, monkeypatch):
    """The findings of a template's source after some of its text was replaced."""

    def run(*replacements: tuple[str, str], frames: int = 4) -> dict[str, check.Finding]:
        text = SOURCE.format(name="planted")
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "planted.py"
        path.write_text(text)
        spec = importlib.util.spec_from_file_location("planted", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        make = lambda name, height, width, options: module.Source(height, width, **options)  # noqa: E731
        monkeypatch.setattr(check, "load_source", make)
        findings, _ = check.check_source("planted", "drive", {}, *SIZE, frames=frames)
        return {finding.name: finding for finding in findings}

    return run


def wrong(findings):
    return {name for name, finding in findings.items() if finding.status == "wrong"}


def test_the_template_is_right_in_all(found):
    findings = found(frames=12)
    assert {name: f.status for name, f in findings.items()} == dict.fromkeys(
        ("reading", *check.CHECKS), "ok"
    )


SWAP = '{"front_left": "front_right", "front_right": "front_left"}.get(name, name)'
PLANTED = {
    "axes": (("@ OPENCV_AXES", ""), "cameras", "likely: a camera's axes are x forward"),
    "axes of OpenGL": (
        ("@ OPENCV_AXES", "@ OPENCV_AXES @ np.diag([1, -1, -1, 1])"),
        "cameras",
        "likely: a camera's axes are OpenGL's",
    ),
    "camera's extrinsics inverted": (
        ("recording.mount(name)", "np.linalg.inv(recording.mount(name))"),
        "cameras",
        "is the left one but looks",
    ),
    "camera's pose inverted": (
        ("@ OPENCV_AXES\n", "@ OPENCV_AXES\n            pose = np.linalg.inv(pose)\n"),
        "cameras",
        "likely: the poses are camera from world",
    ),
    "LiDAR's extrinsics inverted": (
        ("recording.lidar_mount()", "np.linalg.inv(recording.lidar_mount())"),
        "edges",
        "LiDAR outlines",
    ),
    "width and length exchanged": (
        ('box["length"], box["width"]', 'box["width"], box["length"]'),
        "boxes hold points",
        "with length and width exchanged; correct it",
    ),
    "sides of images exchanged": (
        ("recording.image(frame, name)", f"recording.image(frame, {SWAP})"),
        "sides",
        "exchange the images",
    ),
    "sides of the rig exchanged": (
        ('"front_left", "front_right", lidar', '"front_right", "front_left", lidar'),
        "cameras",
        "is the right one but looks",
    ),
    "yaw in radians": (
        ('np.degrees(box["heading"]) + turned', 'box["heading"] + np.radians(turned)'),
        "boxes hold points",
        "with yaw taken for radians; correct it",
    ),
    "yaw in the vehicle's frame, reversed": (
        ('np.degrees(box["heading"]) + turned + 180', 'np.degrees(box["heading"]) + turned'),
        "boxes head along",
        "yaw points backward",
    ),
    "beams from the bottom": (
        ("beam = beams", "beam = recording.BEAMS - 1 - beams"),
        "beams",
        "count them from the top",
    ),
    "no beams": (
        ("beam = beams_by_elevation(points, recording.BEAMS)", "beam = np.zeros(len(points))"),
        "beams",
        "which score methods",
    ),
    "ego pose of the first frame": (
        ("recording.pose(frame)", "recording.pose(0)"),
        "ego pose",
        "take each frame's own ego pose",
    ),
    "ego pose of the frame before, for LiDAR alone": (
        ("_moved(ego @", "_moved(_ego(max(frame - 1, 0), origin) @"),
        "boxes hold points",
        "boxes hold",
    ),
    "nothing is marked as moving": (
        ("np.array(speeds) > MOVING_SPEED", "np.array(speeds) > 99"),
        "boxes head along",
        "call mark_moving",
    ),
    "milliseconds": (
        ("frame * recording.INTERVAL", "frame * recording.INTERVAL * 1000"),
        "times",
        "in seconds",
    ),
    "no origin subtracted": (
        ("scene_origin(recording.pose(frames[0])[:3, 3])", "(0.0, 0.0, 0.0)"),
        "reading",
        "is beyond 10 km",
    ),
}


@pytest.mark.parametrize("error", PLANTED)
def test_a_planted_error_is_found(found, error):
    replacement, line, cause = PLANTED[error]
    findings = found(replacement)
    assert line in wrong(findings), findings
    assert cause in findings[line].sentence


def test_half_a_pixel_is_found(found):
    findings = found(("/ 2 + 0.5", "/ 2"), frames=12)
    assert wrong(findings) == {"half a pixel"}
    assert findings["half a pixel"].sentence.startswith("edges lie +0.")
    assert "add 0.5 to cx and cy" in findings["half a pixel"].sentence


def test_what_cannot_be_checked_is_named(found):
    findings = found(("recording.sweep(frame)", "recording.sweep(frame)[:0]"), frames=1)
    statuses = {name: finding.status for name, finding in findings.items()}
    assert statuses == {
        **dict.fromkeys(check.CHECKS, "not checked"),
        **dict.fromkeys(("reading", "cameras", "origin", "boxes head along"), "ok"),
    }
    for name in ("beams", "support", "edges", "sides", "half a pixel", "boxes hold points"):
        assert findings[name].sentence == "there is no LiDAR; an import refuses such frames"
    assert findings["times"].sentence == "there is one frame only"


def test_few_outlines_cannot_tell_half_a_pixel(found):
    finding = found(("recording.sweep(frame)", "recording.sweep(frame)[::40]"))["half a pixel"]
    assert finding.status == "not checked"
    assert "read more frames" in finding.sentence


@pytest.mark.parametrize(
    ("replacement", "sentence"),
    [
        (("points = recording.sweep(frame)", "points = recording[frame]"), "TypeError: 'module' "),
        (("images[name] = ", "image = "), "frame 0 has no camera 'front'; supply it"),
        (("size = self.width, self.height", "size = 8, 8"), "'front' is uint8 of shape (8, 8, 3)"),
        (('"car", *centre', '7, *centre'), "the scene: 'label' of a box is no text"),
        (("range(self.frames)", "()"), "IndexError: list index out of range (at planted.py:"),
    ],
)  # fmt: skip
def test_a_source_that_cannot_be_read_is_one_line(found, replacement, sentence):
    findings = found(replacement)
    assert list(findings) == ["reading"]
    assert findings["reading"].status == "wrong"
    assert sentence in findings["reading"].sentence
    assert "\n" not in findings["reading"].sentence
