import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import TRACK_COLUMNS, SceneRef, load_source
from geoevs.scenes.sources.pandaset.calibration import pose_matrix
from geoevs.scenes.sources.pandaset.source import Source
from geoevs.scenes.store import Scene, write_scene

CAMERAS = ("front_camera", "front_left_camera", "front_right_camera", "back_camera")


def read_all(folder: Path, scene: str = "777"):
    """The record and the frames of `scene`, at 16 x 24 pixels."""
    record = Source(16, 24, folder=str(folder)).open(SceneRef.parse(scene))
    return record, list(record.frames)


def refusal(folder: Path, scene: str = "777") -> str:
    """The one-line sentence that reading `scene` is refused with."""
    with pytest.raises(GeoEvsError) as caught:
        read_all(folder, scene)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def edit_json(path: Path, edit) -> None:
    value = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(edit(value)), encoding="utf-8")


def test_reads_every_frame_that_is_on_disk(pandaset):
    record, frames = read_all(pandaset)

    assert record.info.name == "777"
    assert record.info.cameras == CAMERAS
    assert record.info.rig.lidar_split == "sensor"
    assert "CC BY 4.0" in record.info.licence
    assert record.frame_count == 2
    assert [frame.frame for frame in frames] == [3, 4]
    assert [frame.timestamp for frame in frames] == pytest.approx([100.3, 100.4])
    for frame in frames:
        assert tuple(frame.cameras) == tuple(frame.images) == CAMERAS
        for name in CAMERAS:
            assert frame.images[name].shape == (16, 24, 3)
            assert frame.cameras[name].name == name
        difference = frame.images["front_left_camera"].astype(int) - (40, 200, 40)
        assert np.abs(difference).max() <= 3  # JPEG's rounding


def test_sweep_keeps_world_coordinates_and_tells_the_lidars_apart(pandaset):
    record, frames = read_all(pandaset)
    points = frames[0].points

    np.testing.assert_array_equal(points.xyz, [[11, 2, 3], [11, 3, 5], [21, 2, 3]])
    np.testing.assert_array_equal(points.sensor, [0, 0, 1])
    np.testing.assert_array_equal(points.beam, 0)
    np.testing.assert_array_equal(points.camera, -1)
    np.testing.assert_array_equal(record.info.rig.scores(points), [True, True, False])


def test_intrinsics_move_to_our_pixel_centres_before_they_scale(pandaset):
    _, frames = read_all(pandaset)

    # 96 x 54 pixels become 24 x 16: (47.5 + 0.5) / 4 = 12 and (26.5 + 0.5) * 16 / 54 = 8.
    expected = [[98.5 / 4, 0, 12], [0, 98.5 * 16 / 54, 8], [0, 0, 1]]
    np.testing.assert_allclose(frames[0].cameras["front_camera"].K, expected)


def test_pose_projects_points_where_they_belong(pandaset):
    _, frames = read_all(pandaset)
    camera = frames[0].cameras["front_camera"]

    np.testing.assert_allclose(camera.centre, [1, 2, 3])
    np.testing.assert_allclose(camera.optical_axis, [1, 0, 0], atol=1e-12)
    # Both 10 m ahead, the second 1 m to the left and 2 m up.
    world = np.array([[11, 2, 3, 1], [11, 3, 5, 1]], float)
    seen = world @ camera.camera_from_world.T[:, :3] @ camera.K.T
    np.testing.assert_allclose(
        seen[:, :2] / seen[:, 2:], [[12, 8], [12 - 2.4625, 8 - 0.2 * 98.5 * 16 / 54]]
    )


