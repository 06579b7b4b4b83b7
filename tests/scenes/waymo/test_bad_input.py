"""What the source refuses: each in one sentence that names the file and the record or row."""

import shutil
import struct
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.waymo import matrices, parquet
from geoevs.scenes.sources.waymo.source import Source
from tests.scenes.waymo.world import NAME, rigid
from tests.scenes.waymo.writers import (
    record,
    sub,
    v1_frame,
    v1_image,
    v1_sweep,
    whole,
    write_v1,
    write_v2,
)

FAR = rigid(np.eye(3), [1e7, 0, 0])


def refusal(folder: Path, scene: str = NAME) -> str:
    """The one-line sentence that reading `scene` is refused with."""
    with pytest.raises(GeoEvsError) as caught:
        list(Source(64, 96, folder=str(folder)).open(SceneRef.parse(scene)).frames)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700
    return str(caught.value)


@pytest.fixture(params=["v1", "v2"])
def version(request):
    return request.param


def write(version: str, folder: Path, segment) -> Path:
    if version == "v1":
        write_v1(folder / "some.tfrecord", segment)
        return folder / "some.tfrecord"
    return write_v2(folder, segment)


def test_the_folder_is_named_where_it_or_the_segment_is_missing(tmp_path, small_segment):
    assert f"there is no Waymo folder '{tmp_path / 'x'}'" in refusal(tmp_path / "x")
    assert f"there is no segment '{NAME}' in {tmp_path}; set GEOEVS_WAYMO" in refusal(tmp_path)
    (tmp_path / "y.tfrecord").write_bytes(b"1234567")
    sentence = refusal(tmp_path)
    assert "y.tfrecord: record 0: the file ends within the record's length" in sentence
    assert "1 such files" in sentence


def test_a_segment_twice_or_in_both_versions_is_refused(tmp_path, small_segment):
    write_v1(tmp_path / "a.tfrecord", small_segment)
    write_v1(tmp_path / f"segment-{NAME}.tfrecord", small_segment)
    assert f"is there twice, as {tmp_path / 'a.tfrecord'} and as" in refusal(tmp_path)
    (tmp_path / "a.tfrecord").unlink()
    write_v2(tmp_path, small_segment)
    assert "is there in both versions, as" in refusal(tmp_path)
    shutil.rmtree(tmp_path / "camera_image")
    assert "is there in both versions, as" in refusal(tmp_path)


def test_two_segments_in_a_file_are_refused(tmp_path, small_segment):
    other = small_segment.copy()
    other.name = "2000_000_000_020_000"
    data = record(v1_frame(small_segment, 0)) + record(v1_frame(other, 1))
    (tmp_path / "some.tfrecord").write_bytes(data)
    assert f"record 1 is of segment '{other.name}', not of '{NAME}'" in refusal(tmp_path)
    (tmp_path / "some.tfrecord").unlink()
    write_v2(tmp_path, other)
    for path in tmp_path.glob("*/*.parquet"):
        path.rename(path.with_name(f"{NAME}.parquet"))
    assert f"has rows of segment '{other.name}', not of '{NAME}'" in refusal(tmp_path)


def test_a_range_beyond_the_frames_is_refused(waymo_folder):
    assert "has frames 0 to 1, not 1 to 2; name a range" in refusal(waymo_folder, f"{NAME}@1-2")


@pytest.mark.parametrize("where", ["header", "data", "last checksum"])
def test_a_truncated_record_is_named(tmp_path, small_segment, where):
    path = write("v1", tmp_path, small_segment)
    first = len(record(v1_frame(small_segment, 0)))
    size = path.stat().st_size
    cut = {"header": first + 7, "data": first + 100, "last checksum": size - 2}[where]
    path.write_bytes(path.read_bytes()[:cut])
    assert f"{path}: record 1: the file ends within the record" in refusal(tmp_path)


def test_two_frames_of_one_time_are_refused(tmp_path, version, small_segment):
    segment = small_segment.copy()
    segment.frames[1]["time"] = segment.frames[0]["time"]
    write(version, tmp_path, segment)
    expected = {"v1": "records 0 and 1 have the same time", "v2": "are of one "}
    assert expected[version] in refusal(tmp_path)


