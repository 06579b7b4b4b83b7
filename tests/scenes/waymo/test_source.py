import shutil
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.projection.coloured_scenes import write_coloured_scene
from geoevs.scenes.boxes import Box
from geoevs.scenes.checks import check_exposure, check_rig
from geoevs.scenes.scene import TRACK_COLUMNS, SceneRef
from geoevs.scenes.sources.waymo.segment import CAMERAS
from geoevs.scenes.sources.waymo.source import Source
from geoevs.scenes.store import Scene
from tests.scenes.waymo.world import BOXES, NAME, PLACE, START, ZONE, vehicle_pose
from tests.scenes.waymo.writers import record, v1_frame, write_v1, write_v2

ORIGIN = (-25211.0, 42392.0, -161.0)  # the first frame's vehicle, in whole metres
SHIFT = PLACE - ORIGIN  # of the plane in the scene


def read(folder: Path, scene: str = NAME, **options):
    """The record and the frames of `scene`, at 64 x 96 pixels."""
    opened = Source(64, 96, folder=str(folder), **options).open(SceneRef.parse(scene))
    return opened, list(opened.frames)


def test_the_scene_is_described(waymo_folder):
    opened, frames = read(waymo_folder)
    info = opened.info

    assert (info.name, info.source, info.redistribute) == (NAME, "waymo", False)
    assert info.licence == "Waymo Dataset License Agreement for Non-Commercial Use"
    assert info.cameras == CAMERAS
    assert info.origin == ORIGIN
    assert info.rig.lidar_split == "beam"
    assert info.box_delay == 0
    assert opened.frame_count == len(frames) == 2
    assert [frame.frame for frame in frames] == [0, 1]
    assert [frame.timestamp for frame in frames] == pytest.approx([START, START + 0.1], abs=1e-6)


def test_points_lie_on_the_ground_or_on_a_box(waymo_folder):
    opened, frames = read(waymo_folder)
    for frame in frames:
        points = frame.points.xyz.astype(float)
        on = np.abs(points[:, 2] - SHIFT[2]) < 0.001
        for box in Box.rows(opened.tracks[opened.tracks["frame"] == frame.frame]):
            inner = box._replace(
                length=box.length - 0.002, width=box.width - 0.002, height=box.height - 0.002
            )
            on |= box.holds(points, 0.001) & ~inner.holds(points)
        assert len(points) > 40_000
        assert on.mean() >= 0.9999
        assert set(frame.points.sensor.tolist()) == {0, 1, 2, 3, 4}
        top = frame.points.sensor == 0
        low, high = (top & (frame.points.beam == beam) for beam in (63, 20))
        away = np.linalg.norm(points - frame.cameras["front"].centre, axis=1)
        assert away[low].max() < 10 < 30 < np.median(away[high])
        assert 0.4 < opened.info.rig.scores(frame.points).mean() < 0.6


def test_both_versions_give_the_same(v1_folder, v2_folder):
    (one, first), (two, second) = (
        read(folder, second_returns=True) for folder in (v1_folder, v2_folder)
    )
    assert one.info == two.info
    np.testing.assert_array_equal(one.tracks.to_numpy(), two.tracks.to_numpy())
    synced = one.extras.synced_tracks.to_numpy(), two.extras.synced_tracks.to_numpy()
    np.testing.assert_array_equal(*synced)
    for frame, other in zip(first, second, strict=True):
        assert frame.timestamp == other.timestamp
        assert frame.exposures == other.exposures
        for field in ("xyz", "sensor", "beam"):
            here, there = getattr(frame.points, field), getattr(other.points, field)
            np.testing.assert_array_equal(here, there)
        for name in CAMERAS:
            here, there = frame.cameras[name], other.cameras[name]
            np.testing.assert_array_equal(here.K, there.K)
            # Velocities are float32 in version 1 and, here, float64 in version 2.
            np.testing.assert_allclose(here.world_from_camera, there.world_from_camera, atol=1e-8)
            np.testing.assert_array_equal(frame.images[name], other.images[name])