def test_a_turn_about_world_z_is_a_turn_to_the_left():
    half = np.radians(30) / 2
    heading = {"w": np.cos(half), "x": 0, "y": 0, "z": np.sin(half)}
    matrix = pose_matrix({"heading": heading, "position": {"x": 0, "y": 0, "z": 0}})

    np.testing.assert_allclose(matrix[:2, 0], [np.cos(np.radians(30)), 0.5])


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_only_unit_quaternions_are_poses(quaternion):
    unit = np.array(quaternion) / np.linalg.norm(quaternion)
    position = {"x": 1, "y": 2, "z": 3}

    def camera(q: np.ndarray) -> Camera:
        heading = dict(zip("wxyz", q.tolist(), strict=True))
        return Camera(np.eye(3), pose_matrix({"heading": heading, "position": position}), 1, 1)

    np.testing.assert_allclose(camera(unit).centre, [1, 2, 3])
    np.testing.assert_allclose(
        camera(-unit).world_from_camera, camera(unit).world_from_camera, atol=1e-12
    )
    with pytest.raises(GeoEvsError, match="not rigid"):
        camera(unit * 1.01)


def test_boxes_head_along_their_length(pandaset):
    record, _ = read_all(pandaset)
    boxes = record.tracks[record.tracks["frame"] == 3].set_index("track")

    assert tuple(record.tracks) == TRACK_COLUMNS
    # PandaSet: yaw 0 is along world y, counter-clockwise; y is the length, x the width.
    parked = boxes.loc["parked"]
    assert parked[["x", "y", "z", "length", "width", "height"]].tolist() == [
        *(5.0, 1.0, 0.5),
        *(4.5, 1.8, 1.5),
    ]
    assert parked["yaw"] == pytest.approx(90)
    assert abs(boxes.loc["moving-0", "yaw"]) == pytest.approx(180)
    assert boxes.loc["walker-1", "yaw"] == pytest.approx(45)
    assert record.tracks["yaw"].between(-180, 180).all()


def test_a_pair_of_boxes_is_one_track(pandaset):
    record, _ = read_all(pandaset)
    boxes = record.tracks[record.tracks["frame"] == 3].set_index("track")

    # `walker-1` keeps its own name: the sibling it names has no box in these frames.
    assert sorted(boxes.index) == ["moving-0", "parked", "walker-1"]
    assert boxes.loc["moving-0", "x"] == 9.0
    assert boxes["moving"].to_dict() == {"parked": False, "moving-0": True, "walker-1": True}


def test_a_track_keeps_its_name_where_only_the_front_lidar_saw_it(pandaset, pandaset_files):
    columns = pandaset_files.cuboid_columns()
    columns = {label: np.delete(cells, 1) for label, cells in columns.items()}
    path = pandaset / "777/annotations/cuboids/04.pkl.gz"
    pandaset_files.write_gzip(path, pandaset_files.old_pickle(columns))
    record, _ = read_all(pandaset)

    boxes = record.tracks.set_index(["frame", "track"])
    assert boxes.loc[(3, "moving-0"), "x"] == 9.0
    assert boxes.loc[(4, "moving-0"), "x"] == 9.4


def test_frames_without_boxes_are_fine(pandaset, pandaset_files):
    columns = {label: cells[:0] for label, cells in pandaset_files.cuboid_columns().items()}
    for frame in (3, 4):
        path = pandaset / f"777/annotations/cuboids/{frame:02d}.pkl.gz"
        pandaset_files.write_gzip(path, pandaset_files.old_pickle(columns))

    assert len(read_all(pandaset)[0].tracks) == 0


@pytest.mark.parametrize(("scene", "expected"), [("777@3-3", [3]), ("777@3-4", [3, 4])])
def test_a_range_takes_its_frames_only(pandaset, scene, expected):
    record, frames = read_all(pandaset, scene)

    assert [frame.frame for frame in frames] == expected
    assert record.frame_count == len(expected)
    assert sorted(set(record.tracks["frame"])) == expected