CHANGES = {
    "no image of camera 'side_left'": lambda s: s.frames[1]["images"].pop(4),
    "no calibration of camera 'side_left'": lambda s: s.cameras.pop(4),
    "LiDAR 'rear' has no calibration": lambda s: s.lasers.pop(5),
    "there is no camera 8, only 1 to 5": lambda s: s.cameras.update({8: s.cameras[1]}),
    "there is no LiDAR 9, only 1 to 5": lambda s: s.lasers.update({9: s.lasers[1]}),
    "intrinsic of camera 'front' is not nine finite numbers": lambda s: s.cameras[1].update(
        intrinsic=[np.nan] * 9
    ),
    "camera 'front' has a focal length that is not": lambda s: s.cameras[1].update(
        intrinsic=[-200.0, *s.cameras[1]["intrinsic"][1:]]
    ),
    "the image of camera 'front' has 128 x 192 pixels, its calibration 129 x 192": lambda s: (
        s.cameras[1].update(height=129)
    ),
    "the image of camera 'side_left' is not a whole PNG or JPEG image": lambda s: s.frames[1][
        "images"
    ][4].update(jpeg=b"\xff\xd8\xff no picture"),
    "extrinsic of camera 'front' is no rigid transform": lambda s: s.cameras[1].update(
        extrinsic=np.diag([2.0, 2, 2, 1])
    ),
    "extrinsic of LiDAR 'top' lies 1e+07 m from": lambda s: s.lasers[1].update(extrinsic=FAR),
    "the vehicle's pose lies 1e+07 m from the world's origin": lambda s: s.frames[1].update(
        pose=FAR
    ),
    "the vehicle's pose is not 16 finite numbers": lambda s: s.frames[0].update(
        pose=np.full((4, 4), np.nan)
    ),
    "the pose of camera 'front' lies 1e+07 m": lambda s: s.frames[1]["images"][1].update(pose=FAR),
    "camera 'front' stands more than 10 km": lambda s: s.frames[1]["images"][1].update(
        pose=rigid(np.eye(3), [3e5, 0, 0])
    ),
    "points of LiDAR 'top' are NaN, infinite or more than 10 km": lambda s: s.frames[1]["sweeps"][
        1
    ]["poses"].__setitem__((..., 3), 1e7),
    "a range image has 60 rows, but its LiDAR 64 beams": lambda s: s.frames[1]["sweeps"][1].update(
        first=s.frames[1]["sweeps"][2]["first"], poses=None
    ),
    "'length' of 1 boxes is no side of a box": lambda s: s.frames[1]["labels"]["car"].update(
        box=[1, 2, 3, 0, 1, 1, 0]
    ),
    "'x' of 1 boxes is beyond 10 km": lambda s: s.frames[1]["labels"]["car"].update(
        box=[1e7, 0, 3, 4, 1, 1, 0]
    ),
    "'yaw' of 1 boxes is no angle": lambda s: s.frames[1]["labels"]["car"].update(
        box=[1, 2, 3, 4, 1, 1, np.nan]
    ),
    "a box is of type 77, and there are 0 to 4": lambda s: s.frames[1]["labels"]["car"].update(
        type=77
    ),
    "two boxes of one track": lambda s: s.frames[1]["labels"]["car"].update(track="bus"),
    "more than 1 s from its pose": lambda s: s.frames[1]["images"][1].update(pose_time=0.0),
    "a camera reads out in direction 0": lambda s: s.cameras[1].update(readout=0),
}


@pytest.mark.parametrize("what", CHANGES)
def test_what_cannot_be_is_named_in_either_version(tmp_path, version, small_segment, what):
    segment = small_segment.copy()
    if "points of LiDAR" in what:
        sweep = segment.frames[1]["sweeps"][1]
        sweep["poses"] = sweep["poses"].copy()
    CHANGES[what](segment)
    path = write(version, tmp_path, segment)
    sentence = refusal(tmp_path)

    assert what in sentence
    assert str(path) in sentence  # of version 2, the folder
    place = {
        "v1": (": record ", "calibration", "frame 1"),
        "v2": (": row ", "calibration", "frame"),
    }
    assert any(part in sentence for part in place[version])


