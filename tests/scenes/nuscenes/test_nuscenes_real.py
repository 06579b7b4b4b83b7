"""A real keyframe of nuScenes; these tests repeat the measurements that docs/nuscenes.md names."""

import json

import numpy as np
import pytest

from geoevs.projection import zbuffer
from geoevs.scenes.boxes import Box
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.nuscenes.source import CAMERAS, Source
from geoevs.scenes.store import Scene


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


def test_beams_count_from_the_top(real_frame):
    _, frame = real_frame
    points = frame.points
    up = points.xyz[:, 2] - np.percentile(points.xyz[:, 2], 1)
    heights = [np.median(up[points.beam == beam]) for beam in (2, 30)]

    assert set(np.unique(points.beam)) == set(range(32))
    assert heights[0] > heights[1] + 1
    assert len(points) == 26162  # of 34,688: the others lie on the car


def test_boxes_hold_their_points_and_not_across(real_frame):
    record, frame = real_frame
    xyz = frame.points.xyz.astype(float)
    boxes = [box for box in Box.rows(record.tracks) if box.label.startswith("vehicle")]
    turned = [box._replace(length=box.width, width=box.length) for box in boxes]
    held, across = (sum(box.holds(xyz).sum() for box in some) for some in (boxes, turned))

    assert held > 1.3 * across
    assert held > 500


def test_the_depth_of_points_ends_at_boxes_in_the_image(real_frame):
    """Points of a box fall into its picture: the truck ahead at the left is seen where it is."""
    record, frame = real_frame
    camera: Camera = frame.cameras["CAM_FRONT"]
    truck = next(box for box in Box.rows(record.tracks) if box.label == "vehicle.truck")
    inside = truck.holds(frame.points.xyz.astype(float), margin=0.1)
    seen = zbuffer(frame.points.xyz[inside], camera)
    rows, columns = np.nonzero(seen.index >= 0)

    # Looked at: the lorry's picture spans columns 65 to 620 and rows 200 to 680 of 1600 x 900.
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