@pytest.mark.parametrize("file", ["lidar/04.pkl.gz", "camera/back_camera/04.jpg"])
def test_missing_sweeps_and_images_are_named(pandaset, file):
    (pandaset / "777" / file).unlink()

    assert str(pandaset / "777" / file) in refusal(pandaset)
    assert str(pandaset / "777" / file) in refusal(pandaset, "777@3-4")
    assert len(read_all(pandaset, "777@3-3")[1]) == 1


def test_a_range_beyond_the_files_names_the_first_that_is_missing(pandaset):
    sentence = refusal(pandaset, "777@2-4")

    assert str(pandaset / "777/lidar/02.pkl.gz") in sentence
    assert "3 to 4 are on disk" in sentence


@pytest.mark.parametrize(
    ("file", "edit", "reason"),
    [
        ("camera/front_camera/intrinsics.json", lambda k: k | {"fx": 0.0}, "focal length"),
        ("camera/front_camera/intrinsics.json", lambda k: {"fx": 1.0}, "'fy'"),
        (
            "camera/front_camera/intrinsics.json",
            lambda k: k | {"cx": None},
            "cx is None, no finite",
        ),
        ("camera/back_camera/poses.json", lambda p: p[:4], "4 entries, too few for frame 4"),
        ("camera/back_camera/poses.json", lambda p: {}, "too few"),
        (
            "camera/back_camera/poses.json",
            lambda p: [{**q, "heading": {"w": 2.0, "x": 0, "y": 0, "z": 0}} for q in p],
            "not rigid",
        ),
        (
            "camera/back_camera/poses.json",
            lambda p: [{**q, "position": {"x": float("nan"), "y": 0, "z": 0}} for q in p],
            "x is nan, no finite number",
        ),
        ("camera/back_camera/poses.json", lambda p: [None] * len(p), "download it again"),
        ("camera/back_camera/timestamps.json", lambda t: t[:4], "too few for frame 4"),
        ("lidar/timestamps.json", lambda t: t[:4], "too few for frame 4"),
        ("lidar/timestamps.json", lambda t: ["noon"] * 5, "noon"),
    ],
)
def test_bad_calibration_names_its_file(pandaset, file, edit, reason):
    edit_json(pandaset / "777" / file, edit)
    sentence = refusal(pandaset)

    assert str(pandaset / "777" / file) in sentence
    assert reason in sentence


