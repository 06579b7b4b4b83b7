"""Broken stores, sequences and target lists: each is used or refused in one line, never more."""

import contextlib
import json
import math
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import write_tiny_scene
from geoevs.projection.coloured_scenes import write_coloured_scene
from geoevs.protocol.reference import write_references
from geoevs.protocol.targets import make_targets, read_targets, write_targets
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.pandaset.source import Source
from geoevs.scenes.store import Scene

PROTOCOL = {
    "lateral": [1.0],
    "pose_sweep": {"angles": [], "every": 1},
    "masked": {"yaw": [15.0], "lateral": [2.0], "every": 9},
}
EXAMPLES = settings.get_profile(settings.get_current_profile_name()).max_examples
SHARE = settings(
    max_examples=max(EXAMPLES // 3, 1),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)

VALUES = st.sampled_from(
    [
        *(None, True, False, 0, -1, 1, 99, 2**70, 10**400, 0.5, -0.5, 1e300, -1e-300),
        *(math.nan, math.inf, -math.inf, 5e6, "", "x", "1", "../../x", "/etc/passwd", "a" * 300),
        *("two\nlines", "\0", "\ud800", "front", [], {}, [[]], [1, 2], {"a": 1}, [[[]]] * 5),
    ]
)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("fuzz") / "tiny").folder


@pytest.fixture(scope="module")
def target_list(store, tmp_path_factory):
    path = tmp_path_factory.mktemp("fuzz") / "targets.json"
    write_targets(path, make_targets(Scene(store), PROTOCOL, seed=0))
    return path


@contextlib.contextmanager
def changed(original: Path) -> Iterator[Path]:
    """A copy of a folder or file, in a folder of its own that is removed afterwards."""
    with tempfile.TemporaryDirectory() as root:
        path = Path(root) / "given" / original.name
        path.parent.mkdir()
        (shutil.copytree if original.is_dir() else shutil.copy)(original, path)
        yield path


def refused(use) -> bool:
    """Whether `use` ends in one line of a GeoEvsError; anything else that it raises is a fault."""
    sentence = ""
    try:
        use()
    except GeoEvsError as error:
        sentence = str(error)
    assert "\n" not in sentence
    assert len(sentence) < 1500
    return bool(sentence)


def places(value, place=()):
    """Every place in a JSON value, as the keys that lead there."""
    yield place
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(item, (*place, key))


def edit_json(path: Path, data) -> None:
    """Replace, remove or repeat something in a JSON file."""
    root = {"root": json.loads(path.read_text(encoding="utf-8"))}
    place = data.draw(st.sampled_from(list(places(root))[1:]), "place")
    *above, key = place
    parent = root
    for step in above:
        parent = parent[step]
    change = data.draw(st.sampled_from(["replace", "replace", "replace", "remove", "repeat"]))
    if change == "replace" or len(place) == 1:
        parent[key] = data.draw(VALUES, "value")
    elif change == "remove":
        del parent[key]
    elif isinstance(parent, list):
        parent.insert(key, parent[key])
    path.write_text(json.dumps(root["root"]), encoding="utf-8")


def edit_bytes(path: Path, data) -> None:
    """Cut a file off, or change one byte of it."""
    raw = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(raw) - 1), "byte")
    raw[place:] = raw[place + 1 :] and bytes([data.draw(st.integers(0, 255))]) + raw[place + 1 :]
    if data.draw(st.booleans(), "cut"):
        del raw[place:]
    path.write_bytes(raw)


def edit_array(array: np.ndarray, data) -> np.ndarray:
    """Another type, shape, length or range of an array; or one bad value in it."""
    change = data.draw(st.sampled_from(["value", "value", "type", "shape", "length", "none"]))
    if change == "value" and array.size:
        value = data.draw(st.sampled_from([math.nan, math.inf, -1, 1e300, 99, 255, 1e7, 0]))
        with np.errstate(all="ignore"):
            array = array.copy() if array.dtype.kind == "f" else array.astype(float)
            array.flat[data.draw(st.integers(0, array.size - 1), "cell")] = value
    if change == "type":
        kind = data.draw(st.sampled_from(["f8", "i8", "U5", "?", "c8", "M8[s]", "f2"]))
        with np.errstate(all="ignore"):
            array = array.astype("i8").astype(kind) if kind == "M8[s]" else array.astype(kind)
    if change == "shape":
        array = data.draw(st.sampled_from([array.ravel(), array[None], array[..., None]]))
    if change == "length":
        array = array[: data.draw(st.integers(0, 2))]
    return array if change != "none" else np.zeros(0)


