import numpy as np
import pytest

from geoevs.detection.views import (
    ViewSettings,
    moved_rig,
    views_between,
    write_without_boxes,
)
from geoevs.methods.contract import Views
from geoevs.methods.tiny import tiny_camera, write_tiny_scene
from geoevs.scenes.scene import SceneExtras
from geoevs.scenes.sources.street.rig import MOUNTS, make_cameras
from geoevs.scenes.store import Scene


class Rig:
    """What `views_between` asks of a scene: one frame of some cameras."""

    frames = (0,)

    def __init__(self, cameras, front="front"):
        self._cameras = cameras
        self.cameras = tuple(cameras)
        self.info = type("Info", (), {"name": "rig", "rig": type("R", (), {"front": front})})

    def camera(self, name, frame):
        return self._cameras[name]


@pytest.fixture(scope="module")
def five():
    return Rig(make_cameras(np.eye(4), 64, 96))


def ring(*yaws):
    names = {yaw: f"c{yaw}" if yaw else "front" for yaw in yaws}
    return Rig({name: tiny_camera(name, yaw, np.zeros(3)) for yaw, name in names.items()})


def test_five_cameras_have_forty_views(five):
    targets = views_between(five, ViewSettings())
    assert len(targets) == 40
    assert len({target.key for target in targets}) == 40
    yaws = sorted({round(target.camera.yaw, 3) for target in targets})
    expected = [gap + share * 45 for gap in (-90, -45, 0, 45) for share in ViewSettings().shares]
    # Shares count from the neighbour nearer to the front.
    assert len(yaws) == 20
    np.testing.assert_allclose(yaws, sorted(expected), atol=0.05)


def test_a_view_by_hand(five):
    """Half-way between 45 and 90 degrees, 1 m to the left of the ego, not of the side camera."""
    targets = {target.camera.name: target for target in views_between(five, ViewSettings())}
    target = targets["front_left-side_left-0.5+1m"]
    middle = (np.array(MOUNTS["front_left"][1]) + np.array(MOUNTS["side_left"][1])) / 2
    np.testing.assert_allclose(target.camera.centre, middle + np.array([0, 1, 0]), atol=1e-12)
    assert target.camera.yaw == pytest.approx(67.5)
    assert (target.split, target.lateral_shift) == ("detection", 1.0)
    assert target.pose_offset == pytest.approx(67.5)
    assert not target.recorded


def test_a_full_ring_has_views_in_every_gap():
    targets = views_between(ring(0, 55, 110, 180, -110, -55), ViewSettings())
    assert len(targets) == 60
    assert any(target.camera.yaw == pytest.approx(145) for target in targets)
    assert any(target.camera.yaw == pytest.approx(-145) for target in targets)


@pytest.mark.parametrize(("yaws", "count"), [((0,), 0), ((0, 45), 10), ((0, 90, -90), 20)])
def test_any_number_of_cameras(yaws, count):
    assert len(views_between(ring(*yaws), ViewSettings())) == count


def test_the_whole_rig_moves_across_the_heading(five):
    targets = moved_rig(five, [-2.0, 1.0])
    assert len(targets) == 10
    for target in targets:
        name = target.camera.name.rpartition("-")[0] or target.camera.name.rpartition("+")[0]
        recorded = five.camera(name, 0)
        moved = target.camera.centre - recorded.centre
        np.testing.assert_allclose(moved, [0, target.lateral_shift, 0], atol=1e-12)
        np.testing.assert_allclose(target.camera.optical_axis, recorded.optical_axis, atol=1e-12)
    assert {target.lateral_shift for target in targets} == {-2.0, 1.0}


def test_no_box_reaches_a_method(tmp_path):
    plain = write_tiny_scene(tmp_path / "plain")
    synced = plain.tracks.assign(camera="front")
    scene = write_tiny_scene(tmp_path / "scene", extras=SceneExtras(synced_tracks=synced))
    write_without_boxes(tmp_path / "given", scene)
    given = Scene(tmp_path / "given")
    assert given.stamp == scene.stamp
    assert len(scene.tracks) == 2
    assert len(Views(given, given.cameras, ("lidar", "tracks")).tracks) == 0
    assert given.synced_tracks is None
    np.testing.assert_array_equal(given.image("front", 0), scene.image("front", 0))
    np.testing.assert_array_equal(given.points(1).xyz, scene.points(1).xyz)
    # Nothing of the scene's own store was changed.
    assert len(Scene(scene.folder).tracks) == 2
