"""Files of what is known of many targets: one dataclass of arrays for each target key."""

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from geoevs.core.files import open_arrays, whole_file, write_arrays
from geoevs.core.stamps import MADE_WITH, NOTHING, Stamp

Record = TypeVar("Record")


def check_array(array: np.ndarray, what: str, kinds: str, shape: tuple[int | None, ...]) -> None:
    """Check an array of a record, for its dataclass's `check`.

    Args:
        array: as it was read.
        what: it is called, for errors.
        kinds: letters of `numpy.dtype.kind` that it may have.
        shape: its shape; None for any length of an axis.

    Raises:
        ValueError: it is of another type or shape, or not finite.
    """
    fits = array.ndim == len(shape) and all(
        wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True)
    )
    if array.dtype.kind not in kinds or not fits or not np.isfinite(array).all():
        raise ValueError(f"its array '{what}' is {array.dtype} of shape {array.shape}, or has NaN")


def record_arrays(records: Mapping[str, Any], made_with: Stamp) -> dict[str, np.ndarray]:
    """The arrays of a file of records.

    Args:
        records: dataclasses of arrays, by target key.
        made_with: what they were made with.
    """
    arrays = {
        f"{key}/{field.name}": getattr(record, field.name)
        for key, record in records.items()
        for field in fields(record)
    }
    return {MADE_WITH: np.array(json.dumps(dict(made_with))), **arrays}


def write_records(path: Path, records: Mapping[str, Any], made_with: Stamp = NOTHING) -> None:
    """Write dataclasses of arrays, by target key, as one .npz, whole or not at all."""
    write_arrays(path, record_arrays(records, made_with))


class Records(Generic[Record]):
    """The records in a file of `write_records`, read one target at a time.

    Subclasses set `kind`, the dataclass of a record, whose `check` refuses what it cannot hold.

    Raises:
        GeoEvsError: the file is missing or not whole.
    """

    kind: ClassVar[type]

    def __init__(self, path: Path) -> None:
        self._path = Path(path)
        self._file = open_arrays(path)

    @property
    def made_with(self) -> Any:
        """The stamp that `write_records` was given; None in files without."""
        if MADE_WITH not in self._file:
            return None
        with whole_file(self._path):
            return json.loads(str(self._file[MADE_WITH]))

    def __getitem__(self, key: str) -> Record:
        """The record of the target with this key.

        Raises:
            GeoEvsError: the file has none, or one whose arrays the record refuses.
        """
        with whole_file(self._path):
            arrays = {field.name: self._file[f"{key}/{field.name}"] for field in fields(self.kind)}
            record = self.kind(**arrays)
            record.check()
        return record