@pytest.mark.parametrize(
    ("file", "reason"),
    [
        ("camera/front_camera/intrinsics.json", "is missing"),
        ("camera/front_left_camera/poses.json", "is missing"),
        ("annotations/cuboids/03.pkl.gz", "is missing"),
    ],
)
def test_other_missing_files_are_named(pandaset, file, reason):
    (pandaset / "777" / file).unlink()
    sentence = refusal(pandaset)

    assert str(pandaset / "777" / file) in sentence
    assert reason in sentence


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (lambda s: s | {"x": np.array([1, np.nan, np.inf])}, "2 of 3 points"),
        (lambda s: s | {"z": np.array([1, 1, 1e300])}, "1 of 3 points"),
        (lambda s: s | {"d": np.array([0, 1, 2])}, "neither 0 nor 1"),
        (lambda s: s | {"y": np.array(["a", "b", "c"], object)}, "something else than numbers"),
        (lambda s: s | {"x": np.array([True, True, False])}, "else than numbers in 'x'"),
        (lambda s: s | {"d": np.array([False, False, True])}, "else than numbers in 'd'"),
        (lambda s: {label: s[label] for label in "xyz"}, "no column 'd'"),
    ],
)
def test_bad_sweeps_are_named_with_their_count(pandaset, pandaset_files, edit, reason):
    path = pandaset / "777/lidar/04.pkl.gz"
    raw = pandaset_files.old_pickle(edit(pandaset_files.sweep_columns()))
    pandaset_files.write_gzip(path, raw)
    sentence = refusal(pandaset)

    assert str(path) in sentence
    assert reason in sentence


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (lambda c: c | {"yaw": np.array([0, np.nan, 0, 0])}, "1 boxes"),
        (lambda c: {k: v for k, v in c.items() if k != "uuid"}, "no column 'uuid'"),
        (lambda c: c | {"yaw": np.array(["north"] * 4, object)}, "something else than numbers"),
        (lambda c: c | {"dimensions.y": np.zeros(4)}, "'length' of 4 boxes is no side of a box"),
        (lambda c: c | {"dimensions.x": -c["dimensions.x"]}, "'width' of 4 boxes"),
        (lambda c: c | {"dimensions.z": np.array([1, 1, 1, 500.0])}, "'height' of 1 boxes"),
        (lambda c: c | {"yaw": np.array([0, 0, 90.0, 0])}, "'yaw' of 1 boxes is no angle"),
        (lambda c: c | {"stationary": np.array(["False"] * 4, object)}, "not true or false"),
        (lambda c: c | {"stationary": np.array([1, 0, 0, 0])}, "'stationary' that is not true or"),
        (lambda c: c | {"label": np.array([None] * 4, object)}, "'label' that is not text"),
        (lambda c: c | {"cuboids.sibling_id": np.array([None] * 4, object)}, "that is not text"),
        (lambda c: c | {"cuboids.sensor_id": np.ones(4, bool)}, "numbers in 'cuboids.sensor_id'"),
        (lambda c: c | {"cuboids.sensor_id": np.array([0, 1, 2, 3])}, "is not -1, 0 or 1"),
        (lambda c: c | {"uuid": np.array(["a", "a", "b", "c"], object)}, "two boxes of one track"),
    ],
)
def test_bad_boxes_are_named(pandaset, pandaset_files, edit, reason):
    path = pandaset / "777/annotations/cuboids/04.pkl.gz"
    raw = pandaset_files.old_pickle(edit(pandaset_files.cuboid_columns()))
    pandaset_files.write_gzip(path, raw)
    sentence = refusal(pandaset)

    assert str(path) in sentence
    assert reason in sentence


@pytest.mark.parametrize("camera", ["front_camera", "right_camera", "back_camera"])
@pytest.mark.parametrize("scale", [0.5, 0.9, 2])
def test_images_of_another_size_than_their_intrinsics_are_named(pandaset, camera, scale):
    folder = pandaset / "777/camera"
    if camera == "right_camera":
        (folder / "front_left_camera").rename(folder / "x")
        shutil.copytree(folder / "x", folder / "front_left_camera")
        (folder / "x").rename(folder / camera)
        edit_json(folder / camera / "intrinsics.json", lambda k: k | {"fx": 46.125, "fy": 46.125})
        edit_json(folder / camera / "poses.json", lambda p: [turned(q) for q in p])
    assert len(read_all(pandaset)[1]) == 2
    size = round(96 * scale), round(54 * scale)
    path = folder / camera / "04.jpg"
    Image.open(path).resize(size).save(path)
    assert (
        f"{path} is {size[0]} x {size[1]}, but the focal lengths in intrinsics.json belong to an "
        in (refusal(pandaset))
    )


def turned(pose: dict) -> dict:
    """A pose on the other side."""
    heading = {"w": 0.0, "x": 0.0, "y": 0.5**0.5, "z": -(0.5**0.5)}
    return {"position": pose["position"], "heading": heading}


def test_released_images_under_halved_intrinsics_are_named(pandaset):
    folder = pandaset / "777/camera/back_camera"
    for frame in (3, 4):
        Image.new("RGB", (1920, 1080)).save(folder / f"{frame:02d}.jpg")
    half = {"fx": 467.0, "fy": 467.0, "cx": 479.5, "cy": 269.5}
    edit_json(folder / "intrinsics.json", lambda k: half)
    assert "03.jpg is 1920 x 1080, but the focal lengths in intrinsics.json belong to" in refusal(
        pandaset
    )
    edit_json(folder / "intrinsics.json", lambda k: {n: 2 * v for n, v in half.items()})
    assert len(read_all(pandaset)[1]) == 2


