import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json
from geoevs.core.images import to_uint8, write_image
from geoevs.methods.tiny import tiny_camera, write_tiny_scene
from geoevs.projection import project_points
from geoevs.scenes.camera import Camera
from geoevs.scenes.camera_json import camera_from_json
from geoevs.scenes.scene import TRACK_COLUMNS, Frame, PointCloud, Rig, SceneInfo, SceneRef
from geoevs.scenes.store import Scene, write_scene

RIG = Rig("front", "left", "right", "beam")
INFO = SceneInfo("a", "made up", "CC0-1.0", RIG, ("front",), tags=("curve", "low sun"))
TRACKS = pd.DataFrame([], columns=list(TRACK_COLUMNS))


def odd_camera(name="front") -> Camera:
    """Unequal focal lengths, a principal point off the middle, and no axis alone."""
    pose = tiny_camera(name, 33.0, np.array([1 / 3, -200.1, 1e-7])).world_from_camera
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    return Camera([[71.3, 0, 3.1], [0, 64.9, 5.7], [0, 0, 1]], pose, 6, 8, name)


def odd_frame(number=7) -> Frame:
    rng = np.random.default_rng(number)
    points = PointCloud(
        rng.normal(size=(5, 3)).astype(np.float32),
        rng.random((5, 3)).astype(np.float32),
        np.array([0, -1, 0, 0, -1], np.int8),
        np.array([0, 1, 0, 255, 1], np.uint8),
        np.array([0, 1, 2, 65535, 4], np.uint16),
    )
    image = rng.integers(0, 256, (6, 8, 3), np.uint8)
    return Frame(number, 0.1 + number / 3, {"front": odd_camera()}, {"front": image}, points)


@pytest.fixture
def tiny(tmp_path):
    return write_tiny_scene(tmp_path / "tiny")


def refusal(action) -> str:
    with pytest.raises(GeoEvsError) as caught:
        action()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def edit(path: Path, change) -> None:
    value = read_json(path)
    change(value)
    write_json(path, value)


def test_a_scene_survives_bit_for_bit(tmp_path):
    frames = [odd_frame(7), odd_frame(12)]
    tracks = pd.DataFrame(
        [(7, "t", "car", 1 / 3, -0.0, 1e-9, 4.5, 1.8, 1.5, -179.9, True)], columns=TRACK_COLUMNS
    )
    write_scene(tmp_path / "a", INFO, tracks, iter(frames))
    scene = Scene(tmp_path / "a")
    assert scene.info == INFO
    assert scene.frames == (7, 12)
    pd.testing.assert_frame_equal(scene.tracks, tracks)
    for frame in frames:
        camera = scene.camera("front", frame.frame)
        np.testing.assert_array_equal(camera.K, odd_camera().K)
        np.testing.assert_array_equal(camera.world_from_camera, odd_camera().world_from_camera)
        assert (camera.height, camera.width, camera.name) == (6, 8, "front")
        assert scene.timestamp(frame.frame) == frame.timestamp
        image = to_uint8(scene.image("front", frame.frame))
        np.testing.assert_array_equal(image, frame.images["front"])
        for name, array in dataclasses.asdict(scene.points(frame.frame)).items():
            assert array.dtype == getattr(frame.points, name).dtype
            np.testing.assert_array_equal(array, getattr(frame.points, name))


def test_writing_twice_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_scene(tmp_path / name, INFO, TRACKS, iter([odd_frame()]))
    files = [path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*")]
    assert len(files) == 6
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def nerfstudio_pixel(folder: Path, frame: dict, point: np.ndarray) -> np.ndarray:
    """A world point's pixel by the rules of nerfstudio's `nerfstudio-data` parser and cameras.

    Intrinsics are each frame's own where the top level has none, `file_path` is relative to the
    folder, distortion is k1 to k4, p1, p2 with 0 for those absent, `transform_matrix` takes
    cameras (y up, z backward) to the world, and the ray through image coordinates (x, y), pixel
    centres at +0.5, is ((x - cx) / fx, -(y - cy) / fy, -1).
    """
    meta = json.loads((folder / "transforms.json").read_text())
    assert meta["camera_model"] == "OPENCV"
    assert not {"fl_x", "fl_y", "cx", "cy", "w", "h", "applied_transform"} & meta.keys()
    assert (folder / frame["file_path"]).is_file()
    assert [frame.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "p1", "p2")] == [0.0] * 6
    pose = np.array(frame["transform_matrix"])
    x, y, z = pose[:3, :3].T @ (point - pose[:3, 3])
    assert z < 0
    fx, fy, cx, cy = (float(frame[name]) for name in ("fl_x", "fl_y", "cx", "cy"))
    return np.array([cx + fx * x / -z, cy - fy * y / -z])