def test_older_types_and_row_groups_make_no_difference(made_segment, v2_folder, tmp_path):
    write_v2(tmp_path, made_segment, old=True, group=2)
    (one, first), (two, second) = read(v2_folder), read(tmp_path)

    numbers = ["x", "y", "z", "yaw"]
    np.testing.assert_allclose(one.tracks[numbers], two.tracks[numbers], atol=0.02)
    for frame, other in zip(first, second, strict=True):
        np.testing.assert_allclose(frame.points.xyz, other.points.xyz, atol=0.02)
        for name in CAMERAS:
            np.testing.assert_array_equal(frame.images[name], other.images[name])


def test_rows_in_another_order_make_no_difference(made_segment, v2_folder, tmp_path):
    backwards = made_segment.copy()
    backwards.frames.reverse()
    write_v2(tmp_path, backwards, group=4)
    for frame, other in zip(read(v2_folder)[1], read(tmp_path)[1], strict=True):
        np.testing.assert_array_equal(frame.points.xyz, other.points.xyz)
        np.testing.assert_array_equal(frame.images["front"], other.images["front"])


def test_cameras_have_the_pose_of_their_principal_columns_instant(waymo_folder):
    opened, frames = read(waymo_folder)
    for frame in frames:
        check_rig(opened.info.rig, frame.cameras, "x")
        for number, name in enumerate(CAMERAS, start=1):
            exposure = check_exposure(frame.exposures[name], "x")
            # Columns are exposed from 1 to 45 ms after the trigger.
            trigger = START + 0.1 * frame.frame + 0.01 * number
            assert exposure.start == pytest.approx(trigger + 0.001, abs=1e-6)
            assert exposure.end == pytest.approx(trigger + 0.045, abs=1e-6)
            seconds = trigger + 0.001 + 95 / 192 * 0.044 - START
            assert exposure.time == pytest.approx(START + seconds, abs=1e-6)
            place = vehicle_pose(seconds) @ [1.5, 0.1 * number, 2.1, 1]
            camera = frame.cameras[name]
            # The arc is a line for 20 ms: less than 0.1 mm. The pose is 0.24 m further on.
            np.testing.assert_allclose(camera.centre, place[:3] - ORIGIN, atol=6e-4)
            assert (camera.height, camera.width) == (64, 96)
            assert camera.K[0, 0] == pytest.approx((205 + number) / 2)


def test_images_are_undistorted_and_resized(waymo_folder):
    _, frames = read(waymo_folder)
    for number, name in enumerate(CAMERAS, start=1):
        image = frames[0].images[name].astype(float)
        assert image.shape == (64, 96, 3)
        assert frames[0].images[name].dtype == np.uint8
        # Near the principal point nothing is bent: red and green tell the place.
        row = round(64 * 0.49)
        assert image[row, 47, 0] == pytest.approx(40 + 47.5 / 96 * 160, abs=2)
        assert image[row, 47, 1] == pytest.approx(40 + (row + 0.5) / 64 * 160, abs=2)
        assert image[row, 47, 2] == pytest.approx(40 * number, abs=2)


def test_boxes_stand_in_the_world(waymo_folder):
    opened, _ = read(waymo_folder)
    tracks = opened.tracks

    assert tuple(tracks) == TRACK_COLUMNS
    assert len(tracks) == 10
    boxes = tracks[tracks["frame"] == 0].set_index("track")
    for track, (x, y, z, length, width, height, heading) in BOXES.items():
        box = boxes.loc[track]
        np.testing.assert_allclose(
            box[["x", "y", "z"]].astype(float), SHIFT + np.array([x, y, z]), atol=1e-6
        )
        assert [box["length"], box["width"], box["height"]] == [length, width, height]
        assert box["yaw"] == pytest.approx(np.degrees(heading), abs=0.01)
    labels = {"car": "vehicle", "bus": "vehicle", "walker": "pedestrian", "board": "sign"}
    assert boxes["label"].to_dict() == labels | {"bike": "cyclist"}
    # The car drifts by 0.36 m/s, which is no motion.
    assert boxes["moving"].to_dict() == dict.fromkeys(BOXES, False) | {"walker": True}


