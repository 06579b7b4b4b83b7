"""Tables of rows in Parquet files, written and put together whole or not at all.

Every file carries a seal, a hash of its rows: what writes over rows in between is noticed when they
are put together. A seal keeps nobody from making another one.
"""

import hashlib
import io
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import check_file, new_file, whole_file, write_bytes

LONGEST_TEXT = 10_000
"""Most bytes of a text in a table."""

MOST_ROWS = 1_000_000, 100
"""A table may have so many rows, or so many for each byte of its file. Rows that a real run writes
take more; a bomb packs billions into a few."""

KINDS = {
    "string": ("text", lambda kind: pa.types.is_string(kind) or pa.types.is_large_string(kind)),
    "int64": ("whole numbers", pa.types.is_integer),
    "float64": ("numbers", lambda kind: pa.types.is_floating(kind) or pa.types.is_integer(kind)),
}
"""What a column of a type holds, in words, and the test of its type in a file."""

GROUP_ROWS = 2**17
"""Rows of a group in a file that is put together: some 10 MB in memory, and few enough groups that
a reader's work is with rows."""

SEAL = b"geoevs.seal"
"""The key of the seal in a schema's metadata."""


def write_parquet(path: Path, rows: pd.DataFrame) -> None:
    """Write rows as a sealed Parquet file, without their index."""
    table = pa.Table.from_pandas(rows, preserve_index=False)
    metadata = {**(table.schema.metadata or {}), SEAL: _seal(table)}
    buffer = io.BytesIO()
    pq.write_table(table.replace_schema_metadata(metadata), buffer)
    write_bytes(path, buffer.getvalue())


def join_parquet(path: Path, parts: Sequence[Path]) -> None:
    """Put the rows of sealed files into one, in the order given, in groups of GROUP_ROWS.

    Besides one file, no more rows than a group has are in memory at once.

    Args:
        path: what to write.
        parts: Parquet files with the same columns, at least one.

    Raises:
        GeoEvsError: there is no file, or one is missing, damaged, without a seal, changed since it
            was sealed, or has other columns than the first.
    """
    if not parts:
        raise GeoEvsError(f"there are no files to make {path} from; name at least one")
    with whole_file(parts[0]):
        schema = pq.read_schema(parts[0])
    metadata = {key: value for key, value in (schema.metadata or {}).items() if key != SEAL}
    schema = schema.with_metadata(metadata)
    with new_file(path) as partial, pq.ParquetWriter(partial, schema) as writer:
        waiting: list[pa.Table] = []
        for part in parts:
            with whole_file(part):
                rows = pq.read_table(part)
            if not rows.schema.equals(schema):
                raise GeoEvsError(
                    f"{part} has other columns than {parts[0]}; delete it and make it again"
                )
            check_seal(part, rows)
            waiting.append(rows.replace_schema_metadata(metadata))
            if sum(map(len, waiting)) >= GROUP_ROWS:
                writer.write_table(pa.concat_tables(waiting), GROUP_ROWS)
                waiting = []
        writer.write_table(pa.concat_tables(waiting) if waiting else schema.empty_table())


def read_parquet(
    path: Path,
    types: Mapping[str, str],
    columns: Sequence[str] | None = None,
    where: Mapping[str, Collection[str]] | None = None,
    and_first_of: Sequence[str] = (),
    categories: bool = False,
) -> pd.DataFrame:
    """Read a table that may be a stranger's: its columns are those asked for, or it is refused.

    It is read in parts of GROUP_ROWS, of which only the rows that are kept stay in memory. What
    else lies in the file, its notes for pandas among it, is not looked at.

    Args:
        path: a Parquet file.
        types: of every column that such tables have: `string`, `int64` or `float64`.
        columns: those to read; all of them by default.
        where: columns of text among them, and the values of which rows must have one to be kept.
        and_first_of: columns among them; the first row of every combination of their values is
            kept too.
        categories: whether texts become categories, in the order of the alphabet, which take a
            byte or two a row.

    Raises:
        GeoEvsError: the file is missing, damaged or a bomb, or a column is missing, has another
            type, or lacks a text or a whole number. Numbers that are not whole may be NaN.
    """
    path, columns = check_file(path), list(types if columns is None else columns)
    texts = [name for name in columns if types[name] == "string"]
    with whole_file(path):
        file = pq.ParquetFile(path, read_dictionary=texts)
        schema, count = file.schema_arrow, file.metadata.num_rows
        most, for_a_byte = MOST_ROWS
        bomb = count > max(most, for_a_byte * path.stat().st_size)
    if bomb:
        raise GeoEvsError(f"{path} claims {count} rows, more than it can hold; ask for it again")
    for name in columns:
        _check_column(path, schema, name, types[name])
    kept: list[pa.Table] = []
    seen: set[tuple] = set()
    with whole_file(path):
        for batch in file.iter_batches(GROUP_ROWS, columns=columns):
            rows = pa.Table.from_batches([batch]).select(columns)
            _check_cells(path, rows, types)
            if where is not None:
                rows = rows.filter(_is_kept(rows, where, and_first_of, seen))
            kept.append(rows)
        table = pa.concat_tables(kept) if kept else file.read(columns).select(columns)
        frame = table.to_pandas(ignore_metadata=True)
    plain = {name: types[name] for name in columns if not (categories and name in texts)}
    frame = frame.astype(plain)
    for name in texts if categories else ():
        # As an order of its own counts for nothing in a type's equality, astype would keep it.
        frame[name] = frame[name].cat.set_categories(sorted(frame[name].unique()))
    return frame