def test_a_principal_point_outside_the_image_is_named(pandaset):
    path = pandaset / "777/camera/front_camera/intrinsics.json"
    edit_json(path, lambda k: k | {"cx": -300.0})
    assert f"{path}: camera 'front_camera' has its principal point at (-299.5" in refusal(pandaset)


def test_a_scene_far_from_its_origin_is_moved_there(pandaset, pandaset_files, tmp_path):
    shift = np.array([500_000.25, 4_649_776.5, -1200.75])

    def moved(columns, names):
        return columns | {
            name: columns[name] + metres for name, metres in zip(names, shift, strict=True)
        }

    near, frames = read_all(pandaset)
    for path in (pandaset / "777").rglob("poses.json"):
        edit_json(path, lambda poses: [moved_pose(pose, shift) for pose in poses])
    for frame in (3, 4):
        sweep = moved(pandaset_files.sweep_columns(), "xyz")
        boxes = moved(pandaset_files.cuboid_columns(), [f"position.{axis}" for axis in "xyz"])
        for file, columns in (("lidar", sweep), ("annotations/cuboids", boxes)):
            path = pandaset / f"777/{file}/{frame:02d}.pkl.gz"
            pandaset_files.write_gzip(path, pandaset_files.old_pickle(columns))
    far, others = read_all(pandaset)

    assert near.info.origin == (0, 0, 0)
    assert far.info.origin == (500_001, 4_649_778, -1198)
    back = np.array(far.info.origin) - shift
    np.testing.assert_allclose(far.tracks[["x", "y", "z"]] + back, near.tracks[["x", "y", "z"]])
    for frame, other in zip(frames, others, strict=True):
        np.testing.assert_allclose(other.points.xyz + back, frame.points.xyz, atol=1e-6)
        for name in CAMERAS:
            centre = other.cameras[name].centre + back
            np.testing.assert_allclose(centre, frame.cameras[name].centre, atol=1e-6)
    write_scene(tmp_path / "store", far.info, far.tracks, iter(others))
    assert Scene(tmp_path / "store").info.origin == far.info.origin


def moved_pose(pose: dict, shift: np.ndarray) -> dict:
    place = {
        axis: pose["position"][axis] + metres for axis, metres in zip("xyz", shift, strict=True)
    }
    return pose | {"position": place}


@pytest.mark.parametrize("sensor", ["camera/front_camera", "camera/back_camera"])
def test_one_pose_that_is_far_off_is_that_sensors_fault(pandaset, sensor):
    path = pandaset / f"777/{sensor}/poses.json"
    edit_json(path, lambda poses: [moved_pose(pose, np.array([1e7, 0, 0])) for pose in poses])
    assert f"{path}: camera '{path.parent.name}' stands more than 10 km" in refusal(pandaset)


@pytest.mark.parametrize("sensor", [0, 1])
def test_a_sweep_without_one_of_the_lidars_is_named(pandaset, pandaset_files, sensor):
    columns = pandaset_files.sweep_columns()
    columns = {name: cells[columns["d"] != sensor] for name, cells in columns.items()}
    path = pandaset / "777/lidar/03.pkl.gz"
    pandaset_files.write_gzip(path, pandaset_files.old_pickle(columns))
    name = ("Pandar64, which scores", "PandarGT, which may condition")[sensor]
    assert f"{path} has no points of d = {sensor} ({name}" in refusal(pandaset)


def test_what_archives_leave_behind_is_no_camera_and_no_frame(pandaset):
    (pandaset / "777/camera/__MACOSX/front_camera").mkdir(parents=True)
    (pandaset / "777/camera/.DS_Store").write_bytes(b"x")
    for file in ("camera/front_camera/._03.jpg", "lidar/._03.pkl.gz", "lidar/\u00b2\u00b2.pkl.gz"):
        (pandaset / "777" / file).write_bytes(b"x")
    record, frames = read_all(pandaset)
    assert record.info.cameras == CAMERAS
    assert [frame.frame for frame in frames] == [3, 4]


