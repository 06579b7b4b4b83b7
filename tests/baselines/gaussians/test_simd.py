"""Vectors in numba functions: every operation against numpy's."""

import numba
import numpy as np
import pytest

from baselines.gaussians import simd
from baselines.gaussians.simd import LANES

rng = np.random.default_rng(0)
A, B, C = rng.normal(size=(3, LANES)).astype(np.float32)
A[3], B[5] = B[3], np.float32(0)


def run(operation, *vectors: np.ndarray) -> np.ndarray:
    """The vector that `operation` makes of vectors."""
    operation = numba.njit(operation)

    @numba.njit
    def one(a, out):
        simd.store(out, 0, operation(simd.load(a, 0)))

    @numba.njit
    def two(a, b, out):
        simd.store(out, 0, operation(simd.load(a, 0), simd.load(b, 0)))

    @numba.njit
    def three(a, b, c, out):
        simd.store(out, 0, operation(simd.load(a, 0), simd.load(b, 0), simd.load(c, 0)))

    out = np.empty(LANES, np.float32)
    (one, two, three)[len(vectors) - 1](*vectors, out)
    return out


@pytest.mark.parametrize(
    ("operation", "expected"),
    [
        (lambda a, b: a + b, A + B),
        (lambda a, b: a - b, A - B),
        (lambda a, b: a * b, A * B),
        (lambda a, b: b / a, B / A),
        (lambda a, b: a + 2.5, A + np.float32(2.5)),
        (lambda a, b: np.float32(2.5) - b, np.float32(2.5) - B),
        (lambda a, b: simd.minimum(a, b), np.minimum(A, B)),
        (lambda a, b: simd.maximum(a, 0.25), np.maximum(A, np.float32(0.25))),
        (lambda a, b: simd.select(simd.greater(a, b), a, 7.0), np.where(A > B, A, np.float32(7))),
        (
            lambda a, b: simd.select(simd.both(simd.greater(a, b), simd.greater(b, 0.0)), a, b),
            np.where((A > B) & (B > 0), A, B),
        ),
        (lambda a, b: simd.broadcast(1.5) + b * 0.0, np.full(LANES, 1.5, np.float32)),
    ],
)
def test_lane_by_lane(operation, expected: np.ndarray) -> None:
    np.testing.assert_array_equal(run(operation, A, B), expected)


def test_fma() -> None:
    exact = A.astype(np.float64) * B + C
    np.testing.assert_allclose(run(lambda a, b, c: simd.fma(a, b, c), A, B, C), exact, rtol=1e-5)


def test_exp2() -> None:
    @numba.njit
    def exp2(powers, out):
        for start in range(0, len(powers), LANES):
            simd.store(out, start, simd.exp2(simd.load(powers, start)))

    powers = np.linspace(-125, 10, 1000 * LANES).astype(np.float32)
    out = np.empty_like(powers)
    exp2(powers, out)
    np.testing.assert_allclose(out, np.exp2(powers.astype(np.float64)), rtol=3e-7)


def test_sums() -> None:
    vectors = rng.normal(size=(11, LANES)).astype(np.float32)

    @numba.njit
    def sums(v, out):
        first = (simd.load(v, 0), simd.load(v, 16), simd.load(v, 32), simd.load(v, 48))
        then = (simd.load(v, 64), simd.load(v, 80), simd.load(v, 96), simd.load(v, 112))
        last = (simd.load(v, 128), simd.load(v, 144), simd.load(v, 160))
        simd.store(out, 0, simd.sum_lanes(first + then + last))

    out = np.empty(LANES, np.float32)
    sums(vectors.ravel(), out)
    np.testing.assert_allclose(out[:11], vectors.sum(1, dtype=np.float64), rtol=1e-5, atol=1e-6)
    assert not out[11:].any()


def test_bits() -> None:
    @numba.njit
    def bits(a, b):
        found = simd.bits(simd.greater(simd.load(a, 0), simd.load(b, 0)))
        return found, simd.lowest_bit(found)

    found, lowest = bits(A, B)
    assert [found >> lane & 1 for lane in range(LANES)] == (A > B).tolist()
    assert lowest == np.flatnonzero(A > B)[0]


def test_aligned() -> None:
    for count in (16, 80, 1536):
        memory = numba.njit(lambda count: simd.aligned(count))(count)
        assert memory.shape == (count,)
        assert memory.ctypes.data % 64 == 0
