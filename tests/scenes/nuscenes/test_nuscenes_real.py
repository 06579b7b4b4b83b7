"""A real keyframe of nuScenes; these tests repeat the measurements that docs/nuscenes.md names."""

import json
from itertools import product

import numpy as np
import pytest

from geoevs.projection import colour_frame, zbuffer
from geoevs.protocol.reference import sparse_reference
from geoevs.protocol.targets import ALL_CAMERAS, Target
from geoevs.scenes.boxes import Box
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.nuscenes.instants import CAMERAS, LIDAR, read_recording
from geoevs.scenes.sources.nuscenes.source import Source
from geoevs.scenes.store import Scene
from tests.scenes.test_pandaset_real import half_way


@pytest.fixture(scope="module")
def real_frame(real_nuscenes):
    """The first keyframe of scene-0061 at the released size, and its record."""
    record = Source(900, 1600, folder=str(real_nuscenes)).open(SceneRef("scene-0061", 0, 0))
    return record, next(iter(record.frames))


def test_the_rig_looks_where_its_names_say(real_frame):
    _, frame = real_frame
    front = frame.cameras["CAM_FRONT"].yaw
    yaws = {name: (camera.yaw - front + 180) % 360 - 180 for name, camera in frame.cameras.items()}

    assert list(yaws) == list(CAMERAS)
    assert yaws["CAM_FRONT_LEFT"] == pytest.approx(55, abs=3)
    assert yaws["CAM_FRONT_RIGHT"] == pytest.approx(-56, abs=3)
    assert yaws["CAM_BACK_LEFT"] == pytest.approx(108, abs=3)
    assert yaws["CAM_BACK_RIGHT"] == pytest.approx(-111, abs=3)
    assert abs(yaws["CAM_BACK"]) == pytest.approx(180, abs=3)


def test_cameras_look_before_the_sweep_ends(real_frame):
    _, frame = real_frame
    early = [frame.timestamp - frame.exposures[name].time for name in CAMERAS]

    assert all(0 <= seconds < 0.05 for seconds in early)
    assert early == pytest.approx([0.0355, 0.0431, 0.0276, 0.0104, 0.0005, 0.0201], abs=1e-4)


def test_every_camera_has_a_pose_of_its_own(real_nuscenes):
    (instant, *_) = read_recording(real_nuscenes / "v1.0-mini", "scene-0061", False).instants
    poses = {name: reading.ego.pose for name, reading in instant.readings.items()}
    away = [np.linalg.norm(poses[name][:3, 3] - poses[LIDAR][:3, 3]) for name in CAMERAS]

    assert min(away) == pytest.approx(0.005, abs=0.001)
    assert max(away) == pytest.approx(0.40, abs=0.01)
    assert all(pose[2, 3] == pytest.approx(0, abs=0.02) for pose in poses.values())


def test_beams_count_from_the_top_and_the_car_is_left_out(real_nuscenes, real_frame):
    (instant, *_) = read_recording(real_nuscenes / "v1.0-mini", "scene-0061", False).instants
    reading = instant.readings[LIDAR]
    points, origin = real_frame[1].points, real_frame[0].info.origin
    pose = reading.ego.pose @ reading.sensor.pose
    xyz = (points.xyz.astype(float) + origin - pose[:3, 3]) @ pose[:3, :3]
    elevation = np.degrees(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))
    beams = [np.median(elevation[points.beam == beam]) for beam in range(32)]

    assert np.all(np.diff(beams) < 0)
    assert (beams[0], beams[31]) == (pytest.approx(10.6, abs=0.1), pytest.approx(-30.6, abs=0.1))
    raw = np.fromfile(real_nuscenes / reading.data.text("filename"), "<f4").reshape(-1, 5)
    away = np.hypot(raw[:, 0], raw[:, 1])
    assert len(raw) - len(points) == (away < 2).sum() == (away < 3).sum() == 8526


def test_boxes_hold_their_points_and_not_across(real_frame):
    record, frame = real_frame
    xyz = frame.points.xyz.astype(float)
    boxes = [box for box in Box.rows(record.tracks) if box.label.startswith("vehicle")]
    turned = [box._replace(length=box.width, width=box.length) for box in boxes]
    held, across = (sum(box.holds(xyz).sum() for box in some) for some in (boxes, turned))

    assert (held, across) == (589, 127)


def test_extrapolated_targets_have_the_known_support(real_nuscenes):
    record = Source(512, 512, folder=str(real_nuscenes)).open(SceneRef("scene-0061", 0, 0))
    frame, rig = colour_frame(next(iter(record.frames))), record.info.rig
    points = frame.points.select(rig.scores(frame.points))
    for side, shift in product((rig.front_left, rig.front_right), (-1.0, 1.0)):
        camera = half_way(frame.cameras[rig.front], frame.cameras[side], shift)
        target = Target("extrapolation", 0, camera, ALL_CAMERAS, 0.0, shift)
        empty = np.zeros((512, 512), bool)
        reference = sparse_reference(points, target, empty, np.random.default_rng(0))
        assert 0.0045 < reference.mask().mean() < 0.0075, (side, shift)


def test_boxes_and_points_lie_on_the_pictured_lorry(real_frame):
    record, frame = real_frame
    camera = frame.cameras["CAM_FRONT"]
    lorry = next(box for box in Box.rows(record.tracks) if box.label == "vehicle.truck")
    inside = lorry.holds(frame.points.xyz.astype(float), margin=0.1)
    rows, columns = np.nonzero(zbuffer(frame.points.xyz[inside], camera).index >= 0)

    # Looked at: in the picture it spans columns 65 to 620 and rows 200 to 680 of 1600 x 900.
    assert len(rows) > 100
    assert columns.min() > 60
    assert columns.max() < 630
    assert rows.min() > 195
    assert rows.max() < 690


def test_the_command_imports_it(real_nuscenes, tmp_path, geoevs):
    options = json.dumps({"folder": str(real_nuscenes)})
    arguments = ("--source", "nuscenes", "--name", "scene-0061@0-0", "--options", options)
    paths = ("--out", tmp_path / "store", "--depths", tmp_path / "depths")
    code, _, said = geoevs("scene", *arguments, "--height", 128, "--width", 192, *paths)
    assert code == 0, said
    scene = Scene(tmp_path / "store")

    assert scene.frames == (0,)
    assert scene.info.origin == (411.0, 1180.0, 2.0)
    assert len(scene.tracks) == 69
    points = scene.points(0)
    assert (points.camera >= 0).mean() > 0.5
