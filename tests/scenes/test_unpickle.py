import builtins
import contextlib
import os
import pickle
import struct
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.sources.pandaset import unpickle
from geoevs.scenes.sources.pandaset.unpickle import read_table


class Reduced:
    """Pickles as a call of `function`."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def refusal(path: Path) -> str:
    """The sentence that `read_table` refuses `path` with, which must name it on one line."""
    with pytest.raises(GeoEvsError) as caught:
        read_table(path)
    sentence = str(caught.value)
    assert str(path) in sentence
    assert "\n" not in sentence
    return sentence


def test_reads_numbers_and_strings_of_a_pandas_1_pickle(tmp_path, pandaset_files):
    columns = pandaset_files.cuboid_columns()
    path = pandaset_files.write_gzip(tmp_path / "t.pkl.gz", pandaset_files.old_pickle(columns))

    table = read_table(path)

    assert list(table) == list(columns)
    for label, expected in columns.items():
        if expected.dtype == object:
            assert table[label].fillna("nan").tolist() == [
                "nan" if cell != cell else cell for cell in expected
            ]
        else:
            assert table[label].dtype == expected.dtype
            assert table[label].tolist() == expected.tolist()


def test_blocks_in_column_order_of_memory_are_read_too(tmp_path, pandaset_files):
    # pandas stores a block C- or Fortran-ordered, as the frame happened to be made.
    files = pandaset_files
    values = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    raw = files.old_pickle({"a": values[0], "b": values[1]})
    fortran = files.array_call(values)
    version, shape, dtype, _, _ = fortran.state
    fortran = fortran._replace(state=(version, shape, dtype, True, values.tobytes(order="F")))
    before, after = (files.assemble(call) for call in (files.array_call(values), fortran))
    assert raw.count(before) == 1
    path = files.write_gzip(tmp_path / "t.pkl.gz", raw.replace(before, after))

    assert read_table(path)["b"].tolist() == [4.0, 5.0, 6.0]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize(
    ("hostile", "named"),
    [
        (lambda mark: Reduced(os.system, f"touch {mark}"), ("posix.system",)),
        (lambda mark: Reduced(eval, f"open({str(mark)!r}, 'w')"), ("eval",)),
        (lambda mark: Reduced(getattr, Reduced(__import__, "os"), "system"), ("getattr",)),
        (lambda mark: {"a": [(1, {"b": Reduced(os.mkdir, str(mark))})]}, ("mkdir",)),
        (
            lambda mark: np.array([1.0, Reduced(os.mkdir, str(mark))], object),
            ("numpy", "mkdir", "_codecs"),
        ),
        (lambda mark: Reduced(pd.read_pickle, str(mark)), ("read_pickle",)),
        # Protocols below 4 have no dotted names and reach methods by getattr.
        (lambda mark: Reduced(pd.DataFrame.eval, "1"), ("DataFrame.eval", "getattr")),
    ],
)
def test_refuses_what_no_table_needs_by_name(tmp_path, pandaset_files, hostile, named, protocol):
    mark = tmp_path / "was-run"
    raw = pickle.dumps(hostile(mark), protocol)
    path = pandaset_files.write_gzip(tmp_path / "t.pkl.gz", raw)

    sentence = refusal(path)

    assert any(name in sentence for name in named)
    assert "do not open this file" in sentence
    assert not mark.exists()


def test_refuses_a_call_hidden_in_a_cell_of_a_true_table(tmp_path, pandaset_files):
    files = pandaset_files
    mark = tmp_path / "was-run"
    raw = files.old_pickle({"label": np.array(["Car", "SWAP"], object)})
    hostile = files.assemble(files.Call(files.Name("posix mkdir"), (str(mark),)))
    path = files.write_gzip(tmp_path / "t.pkl.gz", raw.replace(files.assemble("SWAP"), hostile))

    assert "posix.mkdir" in refusal(path)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("raw", "named"),
    [
        (b"(S'true'\nios\nsystem\n.", "os.system"),  # INST
        (b"(cos\nsystem\nS'true'\no.", "os.system"),  # OBJ
        (b"\x80\x04\x8c\x11pandas.core.frame\x8c\x0eDataFrame.eval\x93.", "DataFrame.eval"),
        (b"\x80\x04\x8c\x08builtins\x8c\x0eslice.__init__\x93.", "slice.__init__"),
        (b"\x80\x04\x8c\x05numpy\x8c\x08fromfile\x93.", "numpy.fromfile"),
        (b"\x80\x04\x8c\x02os\x8c\x0esystem\nis fine\x93.", r"system\nis fine"),
    ],
)
def test_refuses_every_way_of_naming_a_global(tmp_path, pandaset_files, raw, named):
    assert named in refusal(pandaset_files.write_gzip(tmp_path / "t.pkl.gz", raw))


def test_no_admitted_name_is_the_real_thing():
    for module, name in unpickle.ADMITTED:
        part = unpickle._Unpickler(b"", Path("t")).find_class(module, name)
        assert part.__module__ == unpickle.__name__
        assert part is not getattr(builtins, name, None)


@pytest.mark.parametrize(
    "raw",
    [
        b"\x80\x03cnumpy\ndtype\n}b.",  # state for a class
        b"\x80\x03cnumpy\ndtype\nN}X\x09\x00\x00\x00argumentsNs\x86b.",  # attributes of a class
        b"\x80\x03cnumpy\ndtype\n)R}X\x01\x00\x00\x00aNsb.",  # state of an instance: kept, unused
        b"\x80\x04cnumpy\ndtype\n)}X\x01\x00\x00\x00aNs\x92.",  # keyword arguments
        b"\x80\x03X\x01\x00\x00\x00aQ.",  # persistent id
        b"\x80\x02\x82\x01.",  # copyreg extension
        b"\x80\x03N.",
        b"\x80\x03",
        b"",
        b"not a pickle",
    ],
)
def test_refuses_what_is_no_table(tmp_path, pandaset_files, raw):
    before = dict(vars(unpickle._Dtype))
    path = pandaset_files.write_gzip(tmp_path / "t.pkl.gz", raw)

    assert "not laid out as a PandaSet table" in refusal(path)
    assert dict(vars(unpickle._Dtype)) == before


def test_pickles_of_current_pandas_are_refused(tmp_path, pandaset_files):
    # PandaSet's release has none; admitting their Arrow buffers would widen the door for nobody.
    raw = pickle.dumps(pd.DataFrame({"x": [1.0]}))

    assert "contains pandas." in refusal(pandaset_files.write_gzip(tmp_path / "t.pkl.gz", raw))


@pytest.mark.parametrize("kind", ["M8[ns]", "V8", "O", "c16", "i2,i2"])
def test_refuses_number_types_that_no_column_has(tmp_path, pandaset_files, kind):
    files = pandaset_files
    raw = files.old_pickle({"x": np.array([1.0, 2.0])})
    swapped = raw.replace(files.assemble("f8"), files.assemble(kind))
    assert swapped != raw

    refusal(files.write_gzip(tmp_path / "t.pkl.gz", swapped))


def test_refuses_cells_that_are_neither_number_nor_string(tmp_path, pandaset_files):
    files = pandaset_files
    raw = files.old_pickle({"label": np.array(["Car", "SWAP"], object)})
    path = tmp_path / "t.pkl.gz"
    for cell in ([1, 2], {"a": 1}, b"bytes", files.Name("numpy ndarray")):
        files.write_gzip(path, raw.replace(files.assemble("SWAP"), files.assemble(cell)))

        assert "not laid out" in refusal(path)


def test_missing_truncated_or_foreign_files_are_named(tmp_path, pandaset_files):
    path = tmp_path / "t.pkl.gz"
    assert "is missing" in refusal(path)

    raw = pandaset_files.old_pickle(pandaset_files.sweep_columns())
    whole = pandaset_files.write_gzip(path, raw).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert "not a whole gzip file" in refusal(path)

    path.write_bytes(whole[:40] + bytes(20) + whole[60:])
    assert "download it again" in refusal(path)

    path.write_bytes(b"plain text")
    assert "not a whole gzip file" in refusal(path)


def test_a_file_that_swells_is_refused(tmp_path, pandaset_files, monkeypatch):
    monkeypatch.setattr(unpickle, "MAX_BYTES", 2**20)
    monkeypatch.setattr(unpickle, "CHUNK_BYTES", 2**16)
    path = pandaset_files.write_gzip(tmp_path / "t.pkl.gz", bytes(2**21))

    assert "unpacks to more than 1 MiB" in refusal(path)


def test_a_memo_slot_far_away_takes_no_memory(tmp_path, pandaset_files):
    raw = b"\x80\x03Nr" + struct.pack("<I", 2**32 - 1) + b"."
    path = pandaset_files.write_gzip(tmp_path / "t.pkl.gz", raw)
    start = time.perf_counter()

    assert "not laid out" in refusal(path)
    assert time.perf_counter() - start < 1.0


@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(place=st.integers(min_value=0), byte=st.integers(0, 255))
def test_a_damaged_byte_gives_a_table_or_a_sentence(tmp_path, pandaset_files, place, byte):
    raw = bytearray(pandaset_files.old_pickle(pandaset_files.cuboid_columns()))
    raw[place % len(raw)] = byte
    path = pandaset_files.write_gzip(tmp_path / "t.pkl.gz", bytes(raw))

    with contextlib.suppress(GeoEvsError):
        assert isinstance(read_table(path), pd.DataFrame)
