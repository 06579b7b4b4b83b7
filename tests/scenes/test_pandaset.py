import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
        (lambda s: s | {"y": np.array(["a", "b", "c"], object)}, "text where numbers belong"),
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
        (lambda c: c | {"yaw": np.array(["north"] * 4, object)}, "text where numbers belong"),
    ],
)
def test_bad_boxes_are_named(pandaset, pandaset_files, edit, reason):
    path = pandaset / "777/annotations/cuboids/04.pkl.gz"
    raw = pandaset_files.old_pickle(edit(pandaset_files.cuboid_columns()))
    pandaset_files.write_gzip(path, raw)
    sentence = refusal(pandaset)

    assert str(path) in sentence
    assert reason in sentence


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