def seen_points(scene: Scene, name: str, frame: int) -> np.ndarray:
    """Some LiDAR points that a camera gave its colour."""
    cloud = scene.points(frame)
    return cloud.xyz[cloud.camera == scene.cameras.index(name)][::50].astype(np.float64)


def test_nerfstudio_sees_the_same_pixels(tiny):
    listed = read_json(tiny.folder / "transforms.json")["frames"]
    assert len({frame["file_path"] for frame in listed}) == len(listed) == 6
    for frame in listed:
        points = seen_points(tiny, frame["camera"], frame["frame"])
        assert len(points) > 10
        uv, _ = project_points(points, tiny.camera(frame["camera"], frame["frame"]))
        found = [nerfstudio_pixel(tiny.folder, frame, point) for point in points]
        np.testing.assert_allclose(found, uv, atol=1e-9)


def test_colmap_sees_the_same_pixels(tiny):
    for frame in read_json(tiny.folder / "transforms.json")["frames"]:
        names = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")
        camera = pycolmap.Camera(
            model="OPENCV",
            width=frame["w"],
            height=frame["h"],
            params=[frame[name] for name in names],
        )
        # COLMAP's cameras are OpenCV's: y down, z forward.
        pose = np.array(frame["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0])
        world_from_camera = pycolmap.Rigid3d(pose[:3])
        points = seen_points(tiny, frame["camera"], frame["frame"])
        found = camera.img_from_cam(world_from_camera.inverse() * points)
        uv, _ = project_points(points, tiny.camera(frame["camera"], frame["frame"]))
        np.testing.assert_allclose(found, uv, atol=1e-6)


def test_an_empty_scene_is_not_written(tmp_path):
    sentence = refusal(lambda: write_scene(tmp_path / "a", INFO, TRACKS, iter([])))
    assert sentence == "scene 'a' has no frames; check its frame range"
    assert list(tmp_path.iterdir()) == []


def test_frames_that_do_not_fit_the_scene_are_refused(tmp_path):
    def write(**changes):
        frame = dataclasses.replace(odd_frame(), **changes)
        return refusal(lambda: write_scene(tmp_path / "a", INFO, TRACKS, iter([frame])))

    assert write(cameras={}).startswith("frame 7 of scene 'a' has no camera 'front'; supply it")
    assert write(images={}).startswith("frame 7 of scene 'a' has no camera 'front'; supply it")
    small = {"front": np.zeros((3, 4, 3), np.uint8)}
    assert "'front' is 6 x 8 but its image is 3 x 4; resize them together" in write(images=small)
    points = odd_frame().points
    points.xyz[2, 1] = np.nan
    assert "1 of 5 LiDAR points are NaN or infinite" in write(points=points)
    assert list(tmp_path.iterdir()) == []


def test_cameras_that_a_scene_does_not_declare_are_left_out(tmp_path):
    frame = odd_frame()
    frame.cameras["rear"] = odd_camera("rear")
    write_scene(tmp_path / "a", INFO, TRACKS, iter([frame]))
    assert {entry["camera"] for entry in read_json(tmp_path / "a/transforms.json")["frames"]} == {
        "front"
    }


@pytest.mark.parametrize(
    ("file", "text", "sentence"),
    [
        ("scene.json", "{", "scene.json is not valid JSON"),
        ("scene.json", "[]", "scene.json describes no scene"),
        (
            "scene.json",
            '{"name": "a"}',
            "scene.json describes no scene ('source'); remake the store",
        ),
        ("transforms.json", "[]", "transforms.json lists no views"),
        ("transforms.json", '{"frames": []}', "transforms.json has no frames; remake the store"),
        ("transforms.json", '{"frames": [{"frame": 1}]}', "has a view without 'camera' or 'frame'"),
    ],
)
def test_a_corrupt_store_is_refused_when_opened(tiny, file, text, sentence):
    (tiny.folder / file).write_text(text)
    found = refusal(lambda: Scene(tiny.folder))
    assert sentence in found
    assert str(tiny.folder / file) in found


@pytest.mark.parametrize("file", ["scene.json", "transforms.json"])
def test_a_folder_without_its_lists_is_no_store(tiny, file):
    (tiny.folder / file).unlink()
    found = refusal(lambda: Scene(tiny.folder))
    assert found.startswith(f"{tiny.folder / file} is missing; ")


def test_a_camera_that_one_frame_lacks_is_named(tiny):
    path = tiny.folder / "transforms.json"
    edit(path, lambda value: value["frames"].pop(4))  # front, left, right of 0, then front of 1
    assert refusal(lambda: Scene(tiny.folder)) == (
        f"{path} has no camera 'left' in frame 1; add the image or remove the frame"
    )


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda view: view.pop("fl_x"), "camera 'front' lacks 'fl_x'; add it"),
        (lambda view: view.update(fl_x="wide"), "'front': fl_x is 'wide', no finite number"),
        (
            lambda view: view.update(transform_matrix=[[1]]),
            "has a transform_matrix that is not 4 x 4",
        ),
        (lambda view: view.update(cx=float("nan")), "'front': cx is nan, no finite number"),
    ],
)
def test_a_wrong_calibration_names_file_and_camera(tiny, change, sentence):
    path = tiny.folder / "transforms.json"
    edit(path, lambda value: change(value["frames"][0]))
    found = refusal(lambda: Scene(tiny.folder).camera("front", 0))
    assert found.startswith(f"{path}: ")
    assert sentence in found


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda view: view.update(k1=0.3), "the lens distortion k1 = 0.3; undistort its images"),
        (lambda view: view.update(p2=-1e-9), "the lens distortion p2 = -1e-09"),
        (lambda view: view.update(k3="no"), "k3 is 'no', no finite number"),
        (lambda view: view.update(camera_model="OPENCV_FISHEYE"), "model 'OPENCV_FISHEYE'; undi"),
        (lambda view: view.update(h=float("nan")), "size that is no whole number"),
        (lambda view: view.update(w=2**70), "resize its image"),
        (lambda view: view.update(fl_x=10**400), "fl_x is too large, no finite number"),
        (lambda view: view.update(frame=-1), "frame -1 is no whole number from 0"),
        (lambda view: view.update(frame=0.0), "frame 0.0 is no whole number"),
        (lambda view: view.update(timestamp=None), "the timestamp is None"),
        (lambda view: view.update(timestamp=-1.0), "count seconds from 0 upwards"),
        (lambda view: view.pop("file_path"), "camera 'front' in frame 0 lacks 'file_path'"),
        (lambda view: view.update(file_path="../../x.png"), "'../../x.png' leads out of"),
        (lambda view: view.update(file_path="/etc/passwd"), "'/etc/passwd' leads out of"),
        (lambda view: view.update(file_path=["x"]), "is no path"),
        (lambda view: view.update(file_path="images/front/000009.png"), "09.png is missing; copy"),
        (lambda view: view.update(file_path="images/left/000000.png"), "another view's image"),
    ],
)
def test_what_a_store_cannot_hold_is_refused_when_it_is_opened(tiny, change, sentence):
    path = tiny.folder / "transforms.json"
    edit(path, lambda value: change(value["frames"][0]))
    found = refusal(lambda: Scene(tiny.folder))
    assert str(tiny.folder) in found
    assert sentence in found


