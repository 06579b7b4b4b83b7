"""Broken stores, sequences and target lists: each is used or refused in one line, never more."""

import contextlib
import gzip
import json
import math
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.methods.tiny import HEIGHT, WIDTH, write_tiny_scene
from geoevs.projection.coloured_scenes import write_coloured_scene
from geoevs.protocol.reference import write_references
from geoevs.protocol.targets import make_targets, read_targets, write_targets
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.pandaset.source import Source
from geoevs.scenes.store import Scene
from tests.fuzzing import (
    SHARE,
    anything,
    changed,
    edit_array,
    edit_bytes,
    edit_column,
    edit_json,
    edit_json_bytes,
    edit_png,
    judged,
    name,
    near,
    number,
    plain,
    read_plainly,
    sound_columns,
    text,
    whole,
)

PROTOCOL = {
    "lateral": [1.0],
    "pose_sweep": {"angles": [], "every": 1},
    "masked": {"yaw": [15.0], "lateral": [2.0], "every": 9},
}
RIGID = 2e-4
"""A number of a rotation may differ by so much, or is refused."""

FAR = 10_000.0  # metres


def calibration(*place):
    """What may stand in an entry with a camera of the tiny scene, beside its size."""
    return {
        (*place, "fl_x"): number(0.01 * WIDTH, 100 * WIDTH),
        (*place, "fl_y"): number(0.01 * HEIGHT, 100 * HEIGHT),
        (*place, "cx"): number(0, WIDTH),
        (*place, "cy"): number(0, HEIGHT),
        **{(*place, key, "?"): number(0, 0) for key in ("k1", "k2", "k3", "k4", "p1", "p2")},
        (*place, "transform_matrix", 3, "*"): near(RIGID),
        (*place, "transform_matrix", "*", 3): number(-FAR, FAR),
        (*place, "transform_matrix", "*", "*"): near(RIGID),
    }


RULES = {
    "scene.json": {
        ("name",): name,
        **{(key,): text for key in ("source", "licence")},
        ("origin", "?"): lambda value: (
            isinstance(value, list) and list(map(number(), value)) == [1] * 3
        ),
        ("origin", "*"): number(),
        ("box_delay", "?"): number(),
        ("redistribute", "?"): lambda value: isinstance(value, bool),
        ("made_with", "?"): lambda value: isinstance(value, dict),
        ("made_with", "*", ..., "?"): anything,
    },
    "transforms.json": {
        ("camera_model", "?"): lambda value: value in ("OPENCV", "PINHOLE"),
        ("frames", 0, "timestamp"): number(0, 0.0999),  # of the first camera, before the next frame
        ("frames", 3, "timestamp"): number(1e-9),
        ("frames", "*", "timestamp"): number(0),
        **calibration("frames", "*"),
        **{("frames", "*", key): lambda value: False for key in ("w", "h", "camera", "frame")},
        ("frames", "*", "file_path"): lambda value: False,
        ("frames", "*", "transform_matrix"): lambda value: False,
        ("frames", "*", "*", ..., "?"): anything,
        ("frames",): lambda value: False,
        ("*", ..., "?"): anything,
    },
}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("fuzz") / "tiny").folder


@pytest.fixture(scope="module")
def target_list(store, tmp_path_factory):
    path = tmp_path_factory.mktemp("fuzz") / "targets.json"
    write_targets(path, make_targets(Scene(store), PROTOCOL, seed=0))
    return path


def use_store(folder: Path, out: Path) -> None:
    """All that a run reads of a store."""
    scene = Scene(folder)
    for frame in scene.frames:
        assert len(scene.points(frame).xyz) == len(scene.points(frame))
        for camera in scene.cameras:
            assert np.isfinite(scene.image(camera, frame)).all()
    assert len(scene.tracks) >= 0
    targets = [t for t in make_targets(scene, PROTOCOL, 0) if t.frame == scene.frames[0]]
    write_references(out / "references.npz", out / "masks.npz", scene, targets, 0)


def sound_points(path: Path) -> bool:
    """Whether a file has the points of a sweep that three cameras coloured."""
    try:
        with np.load(path) as file:
            arrays = dict(file)
        count = len(arrays["xyz"])
        return all(
            arrays[key].shape == (count, *shape)
            and arrays[key].dtype.kind in kinds
            and bool(((arrays[key] >= low) & (arrays[key] <= high)).all())
            for key, kinds, shape, low, high in (
                ("xyz", "iuf", (3,), -FAR, FAR),
                ("rgb", "iuf", (3,), 0, 1),
                ("camera", "iu", (), -1, 2),
                ("sensor", "iu", (), 0, 255),
                ("beam", "iu", (), 0, 65535),
            )
        )
    except Exception:  # whatever broken archives raise
        return False


