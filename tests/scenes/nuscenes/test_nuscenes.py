"""What is read of a tiny nuScenes folder; expectations are derived by hand from writer.py."""

import cv2
import numpy as np
import pytest
from PIL import Image

from geoevs.core.errors import GeoEvsError
from geoevs.projection.coloured_scenes import write_coloured_scene
from geoevs.scenes.scene import SceneRef, load_source
from geoevs.scenes.sources.nuscenes import lidar, tables
from geoevs.scenes.sources.nuscenes.source import Source
from geoevs.scenes.store import Scene
from tests.scenes.nuscenes.writer import (
    CAMERAS,
    FOLDER,
    START,
    facing,
    make_tables,
    turn,
    write_tables,
)

NAMES = (
    "CAM_FRONT",
    "CAM_FRONT_LEFT",
    "CAM_FRONT_RIGHT",
    "CAM_BACK",
    "CAM_BACK_LEFT",
    "CAM_BACK_RIGHT",
)


def read_all(folder, scene="scene-0061", **options):
    """The record and the frames of `scene`, at 18 x 32 pixels, a fifth of the recorded ones."""
    record = Source(18, 32, folder=str(folder), **options).open(SceneRef.parse(scene))
    return record, list(record.frames)


def rewrite(folder, **changed):
    """Write the tables again, with those that are given changed."""
    made = make_tables()
    write_tables(folder / FOLDER, made | {name: edit(made[name]) for name, edit in changed.items()})


def test_reads_the_keyframes(nuscenes):
    record, frames = read_all(nuscenes)

    info = record.info
    assert (info.name, info.source) == ("scene-0061", "nuscenes")
    assert (info.licence, info.redistribute) == ("CC BY-NC-SA 4.0 (nuScenes)", False)
    assert info.cameras == NAMES
    assert info.rig.lidar_split == "beam"
    assert info.box_delay == 0
    assert record.frame_count == 3
    assert [frame.frame for frame in frames] == [0, 1, 2]
    assert [frame.timestamp for frame in frames] == [START / 1e6 + 0.5 * n for n in range(3)]
    for frame in frames:
        assert tuple(frame.cameras) == tuple(frame.images) == NAMES
        for name, (_, _, colour) in CAMERAS.items():
            assert frame.images[name].shape == (18, 32, 3)
            assert np.abs(frame.images[name].astype(int) - colour).max() <= 3  # JPEG's rounding
    assert not record.extras.ego_masks
    assert not record.extras.no_label_zones


def test_the_origin_is_subtracted_from_a_far_scene(nuscenes):
    record, _ = read_all(nuscenes)

    # The median place of the seven sensors: x 400 of three of them; y 1181.23 of CAM_FRONT_RIGHT,
    # 1.5 m before the car's 1179.73; z 1.5 of the cameras, rounded to even.
    assert record.info.origin == (400.0, 1181.0, 2.0)


def test_intrinsics_move_to_our_pixel_centres_before_they_scale(nuscenes):
    _, frames = read_all(nuscenes)

    # (79.5 + 0.5) / 5 = 16 and (44.5 + 0.5) / 5 = 9
    for camera in frames[0].cameras.values():
        np.testing.assert_allclose(camera.K, [[20, 0, 16], [0, 20, 9], [0, 0, 1]])


def test_every_camera_has_the_pose_of_its_own_time(nuscenes):
    record, frames = read_all(nuscenes)

    for name, (yaw, early, _) in CAMERAS.items():
        camera = frames[1].cameras[name]
        # The car drives north: its forward is y, its left -x.
        left = 0 if yaw in (0, 180) else np.sign(yaw) / 2
        centre = [400 - left, 1180 + 10 * (0.5 - early / 1e6) + 1.5, 1.5]
        np.testing.assert_allclose(camera.centre + record.info.origin, centre, atol=1e-9)
        assert (camera.yaw - yaw) % 360 == pytest.approx(90)
        np.testing.assert_allclose(camera.world_from_camera[:3, 1], [0, 0, -1], atol=1e-12)
        seconds = START / 1e6 + 0.5 - early / 1e6
        assert frames[1].exposures[name] == pytest.approx((seconds,) * 3, abs=1e-6)


def test_sweeps_are_right_forward_up_and_beams_count_from_the_top(nuscenes):
    record, frames = read_all(nuscenes)
    points = frames[1].points

    # The LiDAR is 1 m before the axle and 2 m up; right is world x, forward world y. At the second
    # keyframe the car stands at (400, 1185). The point on its bonnet is left out.
    world = points.xyz + np.array(record.info.origin)
    expected = [[402, 1196, 1], [397, 1206, 2], [400, 1196, 1]]
    np.testing.assert_allclose(world, expected, atol=1e-4)
    np.testing.assert_array_equal(points.beam, [0, 31, 19])
    np.testing.assert_array_equal(points.sensor, 0)
    np.testing.assert_array_equal(points.camera, -1)
    np.testing.assert_array_equal(record.info.rig.scores(points), [False, True, True])


