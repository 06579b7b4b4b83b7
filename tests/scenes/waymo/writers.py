"""Writers of both versions of the data set: protocol buffers by hand, and Parquet tables."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.scenes.waymo.world import CAMERAS, Segment


def varint(n: int) -> bytes:
    """Seven bits a byte, low first; the top bit says that more follow."""
    out = bytearray()
    while n > 0x7F:
        out.append(n & 0x7F | 0x80)
        n >>= 7
    return bytes([*out, n])


def sub(number: int, data: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(data)) + data


def whole(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value)


def double(number: int, value: float) -> bytes:
    return varint(number << 3 | 1) + struct.pack("<d", value)


def single(number: int, value: float) -> bytes:
    return varint(number << 3 | 5) + struct.pack("<f", value)


def doubles(number: int, values) -> bytes:
    """A repeated field that is not packed, as proto2 writes it."""
    return b"".join(double(number, value) for value in np.ravel(values))


def packed(number: int, values, dtype: str) -> bytes:
    return sub(number, np.ascontiguousarray(values, dtype).tobytes())


def transform(number: int, pose) -> bytes:
    return sub(number, doubles(1, pose))


def matrix(array: np.ndarray) -> bytes:
    """A compressed MatrixFloat."""
    dims = b"".join(whole(1, side) for side in array.shape)
    return zlib.compress(packed(1, array, "<f4") + sub(2, dims), 1)


def crc_table() -> list[int]:
    """CRC-32C of each byte by the textbook's division, for a fast twin of the source's."""
    table = list(range(256))
    for _ in range(8):
        table = [value >> 1 ^ (0x82F63B78 if value & 1 else 0) for value in table]
    return table


TABLE = crc_table()


def crc32c(data: bytes) -> int:
    checksum = 0xFFFFFFFF
    for byte in data:
        checksum = checksum >> 8 ^ TABLE[(checksum ^ byte) & 0xFF]
    return checksum ^ 0xFFFFFFFF


def checksum(data: bytes) -> bytes:
    """As a TFRecord file has it."""
    crc = crc32c(data)
    return struct.pack("<I", ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF)


def record(data: bytes) -> bytes:
    """One record of a TFRecord file."""
    length = struct.pack("<Q", len(data))
    return length + checksum(length) + data + checksum(data)


def v1_box(box) -> bytes:
    """Width is field 4 and length 5."""
    return b"".join(double(n, v) for n, v in zip((1, 2, 3, 5, 4, 6, 7), box, strict=True))


def v1_label(label: dict) -> bytes:
    data = sub(1, v1_box(label["box"]))
    data += sub(2, double(1, label["speed"][0]) + double(2, label["speed"][1]))
    data += whole(3, label["type"]) + sub(4, label["track"].encode())
    if label["synced"] is not None:
        data += sub(11, CAMERAS[label["camera"] - 1].encode()) + sub(12, v1_box(label["synced"]))
    return data


def v1_image(number: int, image: dict) -> bytes:
    velocity = b"".join(single(n, v) for n, v in zip((1, 2, 3), image["linear"], strict=True))
    velocity += b"".join(double(n, v) for n, v in zip((4, 5, 6), image["angular"], strict=True))
    times = [(5, "pose_time"), (6, "shutter"), (7, "trigger"), (8, "done")]
    return (
        whole(1, number)
        + sub(2, image["jpeg"])
        + transform(3, image["pose"])
        + sub(4, velocity)
        + b"".join(double(n, image[name]) for n, name in times)
    )


def v1_sweep(number: int, sweep: dict) -> bytes:
    first = sub(2, matrix(sweep["first"])) if sweep["first"] is not None else b""
    if sweep["poses"] is not None:
        first += sub(4, matrix(sweep["poses"]))
    second = sub(2, matrix(sweep["second"])) if sweep["second"] is not None else b""
    return whole(1, number) + sub(2, first) + sub(3, second)


def v1_context(segment: Segment) -> bytes:
    data = sub(1, segment.name.encode())
    for number, camera in segment.cameras.items():
        data += sub(
            2,
            whole(1, number)
            + doubles(2, camera["intrinsic"])
            + transform(3, camera["extrinsic"])
            + whole(4, camera["width"])
            + whole(5, camera["height"])
            + whole(6, camera["readout"]),
        )
    for number, laser in segment.lasers.items():
        data += sub(
            3,
            whole(1, number)
            + doubles(2, laser["inclinations"])
            + double(3, laser["low"])
            + double(4, laser["high"])
            + transform(5, laser["extrinsic"]),
        )
    return data


def v1_frame(segment: Segment, index: int) -> bytes:
    """A Frame; images stand in another order than cameras do, as in the real files."""
    frame = segment.frames[index]
    data = sub(1, v1_context(segment)) + whole(2, frame["time"]) + transform(3, frame["pose"])
    for number, image in sorted(frame["images"].items(), reverse=True):
        data += sub(4, v1_image(number, image))
    for number, sweep in frame["sweeps"].items():
        data += sub(5, v1_sweep(number, sweep) if sweep else b"")
    for label in frame["labels"].values():
        data += sub(6, v1_label(label))
    for zone in frame["zones"]:
        data += sub(7, doubles(1, zone[:, 0]) + doubles(2, zone[:, 1]))
    if index == 0:
        for kind, field, points in segment.map_features:
            corners = b"".join(
                sub(field, b"".join(double(n, v) for n, v in enumerate(point, start=1)))
                for point in points
            )
            data += sub(10, whole(1, 7) + sub(kind, corners))
    offset = b"".join(double(n, v) for n, v in enumerate(frame["offset"], start=1))
    return data + sub(11, offset)


def write_v1(path: Path, segment: Segment) -> Path:
    """Write a segment as a TFRecord file, its frames in their order."""
    path.parent.mkdir(parents=True, exist_ok=True)
    frames = (record(v1_frame(segment, index)) for index in range(len(segment.frames)))
    path.write_bytes(b"".join(frames))
    return path


def flat(values) -> list[float] | None:
    return None if values is None else np.ravel(values).astype(float).tolist()


def image_columns(array: np.ndarray | None, number: int) -> dict:
    prefix = f"range_image_return{number}"
    return {
        f"{prefix}.values": None if array is None else np.ravel(array),
        f"{prefix}.shape": None if array is None else list(array.shape),
    }


def box_columns(prefix: str, box) -> dict:
    names = ("center.x", "center.y", "center.z", "size.x", "size.y", "size.z", "heading")
    return {f"{prefix}.{name}": float(value) for name, value in zip(names, box, strict=True)}


def xyz_columns(prefix: str, values) -> dict:
    return {f"{prefix}.{axis}": float(value) for axis, value in zip("xyz", values, strict=True)}


INTRINSIC = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
FLOATS = pa.list_(pa.float32())


def v2_tables(segment: Segment) -> dict[str, tuple[str, list[tuple[dict, dict]]]]:
    """By tag, the component and its rows: keys and fields."""
    shutter = {"shutter": "shutter", "trigger": "camera_trigger_time"}
    shutter["done"] = "camera_readout_done_time"
    tables: dict = {
        "camera_calibration": (
            "CameraCalibrationComponent",
            [
                (
                    {"camera_name": number},
                    {f"intrinsic.{k}": v for k, v in zip(INTRINSIC, c["intrinsic"], strict=True)}
                    | {"extrinsic.transform": flat(c["extrinsic"]), "width": c["width"]}
                    | {"height": c["height"], "rolling_shutter_direction": c["readout"]},
                )
                for number, c in segment.cameras.items()
            ],
        ),
        "lidar_calibration": (
            "LiDARCalibrationComponent",
            [
                (
                    {"laser_name": number},
                    {"beam_inclination.values": laser["inclinations"] or None}
                    | {"beam_inclination.min": laser["low"]}
                    | {"beam_inclination.max": laser["high"]}
                    | {"extrinsic.transform": flat(laser["extrinsic"])},
                )
                for number, laser in segment.lasers.items()
            ],
        ),
        "vehicle_pose": ("VehiclePoseComponent", []),
        "camera_image": ("CameraImageComponent", []),
        "lidar": ("LiDARComponent", []),
        "lidar_pose": ("LiDARPoseComponent", []),
        "lidar_box": ("LiDARBoxComponent", []),
        "lidar_camera_synced_box": ("LiDARCameraSyncedBoxComponent", []),
    }
    for frame in segment.frames:
        key = {"frame_timestamp_micros": frame["time"]}
        pose = {"world_from_vehicle.transform": flat(frame["pose"])}
        tables["vehicle_pose"][1].append((key, pose))
        for number, image in sorted(frame["images"].items(), reverse=True):
            fields = {"image": image["jpeg"], "pose.transform": flat(image["pose"])}
            fields |= xyz_columns("velocity.linear_velocity", image["linear"])
            fields |= xyz_columns("velocity.angular_velocity", image["angular"])
            fields |= {"pose_timestamp": image["pose_time"]}
            fields |= {f"rolling_shutter_params.{n}": image[k] for k, n in shutter.items()}
            tables["camera_image"][1].append((key | {"camera_name": number}, fields))
        for number, sweep in frame["sweeps"].items():
            if not sweep:
                continue
            keys = key | {"laser_name": number}
            fields = image_columns(sweep["first"], 1) | image_columns(sweep["second"], 2)
            tables["lidar"][1].append((keys, fields))
            if sweep["poses"] is not None:
                tables["lidar_pose"][1].append((keys, image_columns(sweep["poses"], 1)))
        for label in frame["labels"].values():
            keys = key | {"laser_object_id": label["track"]}
            fields = box_columns("box", label["box"]) | {"type": label["type"]}
            fields |= xyz_columns("speed", (*label["speed"], 0.0))
            tables["lidar_box"][1].append((keys, fields))
            if label["synced"] is not None:
                fields = {"most_visible_camera_name": label["camera"]}
                fields |= box_columns("camera_synced_box", label["synced"])
                tables["lidar_camera_synced_box"][1].append((keys, fields))
    return tables


def column_type(name: str, old: bool) -> pa.DataType | None:
    """The type that Waymo's code writes, or that of its older samples; None for a number's own."""
    if name.endswith(".transform"):
        return pa.list_(pa.float32() if old else pa.float64(), 16)
    if "range_image" in name:
        return FLOATS if name.endswith("values") else pa.list_(pa.int32(), 3)
    if name == "beam_inclination.values":
        return pa.list_(pa.float64())
    if name in ("camera_name", "laser_name", "type"):
        return pa.int8()
    return None


def write_v2(folder: Path, segment: Segment, old: bool = False, group: int | None = None) -> Path:
    """Write a segment as a Parquet file for each component, `group` rows a row group.

    `old` gives the types of Waymo's samples: float32 transforms, and cameras by their names.
    """
    for tag, (component, rows) in v2_tables(segment).items():
        columns: dict[str, pa.Array] = {}
        columns["key.segment_context_name"] = pa.array([segment.name] * len(rows), pa.string())
        for key in rows[0][0] if rows else ():
            values = [keys[key] for keys, _ in rows]
            if old and key == "camera_name":
                columns[f"key.{key}"] = pa.array([CAMERAS[value - 1] for value in values])
            else:
                columns[f"key.{key}"] = pa.array(values, column_type(key, old))
        for name in rows[0][1] if rows else ():
            cells = [fields[name] for _, fields in rows]
            columns[f"[{component}].{name}"] = pa.array(cells, column_type(name, old))
        path = folder / tag / f"{segment.name}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(columns), path, row_group_size=group)
    return folder