def test_boxes_at_the_cameras_instants_are_kept(waymo_folder):
    opened, _ = read(waymo_folder)
    synced = opened.extras.synced_tracks

    assert synced["track"].tolist() == ["walker", "walker"]
    assert synced["camera"].tolist() == ["front_right", "front_right"]
    assert synced["moving"].tolist() == [True, True]
    walker = opened.tracks[opened.tracks["track"] == "walker"]
    away = synced[["x", "y", "z"]].to_numpy() - walker[["x", "y", "z"]].to_numpy()
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.01, atol=1e-9)


def test_zones_and_map_are_kept_where_the_version_has_them(v1_folder, v2_folder):
    extras = read(v1_folder)[0].extras

    assert list(extras.no_label_zones) == [0]
    np.testing.assert_allclose(extras.no_label_zones[0][0], ZONE + SHIFT[:2])
    polygons = extras.road_map.polygons
    # Road edges, stop signs and speed bumps say nothing of the ground.
    surfaces = ["drivable", "marking", "crossing", "drivable"]
    assert [polygon.surface for polygon in polygons] == surfaces
    # Features were shifted by their number; points gain the offset to reach the map.
    line = np.array([[0, 0, 0], [10, 0, 0], [20, 1, 0]]) + SHIFT - [0.5, -0.25, 0.125]
    np.testing.assert_allclose(polygons[2].rings[0], line + 8)
    lane = polygons[0].rings[0]
    assert len(lane) == 6
    np.testing.assert_allclose(lane[0], line[0] + 3 + [0, 1.8, 0])  # a lane of 3.6 m heads along x
    np.testing.assert_allclose((lane[:3] + lane[:2:-1]) / 2, line + 3)
    other = read(v2_folder)[0].extras
    assert other.road_map is None
    assert not other.no_label_zones


def test_a_map_serves_a_range_that_begins_later(v1_folder):
    opened, _ = read(v1_folder, f"{NAME}@1-1")
    assert len(opened.extras.road_map.polygons) == 4


def test_second_returns_are_points_by_option(waymo_folder):
    first, both = (read(waymo_folder, second_returns=on)[1][0].points for on in (False, True))
    assert len(first) < len(both) < 1.2 * len(first)
    assert (both.xyz[:, 2] < SHIFT[2] - 0.005).any()  # a quarter of a metre below the ground


def test_ranges_keep_the_frames_numbers(waymo_folder):
    opened, frames = read(waymo_folder, f"{NAME}@1-1")
    whole, all_frames = read(waymo_folder)

    assert opened.frame_count == 1
    assert [frame.frame for frame in frames] == [1]
    assert set(opened.tracks["frame"]) == {1}
    # Its own first vehicle position is the origin, 1.2 m further on.
    moved = np.array(opened.info.origin) - whole.info.origin
    np.testing.assert_allclose(frames[0].points.xyz + moved, all_frames[1].points.xyz, atol=1e-5)


def test_frames_are_counted_by_time(made_segment, v1_folder, tmp_path):
    backwards = made_segment.copy()
    backwards.frames.reverse()
    write_v1(tmp_path / "back.tfrecord", backwards)
    opened, frames = read(tmp_path)

    expected, others = read(v1_folder)
    np.testing.assert_array_equal(opened.tracks.to_numpy(), expected.tracks.to_numpy())
    for frame, other in zip(frames, others, strict=True):
        assert frame.timestamp == other.timestamp
        np.testing.assert_array_equal(frame.points.xyz, other.points.xyz)


def test_a_store_is_written_and_read(v1_folder, tmp_path):
    opened = Source(64, 96, folder=str(v1_folder)).open(SceneRef(NAME))
    write_coloured_scene(tmp_path / "store", tmp_path / "depths", opened, lambda: None)
    scene = Scene(tmp_path / "store")

    assert scene.info.origin == ORIGIN
    assert not scene.info.redistribute
    assert scene.exposure("front", 0).start < scene.exposure("front", 0).end
    assert len(scene.road_map.polygons) == 4
    assert list(scene.no_label_zones) == [0]
    assert len(scene.synced_tracks) == 2
    assert (scene.points(1).camera >= 0).any()


