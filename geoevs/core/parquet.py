"""Tables of rows in Parquet files, written and put together whole or not at all."""

import io
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import whole_file, write_bytes


def write_parquet(path: Path, rows: pd.DataFrame) -> None:
    """Write rows as a Parquet file, without their index."""
    write_bytes(path, rows.to_parquet(index=False))


def join_parquet(path: Path, parts: Sequence[Path]) -> None:
    """Put the rows of files into one, in the order given, one file in memory at a time.

    Args:
        path: what to write.
        parts: Parquet files with the same columns, at least one.

    Raises:
        GeoEvsError: a file is missing, damaged, or has other columns than the first.
    """
    buffer = io.BytesIO()
    with whole_file(parts[0]):
        schema = pq.read_schema(parts[0])
    with pq.ParquetWriter(buffer, schema) as writer:
        for part in parts:
            with whole_file(part):
                rows = pq.read_table(part)
            if not rows.schema.equals(schema):
                raise GeoEvsError(
                    f"{part} has other columns than {parts[0]}; delete it and make it again"
                )
            writer.write_table(rows)
    write_bytes(path, buffer.getvalue())
