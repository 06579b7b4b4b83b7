import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_arrays
from geoevs.core.mapped import Stack, read_mapped, write_mapped

ARRAYS = {
    "a/image": np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4),
    "a/name": np.array(["x", "longer"]),
    "b": np.array([1.5, np.nan, -0.0]),
    "empty": np.zeros((0, 5), np.float32),
}


def test_arrays_survive_a_round_trip(tmp_path):
    write_mapped(tmp_path / "x.npz", ARRAYS)
    found = read_mapped(tmp_path / "x.npz")
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert (found[name].shape, found[name].dtype) == (array.shape, array.dtype)
        np.testing.assert_array_equal(np.asarray(found[name]), array)
    assert list(read_mapped(tmp_path / "x.npz", "a/")) == ["image", "name"]
    with np.load(tmp_path / "x.npz") as file:  # which is numpy's own format
        np.testing.assert_array_equal(file["a/image"], ARRAYS["a/image"])
    write_mapped(tmp_path / "y.npz", ARRAYS)
    assert (tmp_path / "x.npz").read_bytes() == (tmp_path / "y.npz").read_bytes()


@given(lengths=st.lists(st.integers(0, 4), min_size=1, max_size=4), data=st.data())
def test_a_stack_is_read_as_an_array_is(lengths, data):
    parts = [np.random.default_rng(n).integers(0, 9, (n, 2, 3)) for n in lengths]
    whole, stack = np.concatenate(parts), Stack(parts)
    assert (stack.shape, stack.ndim, len(stack)) == (whole.shape, 3, len(whole))
    np.testing.assert_array_equal(np.concatenate([whole[:0], *stack.pieces()]), whole)
    ends = st.integers(0, len(whole) + 1)
    part = slice(data.draw(ends), data.draw(ends))
    np.testing.assert_array_equal(stack[part], whole[part])
    if len(whole):
        numbers = st.integers(-len(whole), len(whole) - 1)
        rows = np.array(data.draw(st.lists(numbers, min_size=1, max_size=6)))
        np.testing.assert_array_equal(stack[rows], whole[rows])
        np.testing.assert_array_equal(stack[rows, rows % 2], whole[rows, rows % 2])
        np.testing.assert_array_equal(stack[int(rows[0])], whole[rows[0]])


def test_rows_are_decoded_when_they_are_read(tmp_path):
    bits = np.random.default_rng(0).integers(0, 2, (6, 8)).astype(bool)
    write_mapped(tmp_path / "x.npz", {"bits": np.packbits(bits, axis=1)})

    def decode(rows):
        return np.unpackbits(rows, axis=1).view(bool).reshape(-1, 2, 8)

    stack = read_mapped(tmp_path / "x.npz")["bits"].decoded((2,), decode, (2, 8), bool)
    both = Stack.join([stack, stack])
    assert (both.shape, both.dtype) == ((6, 2, 8), bool)
    np.testing.assert_array_equal(both[np.array([4, 2])], bits.reshape(3, 2, 8)[[1, 2]])


def test_large_arrays_are_written_piece_by_piece(tmp_path, monkeypatch):
    monkeypatch.setattr("geoevs.core.mapped.PIECE_BYTES", 24)
    stack = Stack([ARRAYS["a/image"]] * 3)
    assert [len(piece) for piece in stack.pieces()] == [2, 2, 2]
    write_mapped(tmp_path / "x.npz", {"x": stack})
    np.testing.assert_array_equal(np.asarray(read_mapped(tmp_path / "x.npz")["x"]), stack[:])


def written(path):
    """The bytes of a file with one array."""
    write_mapped(path, {"x": np.zeros((20, 30), np.uint8)})
    return path.read_bytes()


LONGER = b"(20, 30)", b"(99, 30)"
NEGATIVE = b"(20, 30)", b"(-2, 30)"
OBJECTS = b"'|u1'", b"'|O' "
BAD = {
    "compressed": (
        lambda path: write_arrays(path, {"x": np.zeros(9)}),
        r"x\.npy is compressed; make the file again$",
    ),
    "longer": (
        lambda path: path.write_bytes(written(path).replace(*LONGER)),
        r"x\.npy is not as long as it says; make it again$",
    ),
    "negative": (
        lambda path: path.write_bytes(written(path).replace(*NEGATIVE)),
        r"x\.npy is not as long as it says; make it again$",
    ),
    "objects": (lambda path: path.write_bytes(written(path).replace(*OBJECTS)), r"x\.npy is no"),
    "by columns": (
        lambda path: np.savez(path, x=np.asfortranarray(np.ones((3, 4)))),
        r"x\.npy is no array of rows; make the file again$",
    ),
    "truncated": (lambda path: path.write_bytes(written(path)[:-300]), "is not whole"),
    "no zip": (lambda path: path.write_bytes(b"no"), "is not whole"),
}


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_such_file_is_one_sentence(tmp_path, kind):
    make, sentence = BAD[kind]
    make(tmp_path / "x.npz")
    with pytest.raises(GeoEvsError, match=sentence):
        read_mapped(tmp_path / "x.npz")
