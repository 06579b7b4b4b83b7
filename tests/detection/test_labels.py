import numpy as np
import pandas as pd
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.parquet import write_parquet
from geoevs.detection.labels import (
    CAMERA_HEIGHT,
    LABEL_TYPES,
    most_visible,
    read_labels,
    scene_labels,
    scored,
    world_from_vehicle,
)
from geoevs.methods.tiny import CAR, MOUNT, STEP, tiny_camera, write_tiny_scene
from geoevs.scenes.scene import TRACK_COLUMNS, SceneExtras

CLASSES = {"vehicle": ["car"], "pedestrian": ["walker"]}
BOUNDS = (-8, -28, -3, 48, 28, 5)
SIZE = CAR[1] - CAR[0]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("tiny") / "scene")


def with_boxes(scene, *boxes):
    """The scene with other boxes in frame 0, each from its track to its yaw."""
    rows = [(0, *box, False) for box in boxes]
    scene.__dict__["tracks"] = pd.DataFrame(rows, columns=list(TRACK_COLUMNS))
    return scene


def car(track="c", label="car", x=0.0, y=0.0, yaw=0.0):
    centre = CAR.mean(axis=0) + np.array([x, y, 0])
    return (track, label, *centre, *SIZE, yaw)


@pytest.fixture
def own(tmp_path):
    return write_tiny_scene(tmp_path / "scene")


def test_the_vehicle_heads_where_its_front_camera_looks_and_stands_below_it(scene):
    pose = world_from_vehicle(scene, 1)
    np.testing.assert_allclose(pose[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(pose[:3, 3], MOUNT + STEP - (0, 0, CAMERA_HEIGHT), atol=1e-12)


def test_a_label_by_hand(scene):
    labels = scene_labels(scene, "here", CLASSES, BOUNDS)
    assert list(labels.columns) == list(LABEL_TYPES)
    assert labels["scene"].eq("here").all()
    first, second = labels.to_dict("records")
    centre = CAR.mean(axis=0) - MOUNT + (0, 0, CAMERA_HEIGHT)
    for label, moved in ((first, 0), (second, 1)):
        place = [label[name] for name in ("x", "y", "z")]
        np.testing.assert_allclose(place, centre - moved * STEP, atol=1e-9)
        assert [label[name] for name in ("length", "width", "height", "heading")] == [*SIZE, 0]
        assert (label["class"], label["camera"], label["reason"]) == ("vehicle", "front", "")
    inside = ((scene.points(0).xyz >= CAR[0]) & (scene.points(0).xyz <= CAR[1])).all(axis=1)
    assert first["points"] == inside.sum() > 5
    assert first["level"] == 1


def test_boxes_turn_with_the_vehicle(own):
    """A rig that heads along +y sees what lies along +x at its right."""
    turned = {name: tiny_camera(name, 90.0, MOUNT) for name in ("front",)}
    own.camera = lambda name, frame: turned["front"]
    with_boxes(own, car(yaw=100.0))
    label = scene_labels(own, "s", CLASSES, BOUNDS).iloc[0]
    x, y, _ = CAR.mean(axis=0)
    np.testing.assert_allclose([label["x"], label["y"]], [y, -x], atol=1e-9)
    assert label["heading"] == pytest.approx(np.radians(10))


def test_each_label_says_why_it_does_not_count(own):
    behind, aside, far = car(x=-20), car(y=-1.5), car(x=60)
    with_boxes(own, car(label="tram"), behind, aside, far, car())
    labels = scene_labels(own, "s", CLASSES, BOUNDS)
    # A box that holds no surface has no points, whoever sees it.
    assert labels["reason"].tolist() == [
        *("of no known class", "without LiDAR points", "", "without LiDAR points", "")
    ]
    labels = scene_labels(own, "s", CLASSES, (-8, -28, -3, 6, 28, 5))
    assert labels["reason"].iloc[-1] == "out of range"


def test_a_box_behind_the_rig_is_seen_by_none(own):
    wall = ("w", "car", -10.0, 0.0, 2.0, 1.0, 4.0, 2.0, 0.0)
    with_boxes(own, wall)
    label = scene_labels(own, "s", CLASSES, (-20, -28, -3, 48, 28, 5)).iloc[0]
    assert label["points"] > 0
    assert (label["camera"], label["reason"]) == ("", "seen by no camera")


def test_the_nearest_axis_decides_between_cameras():
    cameras = [tiny_camera("front", 0.0, np.zeros(3)), tiny_camera("left", 45.0, np.zeros(3))]
    bearing = np.radians([0, 22, 23, 45, 90])
    points = 10 * np.stack([np.cos(bearing), np.sin(bearing), np.zeros(5)], axis=1)
    assert most_visible(points, cameras) == ["front", "front", "left", "left", ""]


def test_boxes_at_the_instants_of_cameras_are_the_labels(tmp_path):
    plain = write_tiny_scene(tmp_path / "plain").tracks
    synced = plain[plain["frame"] == 0].assign(camera="left", x=plain["x"][0] + 0.5)
    scene = write_tiny_scene(tmp_path / "synced", extras=SceneExtras(synced_tracks=synced))
    labels = scene_labels(scene, "s", CLASSES, BOUNDS)
    assert labels["camera"].tolist() == ["left", ""]
    assert labels["reason"].tolist() == ["", "seen by no camera"]
    assert labels["x"][0] == pytest.approx(CAR.mean(axis=0)[0] - MOUNT[0] + 0.5)
    # Points were measured where the box is at the LiDAR's instant.
    assert (
        labels["points"][0]
        == scene_labels(write_tiny_scene(tmp_path / "again"), "s", CLASSES, BOUNDS)["points"][0]
    )


def test_labels_of_which_none_counts_are_one_sentence(scene):
    labels = scene_labels(scene, "s", {"pedestrian": ["walker"]}, BOUNDS)
    with pytest.raises(GeoEvsError, match=r"no label of x counts \(2 of no known class\); name"):
        scored(labels, "x")
    with pytest.raises(GeoEvsError, match=r"no label of x counts \(no boxes at all\)"):
        scored(labels[:0], "x")


def test_labels_are_read_as_they_were_written(scene, tmp_path):
    labels = scene_labels(scene, "s", CLASSES, BOUNDS)
    write_parquet(tmp_path / "labels.parquet", labels)
    pd.testing.assert_frame_equal(read_labels(tmp_path / "labels.parquet"), labels)
    write_parquet(tmp_path / "labels.parquet", labels.assign(reason="tired"))
    with pytest.raises(GeoEvsError, match=r"labels.parquet has the reason 'tired'"):
        read_labels(tmp_path / "labels.parquet")
