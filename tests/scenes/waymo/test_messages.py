import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.core import protobuf
from geoevs.core.errors import GeoEvsError
from geoevs.core.protobuf import Message
from geoevs.scenes.sources.waymo import matrices
from geoevs.scenes.sources.waymo.matrices import read_matrix
from tests.fuzzing import refused
from tests.scenes.waymo.writers import (
    double,
    doubles,
    matrix,
    packed,
    single,
    sub,
    varint,
    whole,
)


def refusal(use) -> str:
    """The one-line sentence that `use` is refused with."""
    with pytest.raises(GeoEvsError) as caught:
        use()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_values_of_every_kind_are_read_by_number():
    # By hand: field 1 varint 150 (protobuf's own example), field 2 "ab", field 3 the double 1.
    data = bytes.fromhex("08 9601 12 02 6162 19 000000000000f03f".replace(" ", ""))
    message = Message(data + single(4, 0.5) + sub(5, whole(1, 7)), "x")

    assert message.whole(1) == 150
    assert message.text(2) == "ab"
    assert message.double(3) == 1.0
    assert message.float(4) == 0.5
    assert message.message(5).whole(1) == 7


def test_what_is_absent_is_zero_and_the_last_of_two_counts():
    message = Message(whole(1, 3) + whole(1, 4) + double(2, 5.0) + double(2, 6.0), "x")

    assert (message.whole(1), message.double(2)) == (4, 6.0)
    assert (message.whole(9), message.double(9), message.float(9), message.text(9)) == (0, 0, 0, "")
    assert message.messages(9) == []
    assert message.message(9).fields == {}
    assert read_matrix(message, 9, 4) is None


def test_lists_are_the_same_packed_or_not():
    values = [1.5, -2.0, 3.25]
    apart = Message(doubles(1, values) + whole(2, 300) + whole(2, 5), "x")
    together = Message(packed(1, values, "<f8") + sub(2, varint(300) + varint(5)), "x")

    for message in (apart, together):
        np.testing.assert_array_equal(message.doubles(1), values)
        assert message.wholes(2) == [300, 5]


def test_a_matrix_is_read_in_rows():
    array = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    read = read_matrix(Message(sub(2, matrix(array)), "x"), 2, 4)

    np.testing.assert_array_equal(read, array)


@given(st.integers(0, 2**64 - 1))
def test_varints_are_what_was_written(value):
    data = memoryview(varint(value) + b"tail")
    assert protobuf.read_varint(data, 0, "x") == (value, len(data) - 4)


@given(st.binary(max_size=60))
def test_any_bytes_are_a_message_or_refused(data):
    messages = []
    refused(lambda: messages.append(Message(data, "x")))
    for message in messages:
        for number in message.fields:
            for read in (message.text, message.wholes, message.doubles, message.messages):
                refused(lambda read=read, number=number: read(number))


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"\x08\x80", "does not end"),
        (b"\x08" + b"\xff" * 10, "does not end"),
        (b"\x0a\x05ab", "field 1 is longer than what holds it"),
        (b"\x09\x00", "field 1 is longer than what holds it"),
        (b"\x0b", "of the kind 3"),
        (b"\x02\x00", "the number 0"),
    ],
)
def test_bytes_that_are_no_message_are_refused(data, what):
    assert what in refusal(lambda: Message(data, "x: record 3"))
    assert refusal(lambda: Message(data, "x: record 3")).startswith("x: record 3 is damaged")


def test_values_of_another_kind_are_refused():
    message = Message(whole(1, 7) + single(2, 1.0) + sub(3, b"\xff"), "x")

    assert "field 1 is a whole number" in refusal(lambda: message.double(1))
    assert "field 2 holds other numbers" in refusal(lambda: message.double(2))
    assert "field 2 is no whole number" in refusal(lambda: message.whole(2))
    assert "field 3 is no text" in refusal(lambda: message.text(3))


def test_a_message_of_too_many_fields_is_refused(monkeypatch):
    monkeypatch.setattr(protobuf, "MOST_FIELDS", 3)
    Message(whole(1, 1) * 3, "x")
    assert "more than 3 fields" in refusal(lambda: Message(whole(1, 1) * 4, "x"))


@pytest.mark.parametrize(
    ("dims", "what"),
    [
        ([2, 3, 4], ""),
        ([2, 3, 5], "24 values do not fill rows x columns x 4 of 2 x 3 x 5"),
        ([2, 4, 4], "24 values do not fill"),
        ([2**40, 2**40, 4], "24 values do not fill"),
        ([6, 4], "24 values do not fill"),
        ([], "24 values do not fill rows x columns x 4 of 0"),
    ],
)
def test_dims_that_lie_are_refused(dims, what):
    raw = packed(1, np.arange(24), "<f4") + sub(2, b"".join(whole(1, side) for side in dims))
    message = Message(sub(2, zlib.compress(raw)), "x: record 3")

    if what:
        assert what in refusal(lambda: read_matrix(message, 2, 4))
    else:
        assert read_matrix(message, 2, 4).shape == (2, 3, 4)


def test_a_bomb_is_refused_before_it_is_unpacked(monkeypatch):
    monkeypatch.setattr(matrices, "MOST_MATRIX_BYTES", 2**20)
    message = Message(sub(2, zlib.compress(bytes(2**26))), "x: record 3")

    assert "unpacks to more than 1 MiB" in refusal(lambda: read_matrix(message, 2, 4))


@pytest.mark.parametrize("spoil", [lambda d: d[:-9], lambda d: b"\0" + d, lambda d: d[:9] + d[40:]])
def test_damaged_compression_is_refused(spoil):
    data = spoil(matrix(np.random.default_rng(0).random((5, 6, 4), np.float32)))
    message = Message(sub(2, data), "x: record 3")

    assert "x: record 3 is damaged (a range image" in refusal(lambda: read_matrix(message, 2, 4))