V1_CHANGES = {
    "a zone without labels has points that are NaN or more than 10 km": lambda s: s.frames[
        1
    ].update(zones=[np.array([[1e7, 0], [0, 0], [1, 1]])]),
    "a zone without labels is no polygon": lambda s: s.frames[1].update(zones=[np.zeros((0, 2))]),
    "the map has points that are NaN or more than 10 km": lambda s: s.map_features.append(
        (3, 8, np.array([[np.nan, 0, 0]]))
    ),
}


@pytest.mark.parametrize("what", V1_CHANGES)
def test_zones_and_maps_that_cannot_be_are_named(tmp_path, small_segment, what):
    segment = small_segment.copy()
    segment.map_features = list(segment.map_features)
    V1_CHANGES[what](segment)
    path = write("v1", tmp_path, segment)
    sentence = refusal(tmp_path)
    assert what in sentence
    assert str(path) in sentence


def test_no_map_is_fine(tmp_path, small_segment):
    segment = small_segment.copy()
    segment.map_features = []
    write("v1", tmp_path, segment)
    assert not Source(64, 96, folder=str(tmp_path)).open(SceneRef(NAME)).extras.road_map


def with_fields(small_segment, extra: bytes, folder: Path) -> Path:
    """A file of two records, more fields behind the second one's."""
    path = folder / "some.tfrecord"
    frames = [v1_frame(small_segment, 0), v1_frame(small_segment, 1) + extra]
    path.write_bytes(b"".join(map(record, frames)))
    return path


def lying(dims) -> bytes:
    raw = sub(1, bytes(4 * 24)) + sub(2, b"".join(whole(1, side) for side in dims))
    return sub(5, whole(1, 2) + sub(2, sub(2, zlib.compress(raw))))


@pytest.mark.parametrize(
    ("extra", "what"),
    [
        (sub(4, whole(1, 1)), "the pose of camera 'front' is not 16 finite numbers"),
        (sub(4, sub(1, b"front")), "field 1 is no whole number"),
        (sub(5, whole(1, 77) + sub(2, sub(2, b"x"))), "there is no LiDAR 77"),
        (sub(6, sub(1, b"") + sub(11, b"BACK")), "a box names camera 'back'; one of: front,"),
        (b"\x0b", "a field in it is of the kind 3"),
        (b"\x0a\x7f", "field 1 is longer than what holds it"),
    ],
)
def test_damaged_records_are_named(tmp_path, small_segment, extra, what):
    segment = small_segment.copy()
    if extra.startswith(sub(4, b"")[:1]):
        segment.frames[1]["images"] = {}
    path = with_fields(segment, extra, tmp_path)
    sentence = refusal(tmp_path)
    assert what in sentence
    assert f"{path}: record 1" in sentence


def only_sweep(small_segment, sweep: bytes, folder: Path) -> Path:
    segment = small_segment.copy()
    segment.frames[1]["sweeps"] = {}
    return with_fields(segment, sweep, folder)


@pytest.mark.parametrize("dims", [(6, 1, 8), (2, 3, 5), (2**31, 2**31, 4), (24,)])
def test_dims_that_lie_are_named(tmp_path, small_segment, dims):
    path = only_sweep(small_segment, lying(dims), tmp_path)
    assert f"{path}: record 1: a range image is damaged (24 values do not fill" in refusal(tmp_path)


def test_a_bomb_is_named(tmp_path, small_segment, monkeypatch):
    monkeypatch.setattr(matrices, "MOST_MATRIX_BYTES", 2**22)
    bomb = sub(5, whole(1, 2) + sub(2, sub(2, zlib.compress(bytes(2**24)))))
    path = only_sweep(small_segment, bomb, tmp_path)
    assert f"{path}: record 1 has a range image that unpacks to more than 4 MiB" in refusal(
        tmp_path
    )


