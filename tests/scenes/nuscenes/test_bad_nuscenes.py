"""Broken nuScenes folders: one sentence each, with the file and the record."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from geoevs.core.errors import GeoEvsError
from geoevs.projection.coloured_scenes import write_coloured_scene
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.nuscenes import lidar
from geoevs.scenes.sources.nuscenes.source import Source
from tests.fuzzing import SHARE, changed, edit_bytes, edit_json, refused
from tests.scenes.nuscenes.writer import FOLDER, POINTS

IMAGE = "samples/CAM_BACK/CAM_BACK-500.jpg"
SWEEP = "samples/LIDAR_TOP/LIDAR_TOP-500.pcd.bin"


def refusal(folder, scene="scene-0061", **options) -> str:
    """The one-line sentence that reading `scene` is refused with, before or while frames come."""
    with pytest.raises(GeoEvsError) as caught:
        list(Source(18, 32, folder=str(folder), **options).open(SceneRef.parse(scene)).frames)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def edit(folder, table, token, **fields):
    """Change fields of a record; None removes one."""
    path = folder / FOLDER / f"{table}.json"
    records = json.loads(path.read_text())
    (record,) = [record for record in records if record["token"] == token]
    record |= fields
    for field in [field for field, value in fields.items() if value is None]:
        del record[field]
    path.write_text(json.dumps(records))
    return path


@pytest.mark.parametrize(
    ("table", "token", "field", "to"),
    [
        ("scene", "here", "first_sample_token", "sample"),
        ("sample", "sample-1", "next", "sample"),
        ("sample_data", "CAM_BACK-500", "calibrated_sensor_token", "calibrated_sensor"),
        ("sample_data", "CAM_BACK-500", "ego_pose_token", "ego_pose"),
        ("calibrated_sensor", "calibrated-CAM_BACK", "sensor_token", "sensor"),
        ("sample_annotation", "box-rider-1", "instance_token", "instance"),
        ("instance", "rider", "category_token", "category"),
    ],
)
def test_records_that_point_nowhere(nuscenes, table, token, field, to):
    path = edit(nuscenes, table, token, **{field: "nowhere"})
    sentence = refusal(nuscenes)

    assert f"{path}: record '{token}' names 'nowhere' as its {field}" in sentence
    assert f"{to}.json does not have" in sentence


def test_an_attribute_that_is_nowhere(nuscenes):
    path = edit(nuscenes, "sample_annotation", "box-rider-1", attribute_tokens=["nowhere"])
    assert f"{path}: record 'box-rider-1' names an attribute that attribute.json" in refusal(
        nuscenes
    )


@pytest.mark.parametrize(
    "table",
    [
        *("scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor"),
        *("sample_annotation", "instance", "category", "attribute"),
    ],
)
def test_a_missing_table(nuscenes, table):
    path = nuscenes / FOLDER / f"{table}.json"
    path.unlink()
    assert f"{path} is missing" in refusal(nuscenes)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('[{"token": "a"}, {"token": ', "record 1 is no JSON object"),
        ('[{"token": "a"}', "is no JSON list of records (see after record 1)"),
        ('[{"token": "a"},]', "record 1 is no JSON object"),
        ('[{"token": "a"}] x', "is no JSON list of records (see after record 1)"),
        ('{"token": "a"}', "is no JSON list of records (see after record 0)"),
        ("[1]", "record 0 is no JSON object"),
        ("", "is no JSON list of records"),
        ('[{"name": "scene-0061"}]', "record 0 has no token"),
        ("[" * 10**6, "record 0 is no JSON object"),
        ('[{"a": "\ud800"}]', "is no JSON"),
        ('[{"token": "a", "b": "' + "x" * 2**25 + '"}]', "record 0 is no JSON object"),
    ],
)
def test_tables_that_are_none(nuscenes, text, reason):
    path = nuscenes / FOLDER / "scene.json"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    sentence = refusal(nuscenes)

    assert str(path) in sentence
    assert reason in sentence


@pytest.mark.parametrize(("table", "token"), [("sample", "sample-1"), ("instance", "rider")])
def test_a_token_that_stands_there_twice(nuscenes, table, token):
    path = nuscenes / FOLDER / f"{table}.json"
    records = json.loads(path.read_text())
    path.write_text(json.dumps([*records, *(r for r in records if r["token"] == token)]))
    assert f"{path}: record '{token}' stands there twice" in refusal(nuscenes)


@pytest.mark.parametrize("back", ["sample-0", "sample-1", "sample-2"])
def test_a_chain_that_loops(nuscenes, back):
    path = edit(nuscenes, "sample", "sample-2", next=back)
    assert f"{path}: record 'sample-2' names a sample before it as the next" in refusal(nuscenes)


def test_a_chain_that_ends_early(nuscenes):
    path = edit(nuscenes, "sample", "sample-1", next="")
    assert f"{path}: record 'sample-1' names no next sample, but the scene has 1 more" in refusal(
        nuscenes
    )


def test_a_chain_into_another_scene(nuscenes):
    path = edit(nuscenes, "sample", "sample-1", next="elsewhere")
    assert f"{path}: record 'sample-1' names 'elsewhere' as its next" in refusal(nuscenes)


def test_a_scene_that_is_not_there_or_twice(nuscenes):
    assert "has no scene 'scene-0062'; did you mean 'scene-0061'?" in refusal(
        nuscenes, "scene-0062"
    )
    path = edit(nuscenes, "scene", "there", name="scene-0061")
    assert f"{path}: record 'here' is another scene 'scene-0061'" in refusal(nuscenes)


def test_a_range_beyond_the_scene(nuscenes):
    assert "scene 'scene-0061' has no frame 3; choose from 0 to 2" in refusal(
        nuscenes, "scene-0061@2-999999"
    )
    assert "has no frame 7; choose from 0 to 2" in refusal(nuscenes, "scene-0061@7-8")


def test_folders_that_are_not_there(nuscenes, tmp_path):
    assert "there is no nuScenes folder" in refusal(tmp_path / "x")
    sentence = refusal(nuscenes, version="v1.0-trainval")
    assert f"{nuscenes / 'v1.0-trainval'} is missing" in sentence
    assert "(v1.0-mini)" in sentence
    assert "(there is none)" in refusal(tmp_path)


@pytest.mark.parametrize("channel", ["CAM_BACK", "LIDAR_TOP"])
def test_a_sample_without_a_sensors_keyframe(nuscenes, channel):
    edit(nuscenes, "sample_data", f"{channel}-500", is_key_frame=False)
    sentence = refusal(nuscenes)
    assert f"sample.json: record 'sample-1' has no keyframe of {channel}" in sentence


def test_a_sample_with_two_keyframes_of_a_sensor(nuscenes):
    path = edit(nuscenes, "sample_data", "CAM_BACK-200", is_key_frame=True)
    sentence = refusal(nuscenes)
    assert f"{path}: record 'CAM_BACK-500' is a second keyframe of CAM_BACK" in sentence


@pytest.mark.parametrize("file", [IMAGE, SWEEP])
def test_a_missing_file_is_named_before_any_is_read(nuscenes, file):
    (nuscenes / file).unlink()
    source = Source(18, 32, folder=str(nuscenes))
    with pytest.raises(GeoEvsError, match=rf"{file} is missing"):
        source.open(SceneRef("scene-0061"))
    assert source.open(SceneRef("scene-0061", 0, 0)).frame_count == 1


@pytest.mark.parametrize("name", ["../outside.jpg", "/etc/passwd", "samples/../../x", "a\0b", 7])
def test_paths_that_leave_the_folder(nuscenes, name):
    (nuscenes.parent / "outside.jpg").write_bytes(b"x")
    path = edit(nuscenes, "sample_data", "CAM_BACK-500", filename=name)
    sentence = refusal(nuscenes)
    assert f"{path}: record 'CAM_BACK-500'" in sentence
    assert "'filename'" in sentence or "leads out of" in sentence or "is no path" in sentence


def sweep(row=0, column=0, value=0.0) -> bytes:
    """The sweep with one value changed."""
    points = POINTS.copy()
    points[row, column] = value
    return points.tobytes()


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (sweep()[:-1], "has 79 bytes, but a sweep has 20 for each"),
        (b"", "has 0 bytes"),
        (sweep(1, 0, np.nan), "1 of 4 points"),
        (sweep(3, 2, np.inf), "1 of 4 points"),
        (sweep(2, 1, 1e7), "1 of 4 points"),
        (sweep(0, 4, 32), "ring is none of 0 to 31"),
        (sweep(0, 4, 0.5), "ring is none of 0 to 31"),
        (sweep(0, 4, np.nan), "ring is none of 0 to 31"),
    ],
)
def test_broken_sweeps(nuscenes, raw, reason):
    (nuscenes / SWEEP).write_bytes(raw)
    sentence = refusal(nuscenes)

    assert str(nuscenes / SWEEP) in sentence
    assert reason in sentence


def test_a_sweep_of_gigabytes_is_not_read(nuscenes, monkeypatch):
    monkeypatch.setattr(lidar, "LARGEST_SWEEP", 60)
    assert "has 80 bytes" in refusal(nuscenes)


def test_images_that_are_cut_off_or_of_another_size(nuscenes):
    Image.new("RGB", (80, 45)).save(nuscenes / IMAGE)
    sentence = refusal(nuscenes)
    assert f"{nuscenes / IMAGE} is 80 x 45, but" in sentence
    assert "record 'CAM_BACK-500' says otherwise" in sentence
    (nuscenes / IMAGE).write_bytes((nuscenes / IMAGE).read_bytes()[:200])
    assert f"{nuscenes / IMAGE} is not a whole PNG or JPEG" in refusal(nuscenes)


BACK, POSE, BOX = "calibrated-CAM_BACK", "pose-CAM_BACK-500", "box-rider-1"


@pytest.mark.parametrize(
    ("table", "token", "fields", "reason"),
    [
        ("ego_pose", POSE, {"rotation": [1, 0, 0, 0.1]}, "the length 1.00499, not 1"),
        ("ego_pose", POSE, {"rotation": [0, 0, 0, 0]}, "the length 0, not 1"),
        ("ego_pose", POSE, {"rotation": [1, 0, 0]}, "no 4 numbers as 'rotation'"),
        ("ego_pose", POSE, {"rotation": [1, 0, 0, "0"]}, "rotation is '0', no finite number"),
        ("ego_pose", POSE, {"translation": [0, float("nan"), 0]}, "translation is nan"),
        ("ego_pose", POSE, {"translation": [1e7, 0, 0]}, "from where the scene begins"),
        ("ego_pose", POSE, {"translation": None}, "no 3 numbers as 'translation'"),
        ("ego_pose", "pose-LIDAR_TOP-500", {"translation": [1e7, 0, 0]}, "1e+07 m from where"),
        ("calibrated_sensor", BACK, {"translation": [0, 1e7, 0]}, "1e+07 m from the car"),
        ("calibrated_sensor", BACK, {"rotation": [2, 0, 0, 0]}, "the length 2, not 1"),
        ("calibrated_sensor", BACK, {"camera_intrinsic": []}, "no 3 x 3 numbers"),
        ("calibrated_sensor", BACK, {"camera_intrinsic": [[1, 2, 3]] * 3}, "skew or an odd"),
        ("calibrated_sensor", BACK, {"camera_intrinsic": np.eye(3).tolist()}, "focal lengths"),
        ("sample_data", "CAM_BACK-500", {"is_key_frame": 1}, "neither true nor false"),
        ("sample_data", "CAM_BACK-500", {"timestamp": "noon"}, "the timestamp is 'noon'"),
        ("sample_data", "CAM_BACK-500", {"timestamp": -1}, "the timestamp is -1e-06"),
        ("sample_data", "CAM_BACK-500", {"filename": None}, "has no text as 'filename'"),
        ("sample_annotation", BOX, {"rotation": [0, 0, 0, 3]}, "the length 3, not 1"),
        ("sample_annotation", BOX, {"translation": [1e7, 0, 0]}, "beyond 10 km"),
        ("sample_annotation", BOX, {"size": [0, 1, 1]}, "'width' of 1 boxes is no side"),
        ("sample_annotation", BOX, {"size": [1, 500, 1]}, "'length' of 1 boxes is no side"),
        ("sample_annotation", BOX, {"size": [1, 1]}, "no 3 numbers as 'size'"),
        ("sample_annotation", BOX, {"attribute_tokens": "x"}, "no list of texts"),
        ("sample_annotation", BOX, {"attribute_tokens": None}, "no list of texts"),
        ("sample_annotation", BOX, {"instance_token": "driving"}, "two boxes of one track"),
    ],
)
def test_records_that_cannot_be(nuscenes, table, token, fields, reason):
    path = edit(nuscenes, table, token, **fields)
    sentence = refusal(nuscenes)

    shown = str(path) if "two boxes" in reason else f"{path}: record '{token}'"
    assert shown in sentence
    assert reason in sentence


def test_frames_out_of_the_order_of_their_time(nuscenes, tmp_path):
    edit(nuscenes, "sample_data", "LIDAR_TOP-500", timestamp=10)
    record = Source(18, 32, folder=str(nuscenes)).open(SceneRef("scene-0061"))
    with pytest.raises(GeoEvsError, match="frame 1 of scene 'scene-0061': the timestamp is"):
        write_coloured_scene(tmp_path / "store", tmp_path / "depths", record, lambda: None)
    assert not (tmp_path / "store").exists()


def test_masks_that_are_none(nuscenes, tmp_path):
    masks = tmp_path / "masks"
    assert f"{masks} has no masks of the car" in refusal(nuscenes, ego_masks=str(masks))
    masks.mkdir()
    Image.new("L", (16, 9)).save(masks / "CAM_BAK.png")
    sentence = refusal(nuscenes, ego_masks=str(masks))
    assert "CAM_BAK.png is named after no camera of nuScenes; did you mean 'CAM_BACK'" in sentence
    (masks / "CAM_BAK.png").rename(masks / "CAM_BACK.png").write_bytes(b"x")
    assert "CAM_BACK.png is not a whole PNG" in refusal(nuscenes, ego_masks=str(masks))


@SHARE
@given(data=st.data())
def test_a_broken_folder_is_imported_or_refused(nuscenes, data):
    with changed(nuscenes) as folder:
        files = [path for path in sorted(folder.rglob("*")) if path.suffix != ".pcd"]
        files = [path for path in files if path.is_file() and path.stat().st_size]
        path = data.draw(st.sampled_from(files), "file")
        table = path.suffix == ".json" and json.loads(path.read_text())
        if table and data.draw(st.booleans(), "as a table"):
            edit_json(path, data, {})
        else:
            edit_bytes(path, data)
        root = folder.parents[1]

        def load():
            options = {"folder": str(folder), "sweeps": data.draw(st.booleans(), "sweeps")}
            record = Source(18, 32, **options).open(SceneRef("scene-0061", 0, 1))
            write_coloured_scene(root / "store", root / "depths", record, lambda: None)

        failed = refused(load)
        left = sorted(entry.name for entry in root.iterdir())
        assert left == (["given"] if failed else ["depths", "given", "store"])