def test_only_points_within_the_cars_outline_are_left_out(tmp_path):
    (back, front), (right, left) = lidar.CAR
    inside = [(back + 0.01, 0), (front - 0.01, 0), (0, right + 0.01), (0, left - 0.01)]
    outside = [(back - 0.01, 0), (front + 0.01, 0), (0, right - 0.01), (0, left + 0.01)]
    values = np.zeros((8, 5), "<f4")
    values[:, :2] = inside + outside
    path = tmp_path / "sweep.bin"
    path.write_bytes(values.tobytes())
    xyz = lidar.read_sweep(path, np.eye(4), np.eye(4)).xyz

    np.testing.assert_allclose(xyz[:, :2], outside, atol=1e-6)


def test_boxes_are_as_long_as_they_head(nuscenes):
    record, _ = read_all(nuscenes)
    boxes = record.tracks.set_index(["frame", "track"])
    box = boxes.loc[(1, "driving")]

    place = box[["x", "y", "z"]].to_numpy(float) + record.info.origin
    np.testing.assert_allclose(place, [396, 1204, 0.9])
    assert box[["width", "length", "height"]].tolist() == [1.9, 4.6, 1.7]
    assert box["yaw"] == pytest.approx(90)
    assert box["label"] == "vehicle.car"
    assert boxes.loc[(0, "barrier"), "yaw"] == pytest.approx(-30)
    assert len(boxes) == 3 * 6


def test_attributes_say_what_moves_and_else_speed_does(nuscenes):
    record, _ = read_all(nuscenes)
    moving = record.tracks.groupby("track")["moving"].agg(["all", "any"])

    # `standing` drifts at 0.8 m/s, but its attribute is the data's word; the rider of a cycle
    # may wait, at 0.2 m/s.
    expected = {"driving", "rider"}
    assert set(moving.index[moving["any"]]) == set(moving.index[moving["all"]]) == expected


def test_what_moves_later_moves_in_a_range_too(nuscenes):
    whole, _ = read_all(nuscenes)
    record, frames = read_all(nuscenes, "scene-0061@0-0")

    assert [frame.frame for frame in frames] == [0]
    first = whole.tracks[whole.tracks["frame"] == 0].reset_index(drop=True)
    assert record.tracks.equals(first)
    assert record.tracks.set_index("track")["moving"]["rider"]


def test_sweeps_between_keyframes_have_no_boxes(nuscenes):
    record, frames = read_all(nuscenes, sweeps=True)

    # At 0.3 s and 0.8 s no camera took an image.
    seconds = [frame.timestamp - START / 1e6 for frame in frames]
    assert seconds == pytest.approx([0, 0.2, 0.5, 0.7, 1.0], abs=1e-6)
    assert sorted(record.tracks["frame"].unique()) == [0, 2, 4]
    assert list(record.extras.no_label_zones) == [1, 3]
    camera, (_, early, _) = frames[1].cameras["CAM_FRONT"], CAMERAS["CAM_FRONT"]
    centre = camera.centre + record.info.origin
    np.testing.assert_allclose(centre, [400, 1180 + 10 * (0.2 - early / 1e6) + 1.5, 1.5])
    keyframes, _ = read_all(nuscenes)
    columns = [name for name in record.tracks if name != "frame"]
    assert record.tracks[columns].equals(keyframes.tracks[columns])


def test_a_sweep_that_one_camera_missed_is_no_frame(nuscenes):
    def edit(data):
        return [record for record in data if record["token"] != "CAM_BACK-200"]

    rewrite(nuscenes, sample_data=edit)

    record, _ = read_all(nuscenes, sweeps=True)
    assert list(record.extras.no_label_zones) == [2]
    assert record.frame_count == 4


def test_images_of_jittering_times_find_their_sweep(nuscenes):
    def edit(data):
        late = {"CAM_BACK_LEFT-200": 12_000, "CAM_FRONT-200": -12_000}
        return [
            record | {"timestamp": record["timestamp"] + late.get(record["token"], 0)}
            for record in data
        ]

    rewrite(nuscenes, sample_data=edit)

    assert read_all(nuscenes, sweeps=True)[0].frame_count == 5


def test_a_range_of_sweeps_alone_is_refused(nuscenes):
    assert read_all(nuscenes, "scene-0061@1-2", sweeps=True)[0].frame_count == 2
    with pytest.raises(
        GeoEvsError,
        match=r"no boxes in frames 1 to 1, .* one of the keyframes \(0, 2, 4\)",
    ):
        read_all(nuscenes, "scene-0061@1-1", sweeps=True)


