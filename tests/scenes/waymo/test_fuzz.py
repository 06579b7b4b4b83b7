"""Damaged files of both versions: each is read or refused in one line, and nothing else is left."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.projection.coloured_scenes import write_coloured_scene
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.waymo.source import Source
from tests.fuzzing import SHARE, changed, edit_bytes, refused
from tests.scenes.waymo.world import NAME
from tests.scenes.waymo.writers import record, v1_frame, write_v1, write_v2


@pytest.fixture(scope="module")
def small(small_segment):
    """One frame."""
    return replace(small_segment, frames=small_segment.frames[:1])


def import_all(folder, root) -> None:
    record_ = Source(16, 24, folder=str(folder)).open(SceneRef(NAME))
    write_coloured_scene(root / "store", root / "depths", record_, lambda: None)


def check(folder) -> None:
    root = folder.parents[1]
    failed = refused(lambda: import_all(folder, root))
    left = sorted(entry.name for entry in root.iterdir())
    assert left == (["given"] if failed else ["depths", "given", "store"])


@pytest.fixture(scope="module")
def small_v1(small, tmp_path_factory):
    return write_v1(tmp_path_factory.mktemp("v1") / "x" / "some.tfrecord", small).parent


@pytest.fixture(scope="module")
def small_v2(small, tmp_path_factory):
    return write_v2(tmp_path_factory.mktemp("v2") / "x", small)


@SHARE
@given(data=st.data())
def test_a_damaged_record_is_read_or_refused(small, small_v1, data):
    with changed(small_v1) as folder:
        path = folder / "some.tfrecord"
        if data.draw(st.integers(0, 3)) == 0:
            edit_bytes(path, data)
        else:  # within the message, with checksums that fit
            raw = bytearray(v1_frame(small, 0))
            for _ in range(data.draw(st.integers(1, 4), "bytes")):
                raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
            path.write_bytes(record(bytes(raw)))
        check(folder)


@SHARE
@given(data=st.data())
def test_a_damaged_table_is_read_or_refused(small_v2, data):
    with changed(small_v2) as folder:
        edit_bytes(data.draw(st.sampled_from(sorted(folder.rglob("*.parquet"))), "file"), data)
        check(folder)