def sound_tracks(path: Path) -> bool:
    """Whether a file has boxes that can be."""
    try:
        table = read_plainly(path)
    except Exception:  # whatever bytes make of it
        return False
    rules = {
        "frame": whole(0, 999_999),
        **dict.fromkeys(("track", "label"), text),
        **dict.fromkeys("xyz", number(-FAR, FAR)),
        **dict.fromkeys(("length", "width", "height"), number(math.ulp(0), 100)),
        "yaw": number(-360, 360),
        "moving": lambda cell: isinstance(cell, bool),
    }
    return sound_columns(table, rules) and not table.duplicated(["frame", "track"]).any()


def edit_store(path: Path, data: st.DataObject) -> bool:
    """Break one file of a store; whether it is still sound."""
    few = data.draw(st.integers(0, 5)) == 0
    if path.suffix == ".png":
        return edit_png(path, data)
    if path.suffix == ".json":
        return (edit_json_bytes if few else edit_json)(path, data, RULES[path.name])
    if few:
        edit_bytes(path, data)
    elif path.suffix == ".npz":
        with np.load(path) as file:
            arrays = dict(file)
        key = data.draw(st.sampled_from(sorted(arrays)), "array")
        np.savez(path, **{**arrays, key: edit_array(arrays[key], data)})
    else:
        table = pd.read_parquet(path)
        column = data.draw(st.sampled_from(list(table)))
        cells = edit_column(table[column].to_numpy(), data)
        with contextlib.suppress(Exception):  # mixed cells that no Parquet file can hold
            table.assign(**{column: cells}).to_parquet(path)
    return sound_points(path) if path.suffix == ".npz" else sound_tracks(path)


@SHARE
@given(data=st.data())
def test_a_broken_store_is_used_or_refused(store, data):
    with changed(store) as folder:
        names = ["scene.json", "transforms.json", "lidar/000001.npz", "tracks.parquet"]
        path = folder / data.draw(st.sampled_from([*names, names[1], "images/left/000000.png"]))
        sound = edit_store(path, data)
        out = folder.parents[1] / "out"
        failed = judged("stores", sound, lambda: use_store(folder, out))
        assert not failed or not out.exists()
        assert sorted(entry.name for entry in folder.parents[1].iterdir()) == (
            ["given"] if failed else ["given", "out"]
        )


def poses(camera: bool):
    """What may stand in a list of five poses, of which the last two are read."""
    entry = (
        {("*", "position", "*"): number(-95, 95), ("*", "heading", "*"): near(RIGID)}
        if camera  # all are near each other
        else {(4, ..., "?"): anything, ("*", "*", "*"): number()}
    )
    return {
        **{(unread, ..., "?"): anything for unread in (0, 1, 2)},
        **entry,
        ("*", "*", "*", "?"): lambda value: False,
        ("*", "*", "?"): lambda value: False,
        (): lambda value: isinstance(value, list) and len(value) >= 5,
    }


def stamps(sweeps: bool):
    """What may stand in a list of five times, of which the last two are read."""

    def rise(value):
        return isinstance(value, list) and len(value) >= 5 and (not sweeps or value[3] < value[4])

    return {
        **{(unread,): anything for unread in (0, 1, 2)},
        (3,): number(0, 100.4 - 1e-6) if sweeps else number(0),
        (4,): number(100.3 + 1e-6) if sweeps else number(0),
        (): rise,
    }


def json_rules(path: Path):
    """What may stand in a JSON file of a sequence."""
    camera = path.parent.name.endswith("camera")
    return {
        "poses.json": poses(camera),
        "timestamps.json": stamps(not camera),
        "intrinsics.json": {
            **{(key,): near(10.0) for key in ("fx", "fy")},
            ("cx",): number(-0.5, 95.5),
            ("cy",): number(-0.5, 53.5),
            ("*", ..., "?"): anything,
        },
    }[path.name]


SWEEP = {
    **dict.fromkeys("xyz", number(-FAR, FAR)),
    "d": lambda cell: number(0, 1)(cell) and cell % 1 == 0,
}
CUBOIDS = {
    **dict.fromkeys(("uuid", "label", "cuboids.sibling_id"), text),
    "stationary": lambda cell: isinstance(cell, bool),
    "cuboids.sensor_id": lambda cell: number(-1, 1)(cell) and cell % 1 == 0,
    **dict.fromkeys((f"position.{axis}" for axis in "xyz"), number(-FAR, FAR)),
    **dict.fromkeys((f"dimensions.{axis}" for axis in "xyz"), number(math.ulp(0), 100)),
    "yaw": number(-2 * math.pi, 2 * math.pi),
}