def test_the_test_split_has_no_boxes(nuscenes):
    (nuscenes / FOLDER).rename(nuscenes / "v1.0-test")
    for name in ("sample_annotation", "instance"):
        (nuscenes / f"v1.0-test/{name}.json").write_text("[]\n")
    record, frames = read_all(nuscenes, version="v1.0-test")

    assert len(frames) == 3
    assert not len(record.tracks)
    assert list(record.extras.no_label_zones) == [0, 1, 2]


def test_a_store_keeps_it_all(nuscenes, tmp_path):
    masks = tmp_path / "masks"
    masks.mkdir()
    picture = np.zeros((90, 160, 3), np.uint8)
    picture[80:] = 255
    Image.fromarray(picture).save(masks / "CAM_BACK.png")
    source = Source(18, 32, folder=str(nuscenes), sweeps=True, ego_masks=str(masks))
    record = source.open(SceneRef("scene-0061"))
    write_coloured_scene(tmp_path / "store", tmp_path / "depths", record, lambda: None)
    scene = Scene(tmp_path / "store")

    assert scene.cameras == NAMES
    assert scene.frames == (0, 1, 2, 3, 4)
    assert scene.info.licence == "CC BY-NC-SA 4.0 (nuScenes)"
    assert not scene.info.redistribute
    assert list(scene.no_label_zones) == [1, 3]
    assert list(scene.ego_masks) == ["CAM_BACK"]
    assert scene.ego_masks["CAM_BACK"][16:].all()  # 80 of 90 rows are 16 of 18
    assert not scene.ego_masks["CAM_BACK"][:16].any()
    early = CAMERAS["CAM_BACK"][1] / 1e6
    assert scene.exposure("CAM_BACK", 2).time == pytest.approx(START / 1e6 + 0.5 - early, abs=1e-6)
    # All three points lie before the front camera, less than 12 degrees off its axis.
    red = np.array(CAMERAS["CAM_FRONT"][2]) / 255
    np.testing.assert_array_equal(scene.points(0).camera, 0)
    np.testing.assert_allclose(scene.points(0).rgb, [red] * 3, atol=0.015)


def test_masks_are_resized_without_grey(nuscenes, tmp_path):
    rng = np.random.default_rng(0)
    large = rng.integers(0, 2, (90, 160)).astype(np.uint8) * 255
    Image.fromarray(large).save(tmp_path / "CAM_FRONT.png")
    record, _ = read_all(nuscenes, ego_masks=str(tmp_path))

    small = cv2.resize(large, (32, 18), interpolation=cv2.INTER_NEAREST) > 0
    np.testing.assert_array_equal(record.extras.ego_masks["CAM_FRONT"], small)


def test_options_are_checked_by_name():
    source = load_source("nuscenes", 18, 32, {"folder": "x", "version": "v1.0-test"})
    assert source.version == "v1.0-test"
    with pytest.raises(GeoEvsError, match=r"did you mean 'v1.0-mini'"):
        load_source("nuscenes", 18, 32, {"folder": "x", "version": "v1.0-mimi"})


def test_its_files_are_the_tables_and_masks(tmp_path):
    source = Source(18, 32, folder=str(tmp_path), ego_masks=str(tmp_path / "m"))
    assert list(source.files(SceneRef("x"))) == [tmp_path / "v1.0-mini", tmp_path / "m"]
    with pytest.raises(GeoEvsError, match="has no dense truth"):
        source.truth(SceneRef("x"), [])


def test_a_table_in_pieces_is_the_table(nuscenes, monkeypatch):
    whole, _ = read_all(nuscenes)
    monkeypatch.setattr(tables, "PIECE", 700)
    monkeypatch.setattr(tables, "LONGEST_RECORD", 600)
    pieces, _ = read_all(nuscenes)

    assert pieces.tracks.equals(whole.tracks)


def test_a_table_of_one_line_or_none_is_read(nuscenes):
    for path in (nuscenes / FOLDER).glob("*.json"):
        path.write_text("\ufeff  " + "".join(path.read_text().split("\n")) + "\n\n")
    assert len(read_all(nuscenes)[1]) == 3


def test_quaternions_turn_to_the_left():
    record = tables.Record({"rotation": turn(30), "translation": [1, 2, 3]}, "here")
    cos, sin = np.cos(np.radians(30)), 0.5
    expected = [[cos, -sin, 0, 1], [sin, cos, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(record.pose, expected, atol=1e-12)
    camera = tables.Record({"rotation": facing(0)}, "here").rotation
    np.testing.assert_allclose(camera, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
