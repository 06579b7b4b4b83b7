"""Which Gaussians may be seen in which tiles, front to back: numba kernels."""

import math

import numba
import numpy as np

from baselines.gaussians.projection_kernels import (
    CENTRE_X,
    CENTRE_Y,
    DEPTH,
    EXTENT_Y,
    REACH,
    ROOT_XX,
    ROOT_YX,
    ROOT_YY,
    TIP,
)
from geoevs.core.compiled import cached_njit

TILE = 16
"""Side of a tile in pixels."""

_DIGIT = 11
_BUCKETS = 1 << _DIGIT


@cached_njit(error_model="numpy")
def depth_order(splats, radii):
    """Indices [M] int32 of the splats in the picture, front to back, equals by index.

    A radix sort: as integers, the bits of positive floats are in the order of the floats.
    """
    order = np.flatnonzero(radii > 0).astype(np.int32)
    keys = splats[:, DEPTH].copy().view(np.uint32)[order]
    other_order, other_keys = np.empty_like(order), np.empty_like(keys)
    for shift in range(0, 32, _DIGIT):
        starts = np.zeros(_BUCKETS + 1, np.int64)
        for key in keys:
            starts[((key >> shift) & (_BUCKETS - 1)) + 1] += 1
        for bucket in range(_BUCKETS):
            starts[bucket + 1] += starts[bucket]
        for k in range(len(keys)):
            bucket = (keys[k] >> shift) & (_BUCKETS - 1)
            place = starts[bucket]
            starts[bucket] = place + 1
            other_order[place] = order[k]
            other_keys[place] = keys[k]
        order, other_order = other_order, order
        keys, other_keys = other_keys, keys
    return order


@numba.njit(error_model="numpy")
def _tiles_between(low, high, tiles):
    """The first and last of `tiles` that hold a pixel centre of an interval; none if last < first.

    Clipped while still floats: not every float fits an integer.
    """
    first = max(np.ceil((low + 0.5) / TILE) - 1, 0.0)
    last = min(np.floor((high - 0.5) / TILE), tiles - 1.0)
    return int(min(first, tiles)), int(max(last, -1.0))


@numba.njit(error_model="numpy")
def _rows_of(splat, rows):
    """The first and last rows of tiles that a splat reaches."""
    return _tiles_between(
        splat[CENTRE_Y] - splat[EXTENT_Y], splat[CENTRE_Y] + splat[EXTENT_Y], rows
    )


@numba.njit(error_model="numpy")
def _columns_of(splat, row, columns):
    """The first and last tiles of a row that a splat's ellipse reaches, exactly.

    Within the row's band, an end of the ellipse lies at its tip, or else on the band's edge
    towards the tip.
    """
    top = max(row * TILE + 0.5 - splat[CENTRE_Y], -splat[EXTENT_Y])
    bottom = min((row + 1) * TILE - 0.5 - splat[CENTRE_Y], splat[EXTENT_Y])
    shear = splat[ROOT_YX] / splat[ROOT_XX]
    below = min(max(splat[TIP], top), bottom)
    above = min(max(-splat[TIP], top), bottom)
    v = splat[ROOT_YY] * below
    right = math.sqrt(max(splat[REACH] - v * v, 0.0)) / splat[ROOT_XX] - shear * below
    v = splat[ROOT_YY] * above
    left = -math.sqrt(max(splat[REACH] - v * v, 0.0)) / splat[ROOT_XX] - shear * above
    return _tiles_between(splat[CENTRE_X] + left, splat[CENTRE_X] + right, columns)


@cached_njit(parallel=True, error_model="numpy")
def bin_splats(splats, order, rows, columns, threads):
    """(ids [E] int32, starts [tiles + 1]): tile t holds the splats ids[starts[t] : starts[t + 1]].

    A counting sort: each thread counts, then fills in, a stretch of the depth order.
    """
    places = np.zeros((threads, rows * columns), np.int64)
    for thread in numba.prange(threads):
        for k in range(len(order) * thread // threads, len(order) * (thread + 1) // threads):
            splat = splats[order[k]]
            first_row, last_row = _rows_of(splat, rows)
            for row in range(first_row, last_row + 1):
                first, last = _columns_of(splat, row, columns)
                for tile in range(row * columns + first, row * columns + last + 1):
                    places[thread, tile] += 1
    starts = np.empty(rows * columns + 1, np.int64)
    total = 0
    for tile in range(rows * columns):
        starts[tile] = total
        for thread in range(threads):
            count = places[thread, tile]
            places[thread, tile] = total
            total += count
    starts[rows * columns] = total
    ids = np.empty(total, np.int32)
    for thread in numba.prange(threads):
        for k in range(len(order) * thread // threads, len(order) * (thread + 1) // threads):
            splat = splats[order[k]]
            first_row, last_row = _rows_of(splat, rows)
            for row in range(first_row, last_row + 1):
                first, last = _columns_of(splat, row, columns)
                for tile in range(row * columns + first, row * columns + last + 1):
                    ids[places[thread, tile]] = order[k]
                    places[thread, tile] += 1
    return ids, starts