def test_a_frame_without_lidar_still_has_boxes_and_images(made_segment, tmp_path):
    segment = made_segment.copy()
    for frame in segment.frames:
        frame["sweeps"] = {number: {} for number in frame["sweeps"]}  # as in the public sample
    write_v1(tmp_path / "bare.tfrecord", segment)
    opened, frames = read(tmp_path)

    assert [len(frame.points) for frame in frames] == [0, 0]
    assert len(opened.tracks) == 10
    source = Source(64, 96, folder=str(tmp_path)).open(SceneRef(NAME))
    with pytest.raises(GeoEvsError, match="no LiDAR point is of odd beams, which score methods"):
        write_coloured_scene(tmp_path / "store", tmp_path / "depths", source, lambda: None)
    assert not (tmp_path / "store").exists()
    assert not (tmp_path / "depths").exists()


def test_a_segment_is_found_by_its_context_whatever_its_file_is_called(made_segment, tmp_path):
    other = made_segment.copy()
    other.name = "2000_000_000_020_000"
    write_v1(tmp_path / "a.tfrecord", other)
    write_v1(tmp_path / "z.tfrecord", made_segment)
    (tmp_path / "broken.tfrecord").write_bytes(b"no record")
    source = Source(64, 96, folder=str(tmp_path))

    assert list(source.files(SceneRef(NAME))) == [tmp_path / "z.tfrecord"]
    assert source.open(SceneRef(NAME)).frame_count == 2
    assert source.open(SceneRef(other.name)).info.name == other.name


def test_files_are_those_of_the_segment_there_or_not(v1_folder, v2_folder, tmp_path):
    ref = SceneRef(NAME)
    canonical = f"segment-{NAME}_with_camera_labels.tfrecord"
    assert list(Source(64, 96, folder=str(v1_folder)).files(ref)) == [v1_folder / canonical]
    listed = list(Source(64, 96, folder=str(v2_folder)).files(ref))
    assert sorted(listed) == sorted(v2_folder.glob("*/*.parquet"))
    assert len(listed) == 8
    gone = Source(64, 96, folder=str(tmp_path / "gone"))
    gone.check(ref)
    assert list(gone.files(ref)) == [tmp_path / "gone" / canonical]


def test_a_file_called_after_another_segment_is_not_opened(made_segment, tmp_path, monkeypatch):
    write_v1(tmp_path / f"segment-{NAME}_with_camera_labels.tfrecord", made_segment)
    pipe = tmp_path / "segment-3000_000_000_020_000_with_camera_labels.tfrecord"
    shutil.copy(tmp_path / f"segment-{NAME}_with_camera_labels.tfrecord", pipe)
    opened = []
    module = "geoevs.scenes.sources.waymo.find.v1.context_name"
    monkeypatch.setattr(module, lambda path: opened.append(path) or NAME)
    list(Source(64, 96, folder=str(tmp_path)).files(SceneRef(NAME)))
    assert len(opened) == 1
    assert opened[0] != pipe


def test_recorded_data_have_no_truth(v1_folder):
    with pytest.raises(GeoEvsError, match="has no dense truth at new poses"):
        Source(64, 96, folder=str(v1_folder)).truth(SceneRef(NAME), [])


@pytest.mark.parametrize("write", [lambda f, s: write_v1(f / "long.tfrecord", s), write_v2])
def test_memory_does_not_grow_with_frames(small_segment, tmp_path, write):
    """Of a frame that has been handed over nothing is kept; a table is one row group here."""
    frame = small_segment.frames[0]
    frames = [frame | {"time": frame["time"] + 100_000 * n} for n in range(10)]
    write(tmp_path, replace(small_segment, frames=frames))
    read_frames = Source(64, 96, folder=str(tmp_path)).open(SceneRef(NAME)).frames
    for _ in range(3):
        next(read_frames)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0] + pa.total_allocated_bytes()
    for _ in range(7):
        size = sum(image.nbytes for image in next(read_frames).images.values())
    grown = tracemalloc.get_traced_memory()[0] + pa.total_allocated_bytes() - before
    tracemalloc.stop()
    assert grown < 3 * size


def test_a_record_with_an_unknown_field_is_read(made_segment, tmp_path):
    frames = [v1_frame(made_segment, n) + b"\xc2\x3e\x03new" for n in range(2)]  # field 1000
    (tmp_path / "new.tfrecord").write_bytes(b"".join(map(record, frames)))
    assert len(read(tmp_path)[1]) == 2