def test_distortion_that_all_views_share_is_refused(tiny):
    path = tiny.folder / "transforms.json"
    edit(path, lambda value: value.update(k2=0.01))
    assert "the camera of all views has the lens distortion k2 = 0.01" in refusal(
        lambda: Scene(tiny.folder)
    )


def test_a_view_that_stands_there_twice_is_refused(tiny):
    path = tiny.folder / "transforms.json"
    edit(path, lambda value: value["frames"].append(value["frames"][2]))
    assert "camera 'right' in frame 0 stands there twice" in refusal(lambda: Scene(tiny.folder))


def test_frames_are_in_the_order_of_their_time(tiny):
    def turn_back(value):
        for view in value["frames"]:
            view["timestamp"] = 5.0 - view["frame"]

    edit(tiny.folder / "transforms.json", turn_back)
    assert "frame 1: the timestamp is 4.000000, but the frame before has 5.000000" in refusal(
        lambda: Scene(tiny.folder)
    )


def test_an_image_of_another_size_than_its_camera_is_refused(tiny):
    write_image(tiny.folder / "images/left/000001.png", np.zeros((24, 36, 3), np.uint8))
    assert "000001.png is 24 x 36, but transforms.json says 48 x 72; resize" in refusal(
        lambda: tiny.image("left", 1)
    )


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"name": "../x"}, "scene '../x' is not an allowed name"),
        ({"cameras": ["front", "../../x"]}, "camera '../../x' is not an allowed name"),
        ({"cameras": ["front", "front"]}, "a camera is listed twice"),
        ({"cameras": []}, "the scene has 0 cameras; a scene has 1 to 127"),
        ({"cameras": "front"}, "'cameras' is no list"),
        ({"cameras": [f"c{number}" for number in range(130)]}, "the scene has 130 cameras"),
        ({"rig": {"front": "front"}}, "describes no scene ('front_left')"),
        ({"rig": None}, "describes no scene (no Rig)"),
        ({"licence": 5}, "the licence is no text"),
        ({"origin": [0, 0]}, "the origin is no list of three metres"),
        ({"origin": [0, 0, "up"]}, "the origin is 'up', no finite number"),
        ({"tags": "night"}, "'tags' is no list"),
        ({"tags": [7]}, "the tag 7 is no text"),
        ({"tags": [""]}, "the tag '' is no text"),
        ({"tags": ["two\nlines"]}, "the tag 'two lines' is no text"),
        ({"tags": ["x" * 101]}, "is no text of 1 to 100 characters"),
        ({"frames": 8}, "describes no scene ('frames')"),
    ],
)
def test_a_description_that_cannot_be_is_refused(tiny, change, sentence):
    edit(tiny.folder / "scene.json", lambda value: value.update(change))
    found = refusal(lambda: Scene(tiny.folder))
    assert found.startswith(str(tiny.folder / "scene.json"))
    assert sentence in found


