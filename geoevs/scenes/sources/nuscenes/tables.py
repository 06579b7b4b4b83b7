"""nuScenes' tables: JSON lists of records that name each other by their tokens.

The tables of v1.0-trainval have gigabytes, so that they are read a piece at a time, and only the
records of one scene are kept.
"""

import json
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import check_file
from geoevs.core.text import clean
from geoevs.scenes.checks import number, timestamp

PIECE = 2**24
"""Characters of a table that are read at once."""

LONGEST_RECORD = 2**20
"""Characters of a record at most; the longest of a release has a thousandth."""

UNIT_TOLERANCE = 1e-4
"""By which a quaternion's length may differ from 1; those of a release do by rounding alone."""

OPENING, NEXT = re.compile(r"\s*\[\s*(?:(\])\s*)?"), re.compile(r"\s*(?:,\s*|(\])\s*)")
"""What stands before the first record and after each; the group is the list's end."""


@dataclass(frozen=True)
class Record:
    """A record of a table, whose fields are checked as they are asked for.

    Args:
        values: its fields as they stand in the file.
        where: its file and token, for errors.
    """

    values: Mapping[str, Any]
    where: str

    def text(self, field: str) -> str:
        """A field that is text.

        Raises:
            GeoEvsError: it is missing or something else.
        """
        value = self.values.get(field)
        if not isinstance(value, str):
            raise GeoEvsError(f"{self.where} has no text as '{field}'; download the table again")
        return value

    def texts(self, field: str) -> list[str]:
        """A field that is a list of texts.

        Raises:
            GeoEvsError: it is missing or something else.
        """
        value = self.values.get(field)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise GeoEvsError(
                f"{self.where} has no list of texts as '{field}'; download the table again"
            )
        return value

    def flag(self, field: str) -> bool:
        """A field that is true or false.

        Raises:
            GeoEvsError: it is missing or something else.
        """
        value = self.values.get(field)
        if not isinstance(value, bool):
            raise GeoEvsError(
                f"{self.where} has neither true nor false as '{field}'; download the table again"
            )
        return value

    def array(self, field: str, shape: tuple[int, ...]) -> np.ndarray:
        """(*shape) float64 of a list of numbers, or of lists of them.

        Raises:
            GeoEvsError: it is missing, of another shape, or has a value that is no finite number.
        """
        flat = _flat(self.values.get(field), shape)
        if flat is None:
            size = " x ".join(map(str, shape))
            raise GeoEvsError(
                f"{self.where} has no {size} numbers as '{field}'; download the table again"
            )
        return np.array([number(item, field, self.where) for item in flat]).reshape(shape)

    @property
    def seconds(self) -> float:
        """Its `timestamp`, which counts microseconds.

        Raises:
            GeoEvsError: it is missing, or no finite number of 0 or more.
        """
        micros = number(self.values.get("timestamp"), "the timestamp", self.where)
        return timestamp(micros / 1e6, self.where)

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) rotation of its quaternion w, x, y, z.

        Raises:
            GeoEvsError: it is no quaternion of length 1.
        """
        quaternion = self.array("rotation", (4,))
        length = float(np.linalg.norm(quaternion))
        if abs(length - 1) > UNIT_TOLERANCE:
            raise GeoEvsError(
                f"{self.where} has a rotation whose quaternion has the length {length:.6g}, not 1; "
                "download the table again"
            )
        w, x, y, z = quaternion
        return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) rigid transform of its `rotation` and `translation`, metres.

        Raises:
            GeoEvsError: either is missing or impossible.
        """
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.array("translation", (3,))
        return matrix


def _flat(value: Any, shape: tuple[int, ...]) -> list[Any] | None:
    """The items of nested lists of this shape, in order; None if they have another."""
    items = [value]
    for count in shape:
        if not all(isinstance(item, list) and len(item) == count for item in items):
            return None
        items = [inner for item in items for inner in item]
    return items


class Table(dict[str, Record]):
    """Records of a table by token, in the file's order."""

    def __init__(self, folder: Path, name: str, field: str = "", wanted: Collection[str] = ()):
        """Read a table, or the records whose `field` has a text of `wanted`.

        Args:
            folder: of the release, such as v1.0-mini.
            name: of the table, such as `sample`.
            field: by which records are kept; all are if it is empty.
            wanted: the field's values.

        Raises:
            GeoEvsError: the file is missing or no list of records, a record that is kept has no
                token, or two have the same.
        """
        super().__init__()
        self.path = folder / f"{name}.json"
        for place, values in enumerate(_read_records(self.path)):
            if field:
                value = values.get(field)
                if not (isinstance(value, str) and value in wanted):
                    continue
            token = values.get("token")
            if not isinstance(token, str) or not token:
                raise GeoEvsError(f"{self.path}: record {place} has no token; download it again")
            where = f"{self.path}: record '{clean(token, 40)}'"
            if token in self:
                raise GeoEvsError(f"{where} stands there twice; download the table again")
            self[token] = Record(values, where)

    def named(self, record: Record, field: str) -> Record:
        """The record of this table that a record of another one names.

        Raises:
            GeoEvsError: there is none.
        """
        token = record.text(field)
        if token not in self:
            raise GeoEvsError(
                f"{record.where} names '{clean(token, 40)}' as its {field}, which {self.path.name} "
                "does not have; download both tables again"
            )
        return self[token]


def _read_records(path: Path) -> Iterator[dict[str, Any]]:
    """The records of a JSON list, with no more than a piece of it in memory.

    Raises:
        GeoEvsError: the file is missing, or no whole list of JSON objects.
    """
    decode = json.JSONDecoder().raw_decode
    count = 0
    try:
        with check_file(path).open(encoding="utf-8-sig") as file:
            text = file.read(PIECE)
            between = OPENING.match(text)
            while between is not None and not between[1]:
                at = between.end()
                if len(text) - at < LONGEST_RECORD:  # so that whole records lie ahead
                    text, at = text[at:] + file.read(PIECE), 0
                record, at = decode(text, at)
                if not isinstance(record, dict):
                    raise ValueError("no object")
                yield record
                count += 1
                between = NEXT.match(text, at)
            if between is not None and between.end() == len(text) and not file.read(1):
                return
    except OSError as error:
        raise GeoEvsError(f"{path} cannot be read ({error.strerror}); mend its rights") from error
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError among them
        raise GeoEvsError(
            f"{path}: record {count} is no JSON object ({clean(str(error), 80)}), or longer than "
            f"{LONGEST_RECORD} characters; download it again"
        ) from error
    raise GeoEvsError(
        f"{path} is no JSON list of records (see after record {count}); download it again"
    )