def edit_table(path: Path, data: st.DataObject, files) -> bool:
    """Change the cells of a pickled table; whether it is still sound."""
    sweep = "lidar" in path.parts
    columns = files.sweep_columns() if sweep else files.cuboid_columns()
    column = data.draw(st.sampled_from(sorted(columns)), "column")
    before = columns[column]
    columns[column] = edit_column(before, data)
    if columns[column].dtype.kind == "U":
        columns[column] = columns[column].astype(object)
    try:
        files.write_gzip(path, files.old_pickle(columns))
    except TypeError:  # cells that no such table holds
        return True
    # Numbers among cells of other types are no numbers.
    if (
        before.dtype.kind in "iuf"
        and columns[column].dtype == object
        and column in {**SWEEP, **CUBOIDS}
    ):
        return False
    cells = [plain(cell) for cell in columns[column]]
    if column == "d" and set(cells) != {0, 1}:
        return False
    if column == "uuid" and len({*map(str, cells)}) < len(cells):
        return False
    rule = (SWEEP if sweep else CUBOIDS).get(column, anything)
    return all(map(rule, cells))


def edit_jpeg(path: Path, data: st.DataObject) -> bool:
    """Cut a JPEG off, or change one byte of it; whether it is another picture, or the same.

    The format has no checksums: nobody can tell a changed byte from another picture.
    """
    before = cv2.imread(str(path))
    size = path.stat().st_size
    edit_bytes(path, data)
    after = cv2.imread(str(path))
    if after is None or after.shape != before.shape:
        return False
    return path.stat().st_size == size or bool((after == before).all())


def edit_sequence(path: Path, data: st.DataObject, files) -> bool:
    """Break one file of a sequence; whether it is still sound."""
    few = data.draw(st.integers(0, 5)) == 0
    if path.suffix == ".jpg":
        return edit_jpeg(path, data)
    if path.suffix == ".json":
        return (edit_json_bytes if few else edit_json)(path, data, json_rules(path))
    if not few:
        return edit_table(path, data, files)
    before = gzip.decompress(path.read_bytes())
    edit_bytes(path, data)
    with contextlib.suppress(Exception):  # whatever bytes make of it
        return gzip.decompress(path.read_bytes()) == before
    return False


@SHARE
@given(data=st.data())
def test_a_broken_sequence_is_imported_or_refused(pandaset, pandaset_files, data):
    with changed(pandaset / "777") as folder:
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        sound = edit_sequence(data.draw(st.sampled_from(files), "file"), data, pandaset_files)
        root = folder.parents[1]

        def load():
            record = Source(16, 24, folder=str(folder.parent)).open(SceneRef("777"))
            write_coloured_scene(root / "store", root / "depths", record, lambda: None)
            use_store(root / "store", root / "out")

        failed = judged("PandaSet sequences", sound, load)
        left = sorted(entry.name for entry in root.iterdir())
        # A scene that was written whole may still have targets that cannot be made.
        assert left in (["given"], ["depths", "given", "store"]) or not failed


def sound_list(value) -> bool:
    """Whether a list has views of its own names alone."""
    if not (isinstance(value, list) and all(isinstance(entry, dict) for entry in value)):
        return False
    keys = [json.dumps([entry.get("name"), entry.get("frame")]) for entry in value]
    return len(set(keys)) == len(keys)


TARGET_RULES = {
    **calibration("*"),
    **calibration("*", "mask_camera"),
    **{(*place, "w"): whole(36, 7000) for place in (("*",), ("*", "mask_camera"))},
    **{(*place, "h"): whole(24, 4800) for place in (("*",), ("*", "mask_camera"))},
    **{(*place, "name"): name for place in (("*",), ("*", "mask_camera"))},
    ("*", "frame"): whole(0, 999_999),
    ("*", "pose_offset"): number(0, 180),
    ("*", "lateral_shift"): number(-1000, 1000),
    **{("*", key): lambda value: False for key in ("split", "sources", "mask_camera")},
    **{("*", *some, "transform_matrix"): lambda value: False for some in ((), ("mask_camera",))},
    ("*", "mask_camera", "*", "?"): anything,
    ("*", "*", "?"): anything,
    ("*", "made_with", ..., "?"): anything,
    (): sound_list,
}


@SHARE
@given(data=st.data())
def test_a_broken_target_list_is_read_or_refused(target_list, data):
    with changed(target_list) as path:
        edit = edit_json_bytes if data.draw(st.integers(0, 5)) == 0 else edit_json
        sound = edit(path, data, TARGET_RULES)
        targets = []
        if not judged("target lists", sound, lambda: targets.extend(read_targets(path))):
            root = (path.parent / "renders").resolve()
            for target in targets:
                assert (root / f"{target.key}.png").resolve().is_relative_to(root)
                assert target.camera.height <= 8192
