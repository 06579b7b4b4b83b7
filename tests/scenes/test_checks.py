import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import YAWS, tiny_camera, write_tiny_scene
from geoevs.scenes.checks import (
    check_depth,
    check_rig,
    check_sensors,
    check_tracks,
    checked_points,
    frame_number,
    number,
    timestamp,
)
from geoevs.scenes.scene import Rig

RIG = Rig("front", "left", "right", "beam")


def rig_cameras(**yaws):
    """Cameras 1 m apart, each turned by its yaw."""
    centres = np.arange(len(yaws))[:, None] * [0.0, 1.0, 0.0]
    pairs = zip(yaws.items(), centres, strict=True)
    return {name: tiny_camera(name, yaw, centre) for (name, yaw), centre in pairs}


def rolled(camera, degrees):
    """The camera turned about its own axis."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    pose = camera.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
    return dataclasses.replace(camera, world_from_camera=pose)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("tiny") / "scene")


@pytest.mark.parametrize("value", [None, True, "1", [1], 10**400, float("nan"), float("inf")])
def test_what_is_no_number_is_named(value):
    with pytest.raises(GeoEvsError, match=r"^f\.json: cx is .*, no finite number; correct it"):
        number(value, "cx", Path("f.json"))


@pytest.mark.parametrize("value", [-1, 1.0, True, None, "1", 10**6, 2**70])
def test_what_is_no_frame_is_named(value):
    with pytest.raises(GeoEvsError, match=r"^f\.json: frame .* from 0 to 999999; renumber it"):
        frame_number(value, "f.json")


def test_times_go_on():
    assert timestamp(5, "f", last=4.9) == 5.0
    for value in (-0.1, float("inf"), "noon", None):
        with pytest.raises(GeoEvsError, match=r"^f: the timestamp is"):
            timestamp(value, "f")
    with pytest.raises(GeoEvsError, match=r"the frame before has 5\.0"):
        timestamp(5.0, "f", last=5.0)


@pytest.mark.parametrize(
    "yaws",
    [
        YAWS,
        {"front": 170, "left": -145, "right": 125},
        {"left": 90, "right": -90},
        {"front": 0, "left": 45, "right": -45, "left-stereo": -1, "rear_left": 179, "upright": -90},
    ],
)
def test_rigs_that_can_be(yaws):
    check_rig(RIG, rig_cameras(**yaws), "w")


@pytest.mark.parametrize(
    ("yaws", "sentence"),
    [
        ({"front": 0, "left": -45, "right": 45}, "'left' is the left one but looks 45 degrees to"),
        ({"front": 0, "left": 45, "right": 5}, "'right' is the right one but looks 5 degrees to"),
        ({"front": 0, "left": 0, "right": -45}, "'left' is the left one but looks 0 degrees"),
        ({"front": 0, "side_left": -90}, "camera 'side_left' is the left one but looks 90 degrees"),
        ({"front": 90, "Back.Right": 180}, "'Back.Right' is the right one but looks 90 degrees to"),
    ],
)
def test_cameras_that_look_to_the_other_side_are_named(yaws, sentence):
    with pytest.raises(GeoEvsError, match=f"^w: .*{sentence}"):
        check_rig(RIG, rig_cameras(**yaws), "w")


def test_another_cameras_pose_is_refused():
    cameras = rig_cameras(**YAWS)
    pose = cameras["right"].world_from_camera
    cameras["left"] = dataclasses.replace(cameras["left"], world_from_camera=pose)
    with pytest.raises(GeoEvsError, match="'left' and 'right' have the same pose"):
        check_rig(RIG, cameras, "w")


def test_a_camera_far_from_the_vehicle_is_refused():
    cameras = rig_cameras(**YAWS)
    pose = cameras["right"].world_from_camera.copy()
    pose[0, 3] += 500
    cameras["right"] = dataclasses.replace(cameras["right"], world_from_camera=pose)
    with pytest.raises(GeoEvsError, match="camera 'right' is 500 m from camera 'front'"):
        check_rig(RIG, cameras, "w")


@pytest.mark.parametrize(("degrees", "good"), [(0, True), (40, True), (90, False), (180, False)])
def test_z_is_up(degrees, good):
    cameras = {name: rolled(camera, degrees) for name, camera in rig_cameras(**YAWS).items()}
    if good:
        check_rig(RIG, cameras, "w")
    else:
        with pytest.raises(GeoEvsError, match=r"^w: the world's z is not up"):
            check_rig(RIG, cameras, "w")


@pytest.mark.parametrize(
    ("field", "change", "sentence"),
    [
        ("xyz", lambda a: a[:, :2], "'xyz' of the LiDAR points is float32 of shape"),
        ("xyz", lambda a: a + np.float32(2e4), "more than 10 km from the origin"),
        ("rgb", lambda a: a * 255, "of a 'rgb' that is not within 0 and 1"),
        ("rgb", lambda a: np.where(a > 0, np.nan, a), "of a 'rgb'"),
        ("rgb", lambda a: a[:-1], "'rgb' of the LiDAR points is float32 of shape"),
        ("camera", lambda a: np.where(a == 0, 99, a), "coloured by a camera that the scene does"),
        ("camera", lambda a: a.astype(float), "is float64 of shape"),
        ("camera", lambda a: a * 0 - 2, "coloured by a camera"),
        ("sensor", lambda a: a.astype(int) + 256, "of a 'sensor' that is not within 0 and 255"),
        ("beam", lambda a: a.astype(str), "'beam' of the LiDAR points is <U"),
    ],
)
def test_points_that_cannot_be_are_refused(tiny, field, change, sentence):
    points = tiny.points(0)
    broken = dataclasses.replace(points, **{field: change(getattr(points, field))})
    with pytest.raises(GeoEvsError) as caught:
        checked_points(broken, 3, "w")
    assert str(caught.value).startswith("w: ")
    assert sentence in str(caught.value)


def test_points_take_the_types_of_the_store(tiny):
    points = tiny.points(0)
    wide = dataclasses.replace(
        points,
        xyz=points.xyz.astype(np.float64),
        camera=points.camera.astype(np.int64),
        beam=points.beam.astype(np.int32),
    )
    again = checked_points(wide, 3, "w")
    for field in dataclasses.fields(points):
        expected, found = getattr(points, field.name), getattr(again, field.name)
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


def test_a_lidar_that_cannot_score_or_condition_is_named(tiny):
    points = tiny.points(0)
    check_sensors(RIG, points, "w")
    odd = points.beam % 2 == 1
    for keep, sentence in (
        (~odd, "no LiDAR point is of odd beams, which score methods"),
        (odd, "no LiDAR point is of even beams, which condition them"),
        (~odd | (points.camera < 0), "no LiDAR point of odd beams falls into an image"),
    ):
        with pytest.raises(GeoEvsError, match=f"^w: {sentence}"):
            check_sensors(RIG, points.select(keep), "w")
    by_sensor = dataclasses.replace(RIG, lidar_split="sensor")
    with pytest.raises(GeoEvsError, match="no LiDAR point is of another sensor, which condition"):
        check_sensors(by_sensor, points, "w")


@pytest.mark.parametrize(
    ("column", "value", "sentence"),
    [
        ("length", 0.0, "'length' of 2 boxes is no side of a box, such as 0;"),
        ("width", -1.8, "'width' of 2 boxes is no side of a box, such as -1.8;"),
        ("height", 1e6, "'height' of 2 boxes is no side of a box, such as 1e"),
        ("x", float("nan"), "'x' of 2 boxes is beyond 10 km or none, such as nan"),
        ("z", 4e6, "'z' of 2 boxes is beyond 10 km"),
        ("y", "left", "'y' of boxes holds no numbers"),
        ("yaw", float("inf"), "'yaw' of 2 boxes is no angle in degrees"),
        ("moving", "False", "'moving' of a box is neither true nor false"),
        ("moving", 1, "'moving' of a box is neither true nor false"),
        ("track", 5, "'track' of a box is no text"),
        ("label", None, "'label' of a box is no text"),
        ("frame", -1, "frame -1 is no whole number"),
        ("frame", 0.5, "frame 0.5 is no whole number"),
        ("frame", 0, "a frame has two boxes of one track"),
    ],
)
def test_boxes_that_cannot_be_are_refused(tiny, column, value, sentence):
    broken = tiny.tracks.assign(**{column: value})
    with pytest.raises(GeoEvsError) as caught:
        check_tracks(broken, "w")
    assert str(caught.value).startswith("w: ")
    assert sentence in str(caught.value)


def test_boxes_need_all_columns_even_if_there_are_none(tiny):
    assert len(check_tracks(tiny.tracks[:0], "w")) == 0
    with pytest.raises(GeoEvsError, match=r"^w: boxes have no column 'yaw'; add it"):
        check_tracks(tiny.tracks[:0].drop(columns="yaw"), "w")
    assert isinstance(check_tracks(tiny.tracks, "w"), pd.DataFrame)


@pytest.mark.parametrize("broken", [-np.ones((2, 3)), np.full((2, 3), np.nan), np.ones(6),
                                    np.full((2, 3), np.inf), np.ones((2, 3), int)])  # fmt: skip
def test_what_is_no_depth_is_refused(broken):
    check_depth(np.zeros((2, 3), np.float32), "w")
    with pytest.raises(GeoEvsError, match=r"^w is no map of finite metres"):
        check_depth(broken, "w")
