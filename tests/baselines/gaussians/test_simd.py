"""Vectors in numba functions: every operation against numpy's."""

import numba
import numpy as np

from baselines.gaussians import simd
from baselines.gaussians.simd import LANES

rng = np.random.default_rng(0)
A, B, C = rng.normal(size=(3, LANES)).astype(np.float32)
A[3], B[5] = B[3], np.float32(0)


def test_lane_by_lane() -> None:
    @numba.njit
    def run(arrays, out):
        a, b, c = simd.load(arrays, 0), simd.load(arrays, 16), simd.load(arrays, 32)
        mask = simd.greater(a, b)
        simd.store(out[0], 0, a + b)
        simd.store(out[1], 0, a - b)
        simd.store(out[2], 0, a * b)
        simd.store(out[3], 0, b / a)
        simd.store(out[4], 0, a + 2.5)
        simd.store(out[5], 0, np.float32(2.5) - b)
        simd.store(out[6], 0, simd.minimum(a, b))
        simd.store(out[7], 0, simd.maximum(a, 0.25))
        simd.store(out[8], 0, simd.select(mask, a, 7.0))
        simd.store(out[9], 0, simd.select(simd.both(mask, simd.greater(b, 0.0)), a, b))
        simd.store(out[10], 0, simd.broadcast(1.5))
        simd.store(out[11], 0, simd.fma(a, b, c))

    out = np.empty((12, LANES), np.float32)
    run(np.concatenate([A, B, C]), out)
    expected = [
        A + B,
        A - B,
        A * B,
        B / A,
        A + np.float32(2.5),
        np.float32(2.5) - B,
        np.minimum(A, B),
        np.maximum(A, np.float32(0.25)),
        np.where(A > B, A, np.float32(7)),
        np.where((A > B) & (B > 0), A, B),
        np.full(LANES, 1.5, np.float32),
    ]
    np.testing.assert_array_equal(out[:11], expected)
    np.testing.assert_allclose(out[11], A.astype(np.float64) * B + C, rtol=1e-5)


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
        memory = simd.aligned(count)
        assert memory.shape == (count,)
        assert memory.ctypes.data % 64 == 0
