"""A tiny PandaSet sequence, written in the layout of the public release."""

import gzip
import json
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

CAMERA_COLOURS = {
    "front_camera": (200, 40, 40),
    "front_left_camera": (40, 200, 40),
    "front_right_camera": (40, 40, 200),
    "back_camera": (120, 120, 120),
}
FRAMES = (3, 4)
ENTRIES = 5  # poses and timestamps, of which only FRAMES have images and sweeps
IMAGE_HEIGHT, IMAGE_WIDTH = 54, 96  # a twentieth of the released ones
YAWS = {"front_camera": 0, "front_left_camera": 45, "front_right_camera": -45, "back_camera": 180}


def intrinsics(name: str) -> dict[str, float]:
    """A twentieth of the released focal lengths, the principal point in the middle."""
    focal = {"front_camera": 98.5, "back_camera": 46.7}.get(name, 46.5)
    return {"fx": focal, "fy": focal, "cx": 47.5, "cy": 26.5}


def facing(yaw: float) -> dict[str, float]:
    """The quaternion of a level camera; for 0, forward is world x, right -y and down -z."""
    half = np.radians(yaw) / 2
    cos, sin = np.cos(half) / 2, np.sin(half) / 2
    # (cos, 0, 0, sin) about world z, then (1, -1, 1, -1) / 2, by hand.
    return {"w": cos + sin, "x": -cos - sin, "y": cos - sin, "z": -cos + sin}


class Name(NamedTuple):
    """A global that a pickle names, as `module name`."""

    name: str


class Call(NamedTuple):
    """A call of a named global, or `cls.__new__` of one, and then its state."""

    function: Name
    arguments: tuple
    state: Any = None
    new: bool = False


def assemble(value: Any) -> bytes:
    """Protocol-3 opcodes that leave `value` on the stack; nothing needs to be importable."""
    match value:
        case Name(name):
            return b"c" + name.replace(" ", "\n").encode() + b"\n"
        case Call(function, arguments, state, new):
            made = assemble(function) + assemble(arguments) + (b"\x81" if new else b"R")
            return made if state is None else made + assemble(state) + b"b"
        case None:
            return b"N"
        case bool():
            return b"\x88" if value else b"\x89"
        case int():
            return b"J" + struct.pack("<i", value)
        case float():
            return b"G" + struct.pack(">d", value)
        case str():
            return b"X" + struct.pack("<I", len(value.encode())) + value.encode()
        case bytes():
            return b"B" + struct.pack("<I", len(value)) + value
        case tuple():
            return b"(" + b"".join(map(assemble, value)) + b"t"
        case list():
            return b"](" + b"".join(map(assemble, value)) + b"e"
        case dict():
            return b"}(" + b"".join(assemble(k) + assemble(v) for k, v in value.items()) + b"u"
    raise TypeError(type(value))


def array_call(array: np.ndarray) -> Call:
    """How numpy 1.x pickled an array; object arrays keep a list of cells."""
    is_object = array.dtype == object
    order = ("|", *(None,) * 3, -1, -1, 63 if is_object else 0)
    if not is_object and array.itemsize > 1:
        order = ("<", *order[1:])
    dtype = Call(
        Name("numpy dtype"),
        ("O8" if is_object else array.dtype.str[1:], 0, 1),
        (3, *order),
    )
    data = array.ravel().tolist() if is_object else array.tobytes()
    start = (Name("numpy ndarray"), (0,), b"b")
    state = (1, array.shape, dtype, False, data)
    return Call(Name("numpy.core.multiarray _reconstruct"), start, state)


def index_call(labels: list[str]) -> Call:
    """How pandas 1.x pickled a column index."""
    data = array_call(np.array(labels, object))
    arguments = (Name("pandas.core.indexes.base Index"), {"data": data, "name": None})
    return Call(Name("pandas.core.indexes.base _new_Index"), arguments)


def old_pickle(columns: dict[str, np.ndarray]) -> bytes:
    """How pandas 1.x pickled a data frame: one block per number type, columns out of order."""
    labels = list(columns)
    rows = len(next(iter(columns.values())))
    blocks = []
    for dtype in sorted({array.dtype for array in columns.values()}, key=str):
        places = [place for place, label in enumerate(labels) if columns[label].dtype == dtype]
        values = np.stack([columns[labels[place]] for place in places])
        locations = array_call(np.array(places, np.int64))
        if places == list(range(places[0], places[-1] + 1)):
            locations = Call(Name("builtins slice"), (places[0], places[-1] + 1, 1))
        blocks.append({"values": array_call(values), "mgr_locs": locations})
    row_index = Call(
        Name("pandas.core.indexes.base _new_Index"),
        (
            Name("pandas.core.indexes.range RangeIndex"),
            {"name": None, "start": 0, "stop": rows, "step": 1},
        ),
    )
    axes = [index_call(labels), row_index]
    state = (axes, [], [], {"0.14.1": {"axes": axes, "blocks": blocks}})
    manager = Call(Name("pandas.core.internals.managers BlockManager"), (), state, new=True)
    frame = Call(
        Name("pandas.core.frame DataFrame"),
        (),
        {"_data": manager, "_typ": "dataframe", "_metadata": [], "attrs": {}},
        new=True,
    )
    return b"\x80\x03" + assemble(frame) + b"."


