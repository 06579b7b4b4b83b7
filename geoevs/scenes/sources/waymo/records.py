"""TFRecord files: records found by seeking, each behind its length and followed by a checksum.

A record is 8 bytes of length, 4 of a checksum of these, the data, and 4 of a checksum of the data.
The checksum is a masked CRC-32C. That of the length is always checked, that of the data where the
package `google-crc32c` is installed.
"""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import check_file
from geoevs.core.protobuf import LONGEST_KEY, VARINT, damaged, read_key

HEADER, FOOTER = struct.Struct("<QI"), struct.Struct("<I")
MOST_RECORD_BYTES = 128 * 2**20
"""Bytes of a record at most; a real one has 2 to 10 MB."""

POLYNOMIAL = 0x82F63B78  # CRC-32C, its bits reversed


class Record(NamedTuple):
    """Where a record's data lie in its file; `number` counts from 0."""

    path: Path
    number: int
    start: int
    size: int

    @property
    def where(self) -> str:
        """What sentences call the record, with its file."""
        return f"{self.path}: record {self.number}"


class Part(NamedTuple):
    """A field of a record, its bytes not yet read; of a VARINT, `size` is the value."""

    number: int
    kind: int
    start: int
    size: int


def find_records(path: Path) -> list[Record]:
    """The records of a file; of each, its length alone is read.

    Raises:
        GeoEvsError: the file is missing, holds no record, ends within one, or a length is damaged.
    """
    path = check_file(path)
    size, at = path.stat().st_size, 0
    records: list[Record] = []
    with opened(path) as file:
        while at < size:
            record = _read_header(file, path, len(records), at, size)
            records.append(record)
            at = record.start + record.size + FOOTER.size
    if not records:
        raise GeoEvsError(f"{path} holds no record; download it again")
    return records


def first_record(path: Path) -> Record:
    """The first record of a file, found without looking at the others.

    Raises:
        GeoEvsError: see `find_records`.
    """
    with opened(check_file(path)) as file:
        return _read_header(file, path, 0, 0, path.stat().st_size)


def _read_header(file: BinaryIO, path: Path, number: int, at: int, size: int) -> Record:
    where = f"{path}: record {number}"
    file.seek(at)
    header = file.read(HEADER.size)
    if len(header) < HEADER.size:
        raise GeoEvsError(f"{where}: the file ends within the record's length; download it again")
    length, checksum = HEADER.unpack(header)
    if masked(crc32c(header[:8])) != checksum:
        raise damaged(where, "its length has another checksum")
    if at + HEADER.size + length + FOOTER.size > size:
        raise GeoEvsError(
            f"{where}: the file ends within the record, {size - at} bytes after its start; "
            "download it again"
        )
    if length > MOST_RECORD_BYTES:
        raise GeoEvsError(
            f"{where} has more than {MOST_RECORD_BYTES // 2**20} MiB, far beyond a Waymo frame; "
            "get the original"
        )
    return Record(path, number, at + HEADER.size, length)


def opened(path: Path) -> BinaryIO:
    """A file to be read; the caller closes it.

    Raises:
        GeoEvsError: it is gone, or may not be read.
    """
    try:
        return path.open("rb")
    except OSError as error:
        raise GeoEvsError(f"{path} cannot be read ({error.strerror}); mend its rights") from error


def read_record(record: Record) -> memoryview:
    """The data of a record.

    Raises:
        GeoEvsError: the file was cut off since, or the data have another checksum.
    """
    with opened(record.path) as file:
        data = read_bytes(file, record, record.start, record.size + FOOTER.size)
    (checksum,) = FOOTER.unpack(data[record.size :])
    data = data[: record.size]
    fast = _fast_crc32c()
    if fast is not None and masked(fast(bytes(data))) != checksum:
        raise damaged(record.where, "its data have another checksum")
    return data


def read_bytes(file: BinaryIO, record: Record, start: int, size: int) -> memoryview:
    """Bytes of a record from a place in its file.

    Raises:
        GeoEvsError: the file has fewer than when its records were found.
    """
    file.seek(start)
    data = file.read(size)
    if len(data) < size:
        raise GeoEvsError(f"{record.where}: the file was cut off meanwhile; download it again")
    return memoryview(data)


def scan(file: BinaryIO, record: Record, part: Part | None = None) -> Iterator[Part]:
    """The fields of a record, or of a message within it, read by seeking over what they hold.

    Raises:
        GeoEvsError: there is no message.
    """
    at, size = (record.start, record.size) if part is None else (part.start, part.size)
    end = at + size
    while at < end:
        head = read_bytes(file, record, at, min(LONGEST_KEY, end - at))
        key = read_key(head, 0, record.where)
        start = at + key.at
        at = start if key.kind == VARINT else start + key.size
        if at > end:
            raise damaged(record.where, f"field {key.number} is longer than what holds it")
        yield Part(key.number, key.kind, start, key.size)


def masked(checksum: int) -> int:
    """A CRC-32C as TFRecord files hold it: turned by 15 bits, plus a constant."""
    return ((checksum >> 15 | checksum << 17) + 0xA282EAD8) & 0xFFFF_FFFF


def crc32c(data: bytes) -> int:
    """The CRC-32C (Castagnoli) of a few bytes: a microsecond for each of them.

    >>> hex(crc32c(b"123456789"))  # the check value of RFC 3720's polynomial
    '0xe3069283'
    """
    checksum = 0xFFFF_FFFF
    for byte in data:
        checksum ^= byte
        for _ in range(8):
            checksum = checksum >> 1 ^ (POLYNOMIAL if checksum & 1 else 0)
    return checksum ^ 0xFFFF_FFFF


def _fast_crc32c() -> Callable[[bytes], int] | None:
    """The CRC-32C of megabytes, where its package is installed."""
    try:
        import google_crc32c
    except ImportError:
        return None
    return google_crc32c.value
