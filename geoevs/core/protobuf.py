"""Protocol-buffer messages as bytes, by field number: no generated code, no protobuf runtime.

A message is a row of fields. Each begins with a varint whose low three bits say how it goes on: 0 a
varint, 1 eight bytes, 5 four bytes, 2 a length and so many bytes (a text, a message, a packed
list). Nothing is copied until a value is asked for, and every length is checked before it is used.
"""

from typing import NamedTuple

import numpy as np

from geoevs.core.errors import GeoEvsError

VARINT, DOUBLE, BYTES, FLOAT = 0, 1, 2, 5
FIXED = {DOUBLE: 8, FLOAT: 4}
LONGEST_VARINT = 10
"""Bytes of 64 bits in groups of seven."""

LONGEST_KEY = 2 * LONGEST_VARINT
"""Bytes that tell a field's number, kind and length, at most."""

MOST_FIELDS = 100_000
"""Fields of a message at most: a map feature has some thousand, any other message a few hundred."""


def damaged(where: str, what: str) -> GeoEvsError:
    """The error of bytes that are no such message as was asked for."""
    return GeoEvsError(f"{where} is damaged ({what}); download its file again")


class Key(NamedTuple):
    """How a field begins.

    `size` is how many bytes follow at `at`; of a VARINT it is the value itself, and nothing
    follows.
    """

    number: int
    kind: int
    size: int
    at: int


def read_varint(data: memoryview, at: int, where: str) -> tuple[int, int]:
    """An unsigned whole number of up to 64 bits, and where it ends.

    >>> read_varint(memoryview(bytes([0xAC, 0x02])), 0, "")
    (300, 2)
    """
    value = 0
    for count, byte in enumerate(data[at : at + LONGEST_VARINT]):
        value |= (byte & 0x7F) << 7 * count
        if byte < 0x80:
            return value & 0xFFFF_FFFF_FFFF_FFFF, at + count + 1
    raise damaged(where, "a number in it does not end")


def read_key(data: memoryview, at: int, where: str) -> Key:
    """How the field at `at` begins.

    Raises:
        GeoEvsError: no field begins there.
    """
    tag, at = read_varint(data, at, where)
    number, kind = tag >> 3, tag & 7
    if kind in (VARINT, BYTES):
        size, at = read_varint(data, at, where)
    elif kind in FIXED:
        size = FIXED[kind]
    else:
        raise damaged(where, f"a field in it is of the kind {kind}")
    if number == 0:
        raise damaged(where, "a field in it has the number 0")
    return Key(number, kind, size, at)


class Message:
    """A message's fields by number; what is absent reads as 0, as empty or as no values.

    Args:
        data: its bytes.
        where: it stands, for errors.

    Raises:
        GeoEvsError: the bytes are no message, or a value asked for is of another kind.
    """

    def __init__(self, data: memoryview | bytes, where: str) -> None:
        data = memoryview(data)
        self.where = where
        self.fields: dict[int, list[int | memoryview]] = {}
        at = count = 0
        while at < len(data):
            key = read_key(data, at, where)
            at = key.at
            value: int | memoryview = key.size
            if key.kind != VARINT:
                if at + key.size > len(data):
                    raise damaged(where, f"field {key.number} is longer than what holds it")
                value = data[at : at + key.size]
                at += key.size
            self.fields.setdefault(key.number, []).append(value)
            count += 1
            if count > MOST_FIELDS:
                raise damaged(where, f"a message in it has more than {MOST_FIELDS} fields")

    def chunks(self, number: int) -> list[memoryview]:
        """The bytes of each value of a field that holds no varints."""
        return [self._chunk(number, value) for value in self.fields.get(number, [])]

    def chunk(self, number: int) -> memoryview:
        """The bytes of a field's last value; empty if it has none."""
        return (self.chunks(number) or [memoryview(b"")])[-1]

    def text(self, number: int) -> str:
        """A text, decoded; empty if the field has none."""
        try:
            return str(self.chunk(number), "utf-8")
        except UnicodeDecodeError as error:
            raise damaged(self.where, f"field {number} is no text") from error

    def messages(self, number: int) -> list["Message"]:
        """All messages of a field, in their order."""
        return [Message(data, self.where) for data in self.chunks(number)]

    def message(self, number: int) -> "Message":
        """The last message of a field; one without fields if it has none."""
        return Message(self.chunk(number), self.where)

    def whole(self, number: int) -> int:
        """A whole number of 0 or more; 0 if the field has none."""
        value = self.fields.get(number, [0])[-1]
        if not isinstance(value, int):
            raise damaged(self.where, f"field {number} is no whole number")
        return value

    def wholes(self, number: int) -> list[int]:
        """A list of whole numbers, packed or not."""
        values: list[int] = []
        for value in self.fields.get(number, []):
            if isinstance(value, int):
                values.append(value)
                continue
            at = 0
            while at < len(value):
                packed, at = read_varint(value, at, self.where)
                values.append(packed)
        return values

    def doubles(self, number: int) -> np.ndarray:
        """(N,) float64 of a list of eight-byte numbers, packed or not."""
        return self._numbers(number, "<f8").astype(np.float64)

    def floats(self, number: int) -> np.ndarray:
        """(N,) float32 of a list of four-byte numbers, packed or not."""
        return self._numbers(number, "<f4").astype(np.float32, copy=False)

    def double(self, number: int) -> float:
        """An eight-byte number; 0 if the field has none."""
        return float(self._last(self._numbers(number, "<f8")))

    def float(self, number: int) -> float:
        """A four-byte number; 0 if the field has none."""
        return float(self._last(self._numbers(number, "<f4")))

    def _chunk(self, number: int, value: int | memoryview) -> memoryview:
        if isinstance(value, int):
            raise damaged(self.where, f"field {number} is a whole number")
        return value

    def _numbers(self, number: int, dtype: str) -> np.ndarray:
        chunks = self.chunks(number)
        data = chunks[0] if len(chunks) == 1 else b"".join(chunks)
        if len(data) % np.dtype(dtype).itemsize:
            raise damaged(self.where, f"field {number} holds other numbers")
        return np.frombuffer(data, dtype)

    def _last(self, values: np.ndarray) -> np.ndarray:
        return values[-1] if len(values) else np.zeros(())