def test_left_and_right_swapped_are_told_by_their_poses(pandaset, tmp_path):
    folder = pandaset / "777/camera"
    for old, new in (("left", "x"), ("right", "left"), ("x", "right")):
        (folder / f"front_{old}_camera").rename(folder / f"front_{new}_camera")
    record, frames = read_all(pandaset)
    with pytest.raises(GeoEvsError, match="'front_left_camera' is the left one but looks 45 deg"):
        write_scene(tmp_path / "store", record.info, record.tracks, iter(frames))


def test_too_many_cameras_are_refused_before_they_are_read(pandaset):
    for number in range(127):
        folder = pandaset / f"777/camera/c{number}"
        shutil.copytree(pandaset / "777/camera/back_camera", folder)
    with pytest.raises(GeoEvsError, match="has 131 cameras; a scene has 1 to 127"):
        Source(16, 24, folder=str(pandaset)).open(SceneRef("777"))


def test_a_range_of_a_billion_frames_ends_at_the_first_that_is_missing(pandaset):
    assert "05.pkl.gz is missing" in refusal(pandaset, "777@3-999999")


def test_a_truncated_image_is_named(pandaset):
    path = pandaset / "777/camera/front_camera/03.jpg"
    path.write_bytes(path.read_bytes()[:-40])

    assert f"{path} is not a whole PNG or JPEG image" in refusal(pandaset)


def test_a_missing_rig_camera_is_named(pandaset):
    folder = pandaset / "777/camera/front_left_camera"
    folder.rename(folder.with_name("top_camera"))

    assert str(folder) in refusal(pandaset)


def test_other_cameras_follow_the_known_ones_by_name(pandaset):
    folder = pandaset / "777/camera"
    (folder / "back_camera").rename(folder / "a_camera")

    assert read_all(pandaset)[0].info.cameras == (*CAMERAS[:3], "a_camera")


def test_the_folder_may_hold_an_environment_variable(pandaset, monkeypatch):
    for missing in (None, "", str(pandaset / "nowhere")):
        if missing is None:
            monkeypatch.delenv("GEOEVS_PANDASET", raising=False)
        else:
            monkeypatch.setenv("GEOEVS_PANDASET", missing)
        with pytest.raises(GeoEvsError, match="set GEOEVS_PANDASET to the folder that holds"):
            read_all("$GEOEVS_PANDASET")

    monkeypatch.setenv("GEOEVS_PANDASET", str(pandaset))
    assert len(read_all("$GEOEVS_PANDASET")[1]) == 2
    assert str(pandaset / "778") in refusal("${GEOEVS_PANDASET}", "778")


def test_an_empty_sequence_is_named(tmp_path):
    for name in CAMERAS[:3]:
        (tmp_path / "777/camera" / name).mkdir(parents=True)

    assert str(tmp_path / "777") in refusal(tmp_path)


def test_found_by_name_and_has_no_truth(pandaset):
    source = load_source("pandaset", 16, 24, {"folder": str(pandaset)})

    assert not source.has_truth
    with pytest.raises(GeoEvsError, match="no dense truth"):
        source.truth(SceneRef("777"), [])


def test_what_it_reads_makes_a_scene_store(pandaset, tmp_path):
    record = Source(16, 24, folder=str(pandaset)).open(SceneRef("777"))
    write_scene(tmp_path / "store", record.info, record.tracks, record.frames)
    scene = Scene(tmp_path / "store")

    assert scene.cameras == CAMERAS
    assert scene.frames == (3, 4)
    assert len(scene.points(3)) == 3
    assert list(scene.tracks) == list(TRACK_COLUMNS)
