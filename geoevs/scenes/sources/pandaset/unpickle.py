"""Reading PandaSet's pickled tables without running anything that they name.

A pickle is a program: it may call whatever it can import. PandaSet's tables (gzip'd pandas 1.x
data frames) need nine names, and here even those are never imported: each becomes an inert stand-in
that only keeps its arguments, and the table is then built from the numbers and strings they hold.
So no pandas or numpy constructor sees a stranger's bytes, and the files read alike under every
version of pandas.
"""

import gzip
import io
import pickle
import pickletools
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError

# The largest real table is 8 MB; a small file that swells past this is made to exhaust memory.
MAX_BYTES = 512 * 2**20
CHUNK_BYTES = 16 * 2**20
NUMBER_TYPES = ("b1", "i4", "i8", "f4", "f8")
CELL_TYPES = (str, int, float, bool, type(None))
MEMO_OPCODES = ("PUT", "BINPUT", "LONG_BINPUT")


class _Part:
    """What a pickle handed to one admitted name: its arguments and its state, never acted upon."""

    # Without a __dict__, and with __setstate__ on every instance, a pickle can set nothing else.
    __slots__ = ("arguments", "state")
    arguments: tuple[Any, ...]
    state: Any

    def __new__(cls, *arguments: Any) -> "_Part":
        part = super().__new__(cls)
        part.arguments = arguments
        part.state = None
        return part

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Frame(_Part):
    __slots__ = ()


class _Manager(_Part):
    __slots__ = ()


class _Index(_Part):
    __slots__ = ()


class _Array(_Part):
    __slots__ = ()


class _Dtype(_Part):
    __slots__ = ()


class _Slice(_Part):
    __slots__ = ()


class _Class(_Part):
    """A class that is only ever passed as an argument."""

    __slots__ = ()


ADMITTED = {
    ("pandas.core.frame", "DataFrame"): _Frame,
    ("pandas.core.internals.managers", "BlockManager"): _Manager,
    ("pandas.core.indexes.base", "_new_Index"): _Index,
    ("pandas.core.indexes.base", "Index"): _Class,
    ("pandas.core.indexes.range", "RangeIndex"): _Class,
    ("numpy.core.multiarray", "_reconstruct"): _Array,
    ("numpy", "ndarray"): _Class,
    ("numpy", "dtype"): _Dtype,
    ("builtins", "slice"): _Slice,
}


def read_table(path: Path) -> pd.DataFrame:
    """Read one gzip'd, pickled data frame of numbers and strings; its row labels are dropped.

    Raises:
        GeoEvsError: the file is missing, truncated, swells past MAX_BYTES, names anything but
            ADMITTED, or holds no such table.
    """
    raw = _decompress(Path(path))
    try:
        _check_memo(raw)
        return _build_table(_Unpickler(raw, path).load())
    except GeoEvsError:
        raise
    except Exception as error:  # a damaged pickle fails in any way that Python can
        raise GeoEvsError(
            f"{path} is not laid out as a PandaSet table; download it again"
        ) from error


def check_numbers(table: pd.DataFrame, columns: Iterable[str], path: Path) -> None:
    """Check that columns hold numbers, which texts and truth values are not.

    Raises:
        GeoEvsError: one does not; the sentence names the file and the column.
    """
    for column in columns:
        if table[column].dtype.kind not in "iuf":
            raise GeoEvsError(
                f"{path} has something else than numbers in '{column}'; download it again"
            )


def _decompress(path: Path) -> bytes:
    chunks, size = [], 0
    try:
        with gzip.open(path) as file:
            while chunk := file.read(CHUNK_BYTES):
                chunks.append(chunk)
                size += len(chunk)
                if size > MAX_BYTES:
                    raise GeoEvsError(
                        f"{path} unpacks to more than {MAX_BYTES // 2**20} MiB, far beyond a "
                        "PandaSet table; do not open this file, get the original"
                    )
    except FileNotFoundError as error:
        raise GeoEvsError(f"{path} is missing; copy it there or drop its frame") from error
    except (OSError, EOFError, zlib.error) as error:
        raise GeoEvsError(
            f"{path} is not a whole gzip file ({error}); download it again"
        ) from error
    return b"".join(chunks)


def _check_memo(raw: bytes) -> None:
    """Refuse memo slots beyond the pickle's own length: Python would allocate all of them."""
    for opcode, argument, _ in pickletools.genops(raw):
        if opcode.name in MEMO_OPCODES and (argument or 0) > len(raw):
            raise pickle.UnpicklingError("memo slot out of range")


class _Unpickler(pickle.Unpickler):
    def __init__(self, raw: bytes, path: Path) -> None:
        super().__init__(io.BytesIO(raw))
        self._path = path

    def find_class(self, module: str, name: str) -> type[_Part]:
        # An exact look-up: a dotted name such as `DataFrame.eval` is just another unknown one.
        if (module, name) not in ADMITTED:
            culprit = ascii(f"{module}.{name}"[:80])[1:-1]
            raise GeoEvsError(
                f"{self._path} contains {culprit}, which a PandaSet table has no use for; "
                "do not open this file, get the original"
            )
        return ADMITTED[module, name]


def _build_table(frame: Any) -> pd.DataFrame:
    manager = _expect(frame, _Frame).state["_data"]
    # pandas 0.14 to 1.x keep the whole state under this key; what stands before it repeats it.
    state = _expect(manager, _Manager).state[3]["0.14.1"]
    labels = _column_labels(state["axes"][0])
    columns: dict[str, np.ndarray] = {}
    for block in state["blocks"]:
        values = _build_array(block["values"])  # [columns of the block, rows]
        columns.update(zip(_block_labels(labels, block["mgr_locs"]), values, strict=True))
    return pd.DataFrame({label: columns[label] for label in labels})


def _column_labels(index: Any) -> list[str]:
    labels = _build_array(_expect(index, _Index).arguments[1]["data"]).tolist()
    if not all(isinstance(label, str) for label in labels):
        raise TypeError("column labels are strings")
    return labels


def _block_labels(labels: list[str], places: Any) -> list[str]:
    if isinstance(places, _Slice):
        return labels[slice(*places.arguments)]
    return [labels[place] for place in _build_array(places)]


def _build_array(part: Any) -> np.ndarray:
    """(...) numpy array from the state that numpy pickles: version, shape, dtype, order, data."""
    _, shape, dtype, is_fortran, data = _expect(part, _Array).state
    kind, byte_order = _expect(dtype, _Dtype).arguments[0], dtype.state[1]
    if kind == "O8":
        if type(data) is not list or not all(type(cell) in CELL_TYPES for cell in data):
            raise TypeError("cells are numbers and strings")
        flat = np.empty(len(data), object)
        flat[:] = data
    elif kind in NUMBER_TYPES:
        flat = np.frombuffer(data, np.dtype(kind).newbyteorder(byte_order))
    else:
        raise TypeError("columns are numbers and strings")
    return flat.reshape(shape, order="F" if is_fortran else "C")


def _expect(part: Any, kind: type[_Part]) -> Any:
    if type(part) is not kind:
        raise TypeError(f"expected {kind.__name__}")
    return part
