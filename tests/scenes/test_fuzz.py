"""Broken stores, sequences and target lists: each is used or refused in one line, never more."""

import contextlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.methods.tiny import write_tiny_scene
from geoevs.projection.coloured_scenes import write_coloured_scene
from geoevs.protocol.reference import write_references
from geoevs.protocol.targets import make_targets, read_targets, write_targets
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.pandaset.source import Source
from geoevs.scenes.store import Scene
from tests.fuzzing import SHARE, changed, edit_array, edit_bytes, edit_column, edit_json, refused

PROTOCOL = {
    "lateral": [1.0],
    "pose_sweep": {"angles": [], "every": 1},
    "masked": {"yaw": [15.0], "lateral": [2.0], "every": 9},
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