def test_two_sweeps_or_images_of_one_sensor_are_named(tmp_path, small_segment):
    sweep = sub(5, v1_sweep(2, small_segment.frames[1]["sweeps"][2]))
    path = with_fields(small_segment, sweep, tmp_path)
    assert f"{path}: record 1 is damaged (it has two sweeps of LiDAR 'front')" in refusal(tmp_path)
    image = sub(4, v1_image(1, small_segment.frames[1]["images"][1]))
    with_fields(small_segment, image, tmp_path)
    assert f"{path}: record 1 is damaged (it has two images of camera 'front')" in refusal(tmp_path)


@pytest.mark.parametrize("tag", ["camera_image", "lidar", "lidar_pose", "camera_calibration"])
def test_two_rows_of_one_sensor_are_named(tmp_path, small_segment, tag):
    write_v2(tmp_path, small_segment)
    path = tmp_path / tag / f"{NAME}.parquet"
    table = pq.read_table(path)
    pq.write_table(pa.concat_tables([table, table.slice(0, 1)]), path)
    assert f"{path}: row 0 and row {len(table)} are of one " in refusal(tmp_path)


@pytest.mark.parametrize(
    ("tag", "column"),
    [
        ("vehicle_pose", "key.frame_timestamp_micros"),
        ("camera_image", "[CameraImageComponent].image"),
        ("camera_calibration", "[CameraCalibrationComponent].intrinsic.k3"),
        ("lidar", "[LiDARComponent].range_image_return2.shape"),
        ("lidar_pose", "key.laser_name"),
        ("lidar_box", "[LiDARBoxComponent].box.heading"),
    ],
)
def test_a_component_that_is_missing_or_damaged_is_named(tmp_path, small_segment, tag, column):
    write_v2(tmp_path, small_segment)
    path = tmp_path / tag / f"{NAME}.parquet"
    whole_file = path.read_bytes()
    path.write_bytes(whole_file[: len(whole_file) // 2])
    assert f"{path} is not whole or not laid out as Waymo's" in refusal(tmp_path)
    table = pq.read_table(pa.BufferReader(whole_file))
    pq.write_table(table.drop_columns([column]), path)
    assert f"{path} has no column '{column}'; download it again" in refusal(tmp_path)
    path.unlink()
    assert f"{path} is missing; download the component '{tag}'" in refusal(tmp_path)


def test_text_where_numbers_belong_is_named(tmp_path, small_segment):
    write_v2(tmp_path, small_segment)
    path = tmp_path / "lidar_box" / f"{NAME}.parquet"
    table = pq.read_table(path)
    place = table.schema.names.index("[LiDARBoxComponent].box.heading")
    table = table.set_column(place, table.schema.names[place], pa.array(["north"] * len(table)))
    pq.write_table(table, path)
    assert f"{path}: row 0 is not whole or not laid out as Waymo's (could not" in refusal(tmp_path)


def test_a_table_of_too_many_rows_is_refused(tmp_path, small_segment, monkeypatch):
    write_v2(tmp_path, small_segment)
    monkeypatch.setattr(parquet, "MOST_ROWS", 9)
    assert f"camera_image/{NAME}.parquet claims 10 rows" in refusal(tmp_path)


def test_shapes_that_lie_are_named(tmp_path, small_segment):
    write_v2(tmp_path, small_segment)
    path = tmp_path / "lidar" / f"{NAME}.parquet"
    table = pq.read_table(path)
    name = "[LiDARComponent].range_image_return1.shape"
    place = table.schema.names.index(name)
    lies = pa.array([[64, 27, 3]] * len(table), pa.list_(pa.int32(), 3))
    pq.write_table(table.set_column(place, name, lies), path)
    assert f"{path}: row 0 is damaged (6912 values do not fill rows x columns x 4" in refusal(
        tmp_path
    )


def test_a_length_that_lies_is_named(tmp_path, small_segment):
    path = write("v1", tmp_path, small_segment)
    data = bytearray(path.read_bytes())
    data[:8] = struct.pack("<Q", len(data))
    path.write_bytes(data)
    assert f"{path}: record 0 is damaged (its length has another checksum)" in refusal(tmp_path)
