import struct
import sys
from types import SimpleNamespace

import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.sources.waymo import records
from geoevs.scenes.sources.waymo.records import find_records, read_record, scan
from tests.scenes.waymo.writers import checksum, crc32c, record, sub, whole


@pytest.fixture
def three(tmp_path):
    """A file of three records: of 20, 0 and 5 bytes."""
    path = tmp_path / "three.tfrecord"
    path.write_bytes(record(b"a" * 20) + record(b"") + record(b"b" * 5))
    return path


def refusal(use) -> str:
    with pytest.raises(GeoEvsError) as caught:
        use()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_records_lie_behind_their_lengths(three):
    found = find_records(three)

    # 12 bytes before the data and 4 behind them.
    assert [(r.number, r.start, r.size) for r in found] == [(0, 12, 20), (1, 48, 0), (2, 64, 5)]
    assert bytes(read_record(found[2])) == b"bbbbb"
    assert found[2].where == f"{three}: record 2"


def test_checksums_are_those_of_the_format():
    # RFC 3720 B.4: the CRC-32C of 32 zero bytes, and of 32 bytes of ones.
    assert records.crc32c(bytes(32)) == 0x8A9136AA
    assert records.crc32c(b"\xff" * 32) == 0x62A8AB43
    data = b"any bytes at all"
    assert struct.pack("<I", records.masked(records.crc32c(data))) == checksum(data)


@pytest.mark.parametrize("cut", range(69 + 4))
def test_a_file_that_ends_early_names_the_record(three, cut):
    three.write_bytes(three.read_bytes()[:cut])
    if cut in (36, 52):
        assert len(find_records(three)) == (1 if cut == 36 else 2)
        return
    sentence = refusal(lambda: find_records(three))
    number = 0 if cut < 36 else 1 if cut < 52 else 2
    assert sentence.startswith(f"{three}: record {number}" if cut else f"{three} holds no record")


def test_a_length_with_another_checksum_is_refused(three):
    data = bytearray(three.read_bytes())
    data[36] ^= 1
    three.write_bytes(data)
    assert "record 1 is damaged (its length has another checksum)" in refusal(
        lambda: find_records(three)
    )


def test_a_length_beyond_the_file_or_all_sense_is_refused(three, monkeypatch):
    length = struct.pack("<Q", 2**60)
    three.write_bytes(length + checksum(length) + b"data")
    assert "ends within the record, 16 bytes after its start" in refusal(
        lambda: find_records(three)
    )
    monkeypatch.setattr(records, "MOST_RECORD_BYTES", 4)
    three.write_bytes(record(b"12345"))
    assert "more than 0 MiB, far beyond a Waymo frame" in refusal(lambda: find_records(three))


def test_data_are_checked_where_the_package_is_installed(three, monkeypatch):
    data = bytearray(three.read_bytes())
    data[15] ^= 1
    three.write_bytes(data)
    first = find_records(three)[0]
    monkeypatch.setitem(sys.modules, "google_crc32c", None)  # not installed
    assert len(read_record(first)) == 20
    monkeypatch.setitem(sys.modules, "google_crc32c", SimpleNamespace(value=crc32c))
    assert "record 0 is damaged (its data have another checksum)" in refusal(
        lambda: read_record(first)
    )
    assert len(read_record(find_records(three)[2])) == 5


def test_a_file_that_shrinks_meanwhile_is_named(three):
    last = find_records(three)[2]
    three.write_bytes(three.read_bytes()[:66])
    assert f"{three}: record 2: the file was cut off meanwhile" in refusal(
        lambda: read_record(last)
    )


def test_fields_are_found_without_reading_what_they_hold(tmp_path):
    path = tmp_path / "one.tfrecord"
    path.write_bytes(record(sub(4, bytes(10**6)) + whole(2, 77) + sub(6, b"box")))
    (found,) = find_records(path)
    read = []

    class Counted:
        def __init__(self, file):
            self.file = file

        def seek(self, place):
            self.file.seek(place)

        def read(self, size):
            read.append(size)
            return self.file.read(size)

    with path.open("rb") as file:
        parts = list(scan(Counted(file), found))
    assert [(part.number, part.size) for part in parts] == [(4, 10**6), (2, 77), (6, 3)]
    assert sum(read) < 100


def test_a_missing_file_is_named(tmp_path):
    assert "x.tfrecord is missing" in refusal(lambda: find_records(tmp_path / "x.tfrecord"))