def edit_column(values: np.ndarray, data) -> np.ndarray:
    """Cells of a table's column, of which one or all are something else."""
    value = data.draw(st.sampled_from([None, math.nan, math.inf, "x", "False", -1, 0, 1e300, True]))
    cells = values.astype(object)
    cells[: 1 if data.draw(st.booleans(), "one") else len(cells)] = value
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        return cells.astype(values.dtype if isinstance(value, float) else type(value))
    return cells


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


@SHARE
@given(data=st.data())
def test_a_broken_store_is_used_or_refused(store, data):
    with changed(store) as folder:
        names = ["scene.json", "transforms.json", "lidar/000001.npz", "tracks.parquet"]
        path = folder / data.draw(st.sampled_from([*names, names[1], "images/left/000000.png"]))
        raw = path.suffix == ".png" or data.draw(st.integers(0, 5)) == 0
        if raw:
            edit_bytes(path, data)
        elif path.suffix == ".json":
            edit_json(path, data)
        elif path.suffix == ".npz":
            with np.load(path) as file:
                arrays = dict(file)
            name = data.draw(st.sampled_from(sorted(arrays)), "array")
            np.savez(path, **{**arrays, name: edit_array(arrays[name], data)})
        else:
            table = pd.read_parquet(path)
            column = data.draw(st.sampled_from(list(table)))
            cells = edit_column(table[column].to_numpy(), data)
            with contextlib.suppress(Exception):  # mixed cells that no Parquet file can hold
                table.assign(**{column: cells}).to_parquet(path)
        out = folder.parents[1] / "out"
        failed = refused(lambda: use_store(folder, out))
        assert not failed or not out.exists()
        assert sorted(entry.name for entry in folder.parents[1].iterdir()) == (
            ["given"] if failed else ["given", "out"]
        )


@SHARE
@given(data=st.data())
def test_a_broken_sequence_is_imported_or_refused(pandaset, pandaset_files, data):
    with changed(pandaset / "777") as folder:
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        path = data.draw(st.sampled_from(files), "file")
        if path.suffix == ".jpg" or data.draw(st.integers(0, 5)) == 0:
            edit_bytes(path, data)
        elif path.suffix == ".json":
            edit_json(path, data)
        else:
            sweep = "lidar" in path.parts
            make = pandaset_files.sweep_columns if sweep else pandaset_files.cuboid_columns
            columns = make()
            column = data.draw(st.sampled_from(sorted(columns)), "column")
            columns[column] = edit_column(columns[column], data)
            if columns[column].dtype.kind == "U":
                columns[column] = columns[column].astype(object)
            with contextlib.suppress(TypeError):  # cells that no such table holds
                pandaset_files.write_gzip(path, pandaset_files.old_pickle(columns))
        root = folder.parents[1]

        def load():
            record = Source(16, 24, folder=str(folder.parent)).open(SceneRef("777"))
            write_coloured_scene(root / "store", root / "depths", record, lambda: None)
            use_store(root / "store", root / "out")

        failed = refused(load)
        left = sorted(entry.name for entry in root.iterdir())
        # A scene that was written whole may still have targets that cannot be made.
        assert left in (["given"], ["depths", "given", "store"]) or not failed


@SHARE
@given(data=st.data())
def test_a_broken_target_list_is_read_or_refused(target_list, data):
    with changed(target_list) as path:
        (edit_bytes if data.draw(st.integers(0, 5)) == 0 else edit_json)(path, data)
        targets = []
        if not refused(lambda: targets.extend(read_targets(path))):
            root = (path.parent / "renders").resolve()
            for target in targets:
                assert (root / f"{target.key}.png").resolve().is_relative_to(root)
                assert target.camera.height <= 8192