def _is_kept(
    rows: pa.Table,
    where: Mapping[str, Collection[str]],
    and_first_of: Sequence[str],
    seen: set[tuple],
) -> np.ndarray:
    """(N,) bool: which rows to keep; `seen` are combinations of earlier rows, and is added to."""
    keep = np.ones(len(rows), bool)
    for name, values in where.items():
        column = rows[name].combine_chunks()
        meets = pc.is_in(column.dictionary, pa.array(list(values), column.dictionary.type))
        keep &= meets.take(column.indices).to_numpy(zero_copy_only=False)
    if and_first_of:
        keys = rows.select(list(and_first_of)).to_pandas(ignore_metadata=True)
        firsts = np.flatnonzero(~keys.duplicated())
        for row, key in zip(firsts, keys.iloc[firsts].itertuples(index=False), strict=True):
            keep[row] |= tuple(key) not in seen
            seen.add(tuple(key))
    return keep


def _check_cells(path: Path, rows: pa.Table, types: Mapping[str, str]) -> None:
    """Refuse empty cells of texts and whole numbers, and texts that are too long."""
    for name in rows.column_names:
        if types[name] != "float64" and rows[name].null_count:
            raise GeoEvsError(f"{path}: column '{name}' has empty cells; make the file again")
        if types[name] == "string" and _longest(rows[name].unique()) > LONGEST_TEXT:
            raise GeoEvsError(
                f"{path}: column '{name}' holds a text of more than {LONGEST_TEXT} bytes; "
                "make the file again"
            )


def _check_column(path: Path, schema: pa.Schema, name: str, kind: str) -> None:
    """Refuse a file whose column `name` is missing, there twice or of another type."""
    held = schema.names.count(name)
    if held != 1:
        what = "lacks the column" if held == 0 else "has twice the column"
        raise GeoEvsError(f"{path} {what} '{name}'; make it again with this version")
    found = schema.field(name).type
    if pa.types.is_dictionary(found):
        found = found.value_type
    words, fits = KINDS[kind]
    if not fits(found):
        raise GeoEvsError(
            f"{path}: column '{name}' holds {found}, not {words}; make the file again"
        )


def _longest(texts: pa.Array) -> int:
    """Bytes of the longest text; 0 of none."""
    plain = texts.dictionary_decode() if pa.types.is_dictionary(texts.type) else texts
    return pc.max(pc.binary_length(plain)).as_py() or 0


def check_seal(path: Path, rows: pa.Table) -> None:
    """Check that rows are those that were written.

    Raises:
        GeoEvsError: they are not, or carry no seal.
    """
    seal = (rows.schema.metadata or {}).get(SEAL)
    if seal is None:
        raise GeoEvsError(
            f"{path} carries no seal, as files of earlier versions; delete it and make it again"
        )
    if seal != _seal(rows):
        raise GeoEvsError(
            f"{path} was changed after its rows were written; delete it and make it again"
        )


def _seal(table: pa.Table) -> bytes:
    """A hash of names and values, the same before and after a table lay in a file."""
    rows = table.replace_schema_metadata(None).to_pandas()
    digest = hashlib.sha256("\0".join(rows.columns).encode())
    digest.update(pd.util.hash_pandas_object(rows, index=False).to_numpy().tobytes())
    return digest.hexdigest().encode()
