"""Files of what is known of many targets: one dataclass of arrays for each target key."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from geoevs.core.files import open_arrays, whole_file, write_arrays

Record = TypeVar("Record")


def write_records(path: Path, records: Mapping[str, Any]) -> None:
    """Write dataclasses of arrays, by target key, as one .npz, whole or not at all."""
    arrays = {
        f"{key}/{field.name}": getattr(record, field.name)
        for key, record in records.items()
        for field in fields(record)
    }
    write_arrays(path, arrays)


class Records(Generic[Record]):
    """The records in a file of `write_records`, read one target at a time.

    Subclasses set `kind`, the dataclass of a record.

    Raises:
        GeoEvsError: the file is missing or not whole.
    """

    kind: ClassVar[type]

    def __init__(self, path: Path) -> None:
        self._path = Path(path)
        self._file = open_arrays(path)

    def __getitem__(self, key: str) -> Record:
        """The record of the target with this key."""
        with whole_file(self._path):
            arrays = {field.name: self._file[f"{key}/{field.name}"] for field in fields(self.kind)}
        return self.kind(**arrays)
