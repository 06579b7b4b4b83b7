"""Arrays that stay on disk: written one after the other, read in rows when they are asked for."""

import math
import struct
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.lib import format as npy

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_file, whole_file

PIECE_BYTES = 2**26
"""Bytes of an array that are in memory at once while all of it is gone through."""

LOCAL_HEADER = struct.Struct("<26xHH")
"""How a member of a zip begins: 26 bytes, and the lengths of the name and of what follows it."""

HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
"""What reads the header of an array, by the version of its format."""


@dataclass(frozen=True)
class _Stored:
    """An array that lies in a file, in C order from some byte on; rows are copied out of it."""

    path: Path
    offset: int
    dtype: np.dtype
    shape: tuple[int, ...]

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: Any) -> np.ndarray:
        # Mapped for this one look: a map holds a file open, and there are more scenes than those.
        return np.array(np.memmap(self.path, self.dtype, "r", self.offset, self.shape)[rows])


class Stack:
    """Arrays one behind the other along their first axis, of which only what is read is in memory.

    It is indexed as an array is: by a number, a slice or an array of numbers of rows, and behind
    them by what those rows are indexed by. `numpy.asarray` reads all of it.

    Args:
        parts: arrays, in memory or stored, that differ in their length alone; at least one.
        decode: what makes rows of those that the parts hold.
        shape: of a decoded row.
        dtype: of decoded rows.
    """

    def __init__(
        self,
        parts: Sequence["np.ndarray | Stack | _Stored"],
        decode: Callable[[np.ndarray], np.ndarray] | None = None,
        shape: tuple[int, ...] | None = None,
        dtype: Any = None,
    ) -> None:
        self._parts = [part for part in parts if len(part)] or list(parts[:1])
        self._decode = decode or (lambda rows: rows)
        self._ends = np.cumsum([len(part) for part in self._parts])
        self.shape = (int(self._ends[-1]), *(self._parts[0].shape[1:] if shape is None else shape))
        self.dtype = np.dtype(self._parts[0].dtype if dtype is None else dtype)

    @classmethod
    def join(cls, stacks: Sequence["Stack"]) -> Self:
        """Stacks of one kind one behind the other; rows are decoded as the first one's are."""
        first = stacks[0]
        parts = [part for stack in stacks for part in stack._parts]
        return cls(parts, first._decode, first.shape[1:], first.dtype)

    def decoded(
        self,
        stored: tuple[int, ...],
        decode: Callable[[np.ndarray], np.ndarray],
        shape: tuple[int, ...],
        dtype: Any,
    ) -> "Stack":
        """The same bytes as rows of other shapes: `stored` in the file, `shape` when decoded."""
        parts = [_reshaped(part, stored) for part in self._parts]
        return Stack(parts, decode, shape, dtype)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def ndim(self) -> int:
        """How many axes it has."""
        return len(self.shape)

    def __getitem__(self, index: Any) -> np.ndarray:
        rows, *inner = index if isinstance(index, tuple) else (index,)
        numbers = np.arange(len(self))[rows]
        wanted = np.atleast_1d(numbers)
        owners = np.searchsorted(self._ends, wanted, side="right")
        first = self._parts[0]
        found = np.empty((len(wanted), *first.shape[1:]), first.dtype)
        for owner in np.unique(owners):
            mine = owners == owner
            part = self._parts[owner]
            found[mine] = part[wanted[mine] - (self._ends[owner] - len(part))]
        decoded = self._decode(found)
        if inner:
            return decoded[(np.arange(len(wanted)), *inner)]
        return decoded if np.ndim(numbers) else decoded[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self[:], dtype)

    def pieces(self) -> Iterator[np.ndarray]:
        """All rows in their order, some of them at once."""
        size = max(1, math.prod(self.shape[1:]) * self.dtype.itemsize)
        step = max(1, PIECE_BYTES // size)
        for start in range(0, len(self), step):
            yield self[start : start + step]


def _reshaped(part: np.ndarray | _Stored, row: tuple[int, ...]) -> np.ndarray | _Stored:
    shape = (math.prod(part.shape) // max(1, math.prod(row)), *row)
    return replace(part, shape=shape) if isinstance(part, _Stored) else part.reshape(shape)


def pieces(array: np.ndarray | Stack) -> Iterator[np.ndarray]:
    """An array's rows in their order, some of them at once."""
    return array.pieces() if isinstance(array, Stack) else iter([array])


def write_mapped(path: Path, arrays: Mapping[str, np.ndarray | Stack]) -> None:
    """Write named arrays as an .npz that is not compressed, whole or not at all.

    Raises:
        GeoEvsError: the disk is full, or the folder is read-only.
    """
    with new_file(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")  # which has no time: the same bytes every time
            with archive.open(member, "w", force_zip64=True) as file:
                header = {
                    "descr": npy.dtype_to_descr(array.dtype),
                    "fortran_order": False,
                    "shape": tuple(array.shape),
                }
                npy.write_array_header_1_0(file, header)
                for piece in pieces(array):
                    file.write(piece.tobytes())


def read_mapped(path: Path, prefix: str = "") -> dict[str, Stack]:
    """The arrays of `write_mapped` whose names begin with `prefix`, without it; none is read yet.

    Raises:
        GeoEvsError: the file is missing or damaged, or an array is compressed, of another length
            than it says, or of objects.
    """
    path = Path(path).absolute()
    with whole_file(path), path.open("rb") as file, zipfile.ZipFile(file) as archive:
        found = {}
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if name.startswith(prefix):
                found[name.removeprefix(prefix)] = Stack([_stored(path, file, member)])
        return found


def _stored(path: Path, file: BinaryIO, member: zipfile.ZipInfo) -> _Stored:
    file.seek(member.header_offset)
    lengths = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size))
    start = file.seek(sum(lengths), 1)
    if member.compress_type != zipfile.ZIP_STORED:
        raise GeoEvsError(f"{path}: {member.filename} is compressed; make the file again")
    shape, in_columns, dtype = HEADERS[npy.read_magic(file)](file)
    offset = file.tell()
    length = math.prod(shape) * dtype.itemsize
    ends = file.seek(0, 2)
    if offset + length != start + member.file_size or offset + length > ends:
        raise GeoEvsError(f"{path}: {member.filename} is not as long as it says; make it again")
    if dtype.hasobject or in_columns or not shape:
        raise GeoEvsError(f"{path}: {member.filename} is no array of rows; make the file again")
    return _Stored(path, offset, dtype, shape)