def write_gzip(path: Path, raw: bytes) -> Path:
    """Write `raw` gzip'd."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(raw, mtime=0))
    return path


def sweep_columns() -> dict[str, np.ndarray]:
    """Three points: two of Pandar64 (d = 0), one of PandarGT (d = 1)."""
    return {
        "x": np.array([11.0, 11.0, 21.0]),
        "y": np.array([2.0, 3.0, 2.0]),
        "z": np.array([3.0, 5.0, 3.0]),
        "i": np.array([7.0, 8.0, 9.0]),
        "t": np.array([1.0, 1.0, 1.0]),
        "d": np.array([0, 0, 1]),
    }


def cuboid_columns() -> dict[str, np.ndarray]:
    """A parked car, a moving car that both LiDARs saw, and a pedestrian of PandarGT alone."""

    def text(*cells: object) -> np.ndarray:
        return np.array(cells, object)

    return {
        "uuid": text("parked", "moving-0", "moving-1", "walker-1"),
        "label": text("Car", "Car", "Car", "Pedestrian"),
        "yaw": np.array([0.0, np.pi / 2, np.pi / 2, -np.pi / 4]),
        "stationary": np.array([True, False, False, False]),
        "camera_used": np.array([-1, -1, 0, -1]),
        "position.x": np.array([5.0, 9.0, 9.4, 3.0]),
        "position.y": np.array([1.0, -2.0, -2.0, 4.0]),
        "position.z": np.array([0.5, 0.6, 0.6, 0.9]),
        "dimensions.x": np.array([1.8, 1.9, 1.9, 0.5]),
        "dimensions.y": np.array([4.5, 4.6, 4.6, 0.6]),
        "dimensions.z": np.array([1.5, 1.6, 1.6, 1.7]),
        "attributes.object_motion": text("Parked", "Moving", "Moving", float("nan")),
        "cuboids.sibling_id": text("-", "moving-1", "moving-0", "gone-0"),
        "cuboids.sensor_id": np.array([-1, 0, 1, 1]),
    }


def write_sequence(folder: Path) -> Path:
    """Write a whole tiny sequence into `folder`."""
    for sensor in ("lidar", *(f"camera/{name}" for name in CAMERA_COLOURS)):
        (folder / sensor).mkdir(parents=True)
        heading = facing(YAWS.get(sensor.removeprefix("camera/"), 0))
        pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "heading": heading}
        (folder / sensor / "poses.json").write_text(json.dumps([pose] * ENTRIES))
        stamps = [100.0 + 0.1 * entry for entry in range(ENTRIES)]
        (folder / sensor / "timestamps.json").write_text(json.dumps(stamps))
    for name, colour in CAMERA_COLOURS.items():
        (folder / "camera" / name / "intrinsics.json").write_text(json.dumps(intrinsics(name)))
        image = Image.new("RGB", (IMAGE_WIDTH, IMAGE_HEIGHT), colour)
        for frame in FRAMES:
            image.save(folder / "camera" / name / f"{frame:02d}.jpg", quality=95)
    for frame in FRAMES:
        write_gzip(folder / f"lidar/{frame:02d}.pkl.gz", old_pickle(sweep_columns()))
        cuboids = folder / f"annotations/cuboids/{frame:02d}.pkl.gz"
        write_gzip(cuboids, old_pickle(cuboid_columns()))
    return folder


@pytest.fixture
def pandaset_files():
    """The writers above, for tests that make broken files."""
    return SimpleNamespace(
        Name=Name,
        Call=Call,
        assemble=assemble,
        array_call=array_call,
        old_pickle=old_pickle,
        write_gzip=write_gzip,
        sweep_columns=sweep_columns,
        cuboid_columns=cuboid_columns,
    )


@pytest.fixture
def pandaset(tmp_path: Path) -> Path:
    """A folder with the tiny sequence `777` in it."""
    write_sequence(tmp_path / "777")
    return tmp_path
