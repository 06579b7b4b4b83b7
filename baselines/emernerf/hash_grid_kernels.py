"""Multi-resolution hash encoding on the CPU: numba kernels for grids of any dimension.

Positions are (N, D) float32 in [0, 1], tables (entries, WIDTH) float32, features and their
gradients (N, levels * WIDTH) float32. `cells` (levels,) int64 are the cells along an axis of each
level, and `offsets` (levels + 1,) int64 where its entries begin. `primes` are D of PRIMES, a tuple,
from whose length the compiler knows D.

All kernels add to `result`, zero at first, and give the same bits on any number of threads: points
are dealt with apart from each other, and each level's gradient is summed by one thread, point after
point. The threads are Python's, to which kernels leave the interpreter's lock; numba's own would
take three times as long to compile.
"""

import numba
import numpy as np

from geoevs.core.compiled import cached_njit

# One factor an axis, as Instant NGP has them; the first one keeps neighbours together.
PRIMES = (1, 2654435761, 805459861, 3674653429)

# Points are taken a block at a time, so that what is known of them (24 kB in 4-D) stays in the L1
# cache between the loops below, each of them simple enough to become SIMD code.
BLOCK = 128

# Features a level, as published. The kernels name each of the four, so that they are in registers.
WIDTH = 4


@numba.njit(error_model="numpy")
def _find_cells(positions, cells, low, share):
    """The cell of every point, and its place in it; the far border is the last cell's."""
    for d in range(len(low)):
        for i in range(len(positions)):
            place = positions[i, d] * np.float32(cells)
            cell = min(max(np.int32(place), np.int32(0)), np.int32(cells - 1))
            low[d, i] = np.uint32(cell)
            share[d, i] = place - np.float32(cell)


@numba.njit(error_model="numpy")
def _find_rows(count, primes, low, cells, begin, end, rows):
    """The table's row of every corner of every point's cell."""
    dense = np.int64(1)
    for _ in range(len(primes)):
        dense *= cells + 1
    hashed = dense > end - begin
    first, mask = np.uint32(begin), np.uint32(end - begin - 1)
    for corner in range(1 << len(primes)):
        row, stride = rows[corner], np.uint32(1)
        row[:count] = 0
        for d in range(len(primes)):
            beyond, prime = np.uint32(corner >> d & 1), np.uint32(primes[d])
            if hashed:
                for i in range(count):
                    row[i] ^= (low[d, i] + beyond) * prime
            else:
                for i in range(count):
                    row[i] += (low[d, i] + beyond) * stride
                stride *= np.uint32(cells + 1)
        for i in range(count):
            row[i] = first + (row[i] & mask if hashed else row[i])


@numba.njit(error_model="numpy")
def _find_weights(count, share, skipped, weights):
    """The interpolation weights of the corners, without the factor of the skipped axis."""
    for corner in range(1 << len(share)):
        weights[corner, :count] = 1
        for d in range(len(share)):
            if d == skipped:
                continue
            if corner >> d & 1:
                for i in range(count):
                    weights[corner, i] *= share[d, i]
            else:
                for i in range(count):
                    weights[corner, i] *= np.float32(1) - share[d, i]


@numba.njit(error_model="numpy")
def _scratch(dims):
    """A block's cells and places in them, and its corners' rows and weights."""
    corners = 1 << dims
    low, share = np.empty((dims, BLOCK), np.uint32), np.empty((dims, BLOCK), np.float32)
    return low, share, np.empty((corners, BLOCK), np.uint32), np.empty((corners, BLOCK), np.float32)


@cached_njit(nogil=True, error_model="numpy")
def encode(first, last, primes, positions, table, cells, offsets, result):
    """Features [N, levels * WIDTH] of a range of points."""
    low, share, rows, weights = _scratch(len(primes))
    for start in range(first, last, BLOCK):
        here = positions[start : min(start + BLOCK, last)]
        for level in range(len(cells)):
            out = result[start:, level * WIDTH : (level + 1) * WIDTH]
            begin, end = offsets[level], offsets[level + 1]
            _find_cells(here, cells[level], low, share)
            _find_rows(len(here), primes, low, cells[level], begin, end, rows)
            _find_weights(len(here), share, -1, weights)
            for i in range(len(here)):
                a, b, c, d = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
                for corner in range(1 << len(primes)):
                    row, weight = rows[corner, i], weights[corner, i]
                    a += weight * table[row, 0]
                    b += weight * table[row, 1]
                    c += weight * table[row, 2]
                    d += weight * table[row, 3]
                out[i, 0], out[i, 1], out[i, 2], out[i, 3] = a, b, c, d


@cached_njit(nogil=True, error_model="numpy")
def table_gradient(first, last, primes, positions, gradient, cells, offsets, result):
    """The gradient [entries, WIDTH] of a range of levels, from that of the features."""
    low, share, rows, weights = _scratch(len(primes))
    for level in range(first, last):
        for start in range(0, len(positions), BLOCK):
            here = positions[start : start + BLOCK]
            slope = gradient[start:, level * WIDTH : (level + 1) * WIDTH]
            begin, end = offsets[level], offsets[level + 1]
            _find_cells(here, cells[level], low, share)
            _find_rows(len(here), primes, low, cells[level], begin, end, rows)
            _find_weights(len(here), share, -1, weights)
            for i in range(len(here)):
                a, b, c, d = slope[i, 0], slope[i, 1], slope[i, 2], slope[i, 3]
                for corner in range(1 << len(primes)):
                    row, weight = rows[corner, i], weights[corner, i]
                    result[row, 0] += weight * a
                    result[row, 1] += weight * b
                    result[row, 2] += weight * c
                    result[row, 3] += weight * d


@cached_njit(nogil=True, error_model="numpy")
def position_gradient(first, last, primes, positions, table, gradient, cells, offsets, result):
    """The gradient [N, D] of a range of points, from that of the features."""
    low, share, rows, weights = _scratch(len(primes))
    along = np.empty((1 << len(primes), BLOCK), np.float32)
    for start in range(first, last, BLOCK):
        here, out = positions[start : min(start + BLOCK, last)], result[start:]
        for level in range(len(cells)):
            slope = gradient[start:, level * WIDTH : (level + 1) * WIDTH]
            begin, end = offsets[level], offsets[level + 1]
            _find_cells(here, cells[level], low, share)
            _find_rows(len(here), primes, low, cells[level], begin, end, rows)
            for i in range(len(here)):
                a, b, c, d = slope[i, 0], slope[i, 1], slope[i, 2], slope[i, 3]
                for corner in range(1 << len(primes)):
                    row = rows[corner, i]
                    near = a * table[row, 0] + b * table[row, 1]
                    along[corner, i] = near + (c * table[row, 2] + d * table[row, 3])
            for axis in range(len(primes)):
                _find_weights(len(here), share, axis, weights)
                for corner in range(1 << len(primes)):
                    rise = np.float32(cells[level] if corner >> axis & 1 else -cells[level])
                    for i in range(len(here)):
                        out[i, axis] += rise * weights[corner, i] * along[corner, i]
