"""Parquet files of version 2 of the data set, a row in memory at a time."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import check_file
from geoevs.core.text import clean

BUFFER_BYTES = 2**20
"""Bytes of a column that are read at once: a segment may be one row group of hundreds of MB."""

MOST_ROWS = 1_000_000
"""Rows of a table at most; a segment has some 20,000 boxes."""

MOST_VALUES = 2**30
"""Values of a row group's column at most: the range images of a segment have half as many."""

CONTEXT = "key.segment_context_name"


@contextmanager
def readable(where: str) -> Iterator[None]:
    """Name a place in a file in whatever goes wrong while the block decodes it.

    Raises:
        GeoEvsError: the block raised anything.
    """
    try:
        yield
    except GeoEvsError:
        raise
    except Exception as error:  # damaged tables raise anything
        reason = clean(str(error), 200) or type(error).__name__
        raise GeoEvsError(
            f"{where} is not whole or not laid out as Waymo's ({reason}); download its file again"
        ) from error


class Table:
    """One component of a segment: its small columns now, its rows when they are asked for.

    Args:
        path: a Parquet file.
        component: the prefix of its columns, such as `LiDARComponent`.
        name: the segment that all rows must be of.

    Raises:
        GeoEvsError: the file is missing, damaged, larger than any segment, or of another segment.
    """

    def __init__(self, path: Path, component: str, name: str) -> None:
        self.path = check_file(path)
        self._prefix = f"[{component}]."
        with readable(str(path)):
            # Without these two, a column's bytes of a whole row group would be read at once.
            self._file = pq.ParquetFile(path, buffer_size=BUFFER_BYTES, pre_buffer=False)
            metadata = self._file.metadata
            groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
            self._starts = [0, *accumulate(group.num_rows for group in groups)]
            most = max(
                (group.column(n).num_values for group in groups for n in range(group.num_columns)),
                default=0,
            )
        self.count = self._starts[-1]
        if self.count > MOST_ROWS or most > MOST_VALUES:
            raise GeoEvsError(
                f"{path} claims {self.count} rows and {most} values of a column, far beyond a "
                "Waymo segment; do not open this file, get the original"
            )
        self._stream: Iterator[pa.RecordBatch] = iter(())
        self._columns: tuple[str, ...] = ()
        self._next = self.count
        for found in set(self.keys(CONTEXT)):
            if found != name:
                raise GeoEvsError(
                    f"{path} has rows of segment '{clean(str(found), 60)}', not of '{name}'; name "
                    "files after their segment, and keep one in each"
                )

    def where(self, row: int) -> str:
        """What sentences call a row, with its file."""
        return f"{self.path}: row {row}"

    def keys(self, column: str) -> list[Any]:
        """A column of small values, such as a key, of all rows; `None` where a cell is empty.

        Raises:
            GeoEvsError: there is no such column, or it is damaged.
        """
        return self._read([column])[column]

    def values(self, *fields: str) -> list[dict[str, Any]]:
        """Some small fields of the component, of all rows, by their names without the prefix.

        Raises:
            GeoEvsError: there is no such field, or it is damaged.
        """
        columns = self._read([self._prefix + field for field in fields])
        return [
            dict(zip(fields, cells, strict=True)) for cells in zip(*columns.values(), strict=True)
        ]

    def rows(self, wanted: Sequence[int], *fields: str) -> Iterator[tuple[int, dict[str, Any]]]:
        """Some rows, ascending, one in memory at a time; lists of numbers are arrays.

        Asked for in the order of the file, each row is decoded once; going back begins anew.

        Raises:
            GeoEvsError: there is no such field, or it is damaged.
        """
        columns = tuple(self._prefix + field for field in fields)
        self._check_columns(columns)
        for row in sorted(wanted):
            with readable(self.where(row)):
                batch = self._row(row, columns)
                cells = {
                    field: _cell(batch.column(batch.schema.names.index(column))[0])
                    for field, column in zip(fields, columns, strict=True)
                }
            yield row, cells

    def _row(self, row: int, columns: tuple[str, ...]) -> pa.RecordBatch:
        group = next(n for n, start in enumerate(self._starts[1:]) if row < start)
        ahead = self._next >= self._starts[group] and self._next <= row
        if not ahead or columns != self._columns:
            groups = range(group, len(self._starts) - 1)
            self._stream = self._file.iter_batches(
                batch_size=1, row_groups=list(groups), columns=list(columns), use_threads=False
            )
            self._next, self._columns = self._starts[group], columns
        while self._next <= row:
            batch = next(self._stream)
            self._next += 1
        return batch

    def _read(self, columns: list[str]) -> dict[str, list[Any]]:
        self._check_columns(columns)
        with readable(str(self.path)):
            table = self._file.read(columns, use_threads=False)
            return {column: table[column].to_pylist() for column in columns}

    def _check_columns(self, columns: Sequence[str]) -> None:
        for column in columns:
            if self._file.schema_arrow.names.count(column) != 1:
                raise GeoEvsError(f"{self.path} has no column '{column}'; download it again")


def _cell(scalar: pa.Scalar) -> Any:
    """A cell: (N,) array of a list of numbers, None if it is empty, else as Python has it."""
    values = getattr(scalar, "values", None)
    if isinstance(values, pa.Array):
        return np.asarray(values.to_numpy(zero_copy_only=False))
    return scalar.as_py()