def test_a_store_without_an_origin_or_tags_has_none(tiny):
    edit(tiny.folder / "scene.json", lambda value: (value.pop("origin"), value.pop("tags")))
    assert Scene(tiny.folder).info == dataclasses.replace(tiny.info, tags=())
    assert tiny.info.origin == (0.0, 0.0, 0.0)


def test_a_world_with_y_up_is_refused_in_these_words(tiny):
    turn = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # z becomes y

    def turned(value):
        for view in value["frames"]:
            view["transform_matrix"] = (turn @ np.array(view["transform_matrix"])).tolist()

    edit(tiny.folder / "transforms.json", turned)
    found = refusal(lambda: Scene(tiny.folder))
    assert "frame 0: the world's z is not up, for the cameras' upward axes point along y;" in found
    assert "nerfstudio" in found


def test_unknown_cameras_and_frames_are_named(tiny):
    sentence = refusal(lambda: tiny.image("frnt", 0))
    assert sentence == (
        "scene 'tiny' has no camera 'frnt'; did you mean 'front'? (one of: front, left, right)"
    )
    assert refusal(lambda: tiny.image("front", 9)) == (
        "scene 'tiny' has no frame 9 (it has 0 to 1)"
    )


@pytest.mark.parametrize("share", [0.0, 0.3, 0.98])
@pytest.mark.parametrize(
    ("file", "read"),
    [
        ("lidar/000001.npz", lambda scene: scene.points(1)),
        ("images/left/000001.png", lambda scene: scene.image("left", 1)),
        ("tracks.parquet", lambda scene: scene.tracks),
    ],
)
def test_missing_and_truncated_files_are_named(tiny, file, read, share):
    path = tiny.folder / file
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    assert refusal(lambda: read(tiny)).startswith(f"{path} is not ")
    path.unlink()
    assert refusal(lambda: read(tiny)).startswith(f"{path} is missing; ")


def test_an_archive_of_something_else_is_named(tiny):
    path = tiny.folder / "lidar/000000.npz"
    np.savez(path, xyz=np.zeros((1, 3)))
    assert refusal(lambda: tiny.points(0)).startswith(f"{path} has no array 'rgb'; add it")


def test_an_unknown_lidar_split_is_refused():
    sentence = refusal(lambda: Rig("front", "left", "right", "sensors"))
    assert sentence.startswith("there is no lidar_split 'sensors'; did you mean 'sensor'?")


@pytest.mark.parametrize("text", ["", ".", "..", "../a", "a/b", "/a", "a b", "a'b", "-a", "a@"])
def test_scene_names_that_leave_their_folder_or_need_quotes_are_refused(text):
    assert f"scene '{text}' is not of the form NAME or NAME@FIRST-LAST" in refusal(
        lambda: SceneRef.parse(text)
    )


@pytest.mark.parametrize("span", ["1", "1-", "-1", "2-1", "a-b", "1-2-3", "²-3", "1-2@3-4"])
def test_frame_ranges_that_are_none_are_refused(span):
    refusal(lambda: SceneRef.parse(f"002@{span}"))


def test_frame_ranges_by_hand():
    ref = SceneRef.parse("002@59-70")
    assert ref == ("002", 59, 70)
    assert [ref.holds(frame) for frame in (58, 59, 70, 71)] == [False, True, True, False]
    assert SceneRef.parse("002").holds(10**9)
    assert ref.overlaps(SceneRef.parse("002@70-80"))
    assert ref.overlaps(SceneRef.parse("002"))
    assert not ref.overlaps(SceneRef.parse("002@71-80"))
    assert not ref.overlaps(SceneRef.parse("003"))


def test_a_camera_from_json_needs_no_store(tmp_path):
    entry = {"fl_x": 1.0}
    assert refusal(lambda: camera_from_json(entry, "c", tmp_path / "x.json")).startswith(
        f"{tmp_path / 'x.json'}: camera 'c' lacks 'cx'"
    )
