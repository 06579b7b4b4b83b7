"""Tables of rows in Parquet files, written and put together whole or not at all.

Every file carries a seal, a hash of its rows: what writes over rows in between is noticed when they
are put together. A seal keeps nobody from making another one.
"""

import hashlib
import io
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import whole_file, write_bytes

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
    """Put the rows of sealed files into one, in the order given, one file in memory at a time.

    Args:
        path: what to write.
        parts: Parquet files with the same columns, at least one.

    Raises:
        GeoEvsError: a file is missing, damaged, without a seal, changed since it was sealed, or has
            other columns than the first.
    """
    buffer = io.BytesIO()
    with whole_file(parts[0]):
        schema = pq.read_schema(parts[0])
    metadata = {key: value for key, value in (schema.metadata or {}).items() if key != SEAL}
    schema = schema.with_metadata(metadata)
    with pq.ParquetWriter(buffer, schema) as writer:
        for part in parts:
            with whole_file(part):
                rows = pq.read_table(part)
            if not rows.schema.equals(schema):
                raise GeoEvsError(
                    f"{part} has other columns than {parts[0]}; delete it and make it again"
                )
            check_seal(part, rows)
            writer.write_table(rows.replace_schema_metadata(metadata))
    write_bytes(path, buffer.getvalue())


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
