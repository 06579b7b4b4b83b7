"""Front-to-back alpha blending of splats, and its gradient: numba kernels in explicit vectors.

A thread draws a stretch of the tiles. A tile is 4 x 4 blocks of 4 x 4 pixels, and a vector holds
the pixels of one block; so do the 16 values of one quantity that stand together in `state`.
Only the blocks that a splat's ellipse reaches are visited, and none whose pixels are finished.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from baselines.gaussians.binning_kernels import TILE
from baselines.gaussians.constants import (
    ALPHA_CAP,
    ALPHA_THRESHOLD,
    TRANSMITTANCE_THRESHOLD,
)
from baselines.gaussians.projection_kernels import (
    BLUE,
    CENTRE_X,
    CENTRE_Y,
    COLUMNS,
    DEPTH,
    GREEN,
    LOG_OPACITY,
    REACH,
    RED,
    ROOT_XX,
    ROOT_YX,
    ROOT_YY,
)
from baselines.gaussians.simd import (
    LANES,
    aligned,
    bits,
    both,
    broadcast,
    exp2,
    fma,
    greater,
    load,
    lowest_bit,
    maximum,
    minimum,
    select,
    store,
    sum_lanes,
)
from geoevs.core.compiled import cached_njit

PIXELS = TILE * TILE
BLOCK = 4
"""Side of a block in pixels."""

_X = np.tile(np.arange(BLOCK, dtype=np.float32), BLOCK)  # of a block's pixels, or a tile's blocks
_Y = np.repeat(np.arange(BLOCK, dtype=np.float32), BLOCK)
_ONE_BIT, _TWO, _THREE = np.uint32(1), np.uint32(2), np.uint32(3)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)
_BLOCK, _LAST = np.float32(BLOCK), np.float32(BLOCK - 1)
_CAP, _THRESHOLD = np.float32(ALPHA_CAP), np.float32(TRANSMITTANCE_THRESHOLD)
_LOG2_THRESHOLD = np.float32(math.log2(ALPHA_THRESHOLD))


class Splat(NamedTuple):
    """A row of `projection_kernels`, in registers."""

    centre_x: float
    centre_y: float
    root_xx: float
    root_yx: float
    root_yy: float
    log_opacity: float
    red: float
    green: float
    blue: float
    depth: float
    reach: float


@numba.njit(error_model="numpy")
def _read(splats, i):
    return Splat(
        splats[i, CENTRE_X],
        splats[i, CENTRE_Y],
        splats[i, ROOT_XX],
        splats[i, ROOT_YX],
        splats[i, ROOT_YY],
        splats[i, LOG_OPACITY],
        splats[i, RED],
        splats[i, GREEN],
        splats[i, BLUE],
        splats[i, DEPTH],
        splats[i, REACH],
    )


@numba.njit(error_model="numpy")
def _blocks_reached(splat, left, top):
    """The bits of a tile's blocks that hold a point of the splat's ellipse.

    The point of a block that is nearest to the centre in the splat's own metric lies where one of
    two lines crosses the block: along its upright edge that faces the centre, or along the other.
    """
    west = fma(load(_X, 0), _BLOCK, left + _HALF - splat.centre_x)
    north = fma(load(_Y, 0), _BLOCK, top + _HALF - splat.centre_y)
    east, south = west + _LAST, north + _LAST
    x_facing = minimum(maximum(west, _ZERO), east)
    y_facing = minimum(maximum(north, _ZERO), south)
    norm = splat.root_yx * splat.root_yx + splat.root_yy * splat.root_yy
    y = minimum(maximum(x_facing * (-splat.root_yx * splat.root_xx / norm), north), south)
    x = minimum(maximum(y_facing * (-splat.root_yx / splat.root_xx), west), east)
    u, v = fma(x_facing, splat.root_xx, y * splat.root_yx), y * splat.root_yy
    along_upright = fma(u, u, v * v)
    u, v = fma(x, splat.root_xx, y_facing * splat.root_yx), y_facing * splat.root_yy
    return bits(greater(splat.reach, minimum(along_upright, fma(u, u, v * v))))


@numba.njit(error_model="numpy")
def _blend_block(splats, ids, visits, x, y, transmittance):
    """(opacity, red, green, blue, depth, end) in the pixels (x, y) of one block.

    Draws the splats ids[visits], front to back, until no pixel is left that light gets through;
    `end` is how many that took. In pixels outside the frame, transmittance is 0 from the start.
    Opacity is a sum of its own: 1 - transmittance has few digits where it is low.
    """
    opacity = red = green = blue = depth = broadcast(_ZERO)
    for k in range(len(visits)):
        splat = _read(splats, ids[visits[k]])
        offset_x, offset_y = x - splat.centre_x, y - splat.centre_y
        u = fma(offset_x, splat.root_xx, offset_y * splat.root_yx)
        v = offset_y * splat.root_yy
        _, alpha = _alpha(splat.log_opacity - fma(u, u, v * v))
        weight = alpha * transmittance
        transmittance = transmittance - weight  # goes on falling in pixels that are finished
        unfinished = greater(transmittance, _THRESHOLD)
        weight = select(unfinished, weight, _ZERO)
        opacity = opacity + weight
        red, green = fma(weight, splat.red, red), fma(weight, splat.green, green)
        blue, depth = fma(weight, splat.blue, blue), fma(weight, splat.depth, depth)
        if bits(unfinished) == 0:
            return opacity, red, green, blue, depth, k + 1
    return opacity, red, green, blue, depth, len(visits)


@numba.njit(error_model="numpy")
def _alpha(log_alpha):
    """From log2 alpha, as it is and with cap and threshold."""
    uncapped = exp2(log_alpha)
    capped = minimum(uncapped, _CAP)
    return uncapped, select(greater(_LOG2_THRESHOLD, log_alpha), _ZERO, capped)


@numba.njit(error_model="numpy")
def _blend_tile(splats, ids, left, top, blocks, visits, state):
    """Fill `blocks` with the bits of the blocks in which each splat is drawn, and `state`.

    `state` comes with transmittance 1, or 0 outside the frame, and leaves with opacity, red, green,
    blue and depth. `visits` is space for as many integers as `ids`.
    """
    for k in range(len(ids)):
        blocks[k] = _blocks_reached(_read(splats, ids[k]), left, top)
    for block in range(LANES):
        count = 0
        for k in range(len(ids)):  # without branches: they would be mispredicted
            visits[count] = k
            count += blocks[k] >> block & 1
        x = load(_X, 0) + (left + _HALF + np.float32(block % 4 * BLOCK))
        y = load(_Y, 0) + (top + _HALF + np.float32(block // 4 * BLOCK))
        at = block * LANES
        opacity, red, green, blue, depth, end = _blend_block(
            splats, ids, visits[:count], x, y, load(state, at)
        )
        store(state, at, opacity)
        store(state, at + PIXELS, red)
        store(state, at + 2 * PIXELS, green)
        store(state, at + 3 * PIXELS, blue)
        store(state, at + 4 * PIXELS, depth)
        if end < count:
            unseen = np.uint16(~(1 << block))
            for k in range(visits[end], len(ids)):
                blocks[k] &= unseen


@numba.njit(error_model="numpy")
def _blend_tile_backward(splats, ids, blocks, left, top, state, grads):
    """Add the gradients by the splats to `grads` [N, 16], replaying the blending front to back.

    `state` holds transmittance, what the rest of the ray adds to the loss, and the gradients by
    red, green, blue and depth. That rest starts as what the whole ray adds;
    d loss / d alpha = transmittance * value - rest / (1 - alpha), where value is what the splat's
    colour and depth add to the loss at weight 1.
    """
    for k in range(len(ids)):
        waiting = np.uint32(blocks[k])
        if waiting == 0:
            continue
        splat = _read(splats, ids[k])
        varying_u = fma(load(_X, 0), splat.root_xx, load(_Y, 0) * splat.root_yx)
        varying_v = load(_Y, 0) * splat.root_yy
        red = green = blue = depth = falloff = broadcast(_ZERO)
        by_u = by_v = by_uu = by_uv = by_vv = broadcast(_ZERO)
        while waiting != 0:
            block = lowest_bit(waiting)
            waiting &= waiting - _ONE_BIT
            at = np.intp(block) * LANES
            x = left + np.float32(np.int32(block & _THREE) * BLOCK) + _HALF - splat.centre_x
            y = top + np.float32(np.int32(block >> _TWO) * BLOCK) + _HALF - splat.centre_y
            u = varying_u + (splat.root_xx * x + splat.root_yx * y)
            v = varying_v + splat.root_yy * y
            uncapped, alpha = _alpha(splat.log_opacity - fma(u, u, v * v))
            before = load(state, at)
            weight = alpha * before
            after = before - weight
            store(state, at, after)
            unfinished = greater(after, _THRESHOLD)
            weight = select(unfinished, weight, _ZERO)

            by_red, by_green = load(state, at + 2 * PIXELS), load(state, at + 3 * PIXELS)
            by_blue, by_depth = load(state, at + 4 * PIXELS), load(state, at + 5 * PIXELS)
            value = fma(by_red, splat.red, by_green * splat.green)
            value = fma(by_blue, splat.blue, fma(by_depth, splat.depth, value))
            added = weight * value
            rest = load(state, at + PIXELS) - added
            store(state, at + PIXELS, rest)
            by_falloff = added - rest * alpha / (_ONE - alpha)
            smooth = both(unfinished, greater(_CAP, uncapped))
            by_falloff = select(smooth, by_falloff, _ZERO)

            red, green = fma(weight, by_red, red), fma(weight, by_green, green)
            blue, depth = fma(weight, by_blue, blue), fma(weight, by_depth, depth)
            falloff = falloff + by_falloff
            times_u, times_v = by_falloff * u, by_falloff * v
            by_u, by_v = by_u + times_u, by_v + times_v
            by_uu, by_uv = fma(times_u, u, by_uu), fma(times_u, v, by_uv)
            by_vv = fma(times_v, v, by_vv)
        sums = sum_lanes((red, green, blue, depth, falloff, by_u, by_v, by_uu, by_uv, by_vv))
        row = np.intp(ids[k]) * COLUMNS
        store(grads, row, load(grads, row) + sums)


@numba.njit(error_model="numpy")
def _share(starts, thread, threads):
    """The stretch of tiles that a thread draws: about its share of all entries in the bins."""
    first = np.searchsorted(starts, starts[-1] * thread // threads)
    last = np.searchsorted(starts, starts[-1] * (thread + 1) // threads)
    return (first, last) if thread < threads - 1 else (first, len(starts) - 1)


@numba.njit(error_model="numpy")
def _place(y, x):
    """Where the pixel (y, x) of a tile stands in a quantity of the state."""
    return (y // BLOCK * BLOCK + x // BLOCK) * LANES + y % BLOCK * BLOCK + x % BLOCK


@cached_njit(parallel=True, error_model="numpy")
def blend(splats, ids, starts, background, height, width, threads):
    """((rgb [H, W, 3], depth [H, W], opacity [H, W]), blocks [E]) of binned splats."""
    blocks = np.empty(len(ids), np.uint16)
    most = np.max(starts[1:] - starts[:-1])
    rgb = np.empty((height, width, 3), np.float32)
    depth, opacity = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    columns = (width + TILE - 1) // TILE
    for thread in numba.prange(threads):
        state, visits = aligned(5 * PIXELS), np.empty(most + 1, np.int32)
        first, last = _share(starts, thread, threads)
        for tile in range(first, last):
            top, left = tile // columns * TILE, tile % columns * TILE
            bottom, right = min(TILE, height - top), min(TILE, width - left)
            state[:] = 0  # pixels outside the frame are finished
            for y in range(bottom):
                for x in range(right):
                    state[_place(y, x)] = 1
            start, stop = starts[tile], starts[tile + 1]
            _blend_tile(
                splats, ids[start:stop], np.float32(left), np.float32(top), blocks[start:stop],
                visits, state,
            )  # fmt: skip
            for y in range(bottom):
                for x in range(right):
                    at = _place(y, x)
                    covered = state[at]
                    for channel in range(3):
                        rgb[top + y, left + x, channel] = (
                            state[at + (1 + channel) * PIXELS]
                            + (np.float32(1) - covered) * background[channel]
                        )
                    opacity[top + y, left + x] = covered
                    depth[top + y, left + x] = (
                        state[at + 4 * PIXELS] / covered if covered > 0 else np.float32(0)
                    )
    return (rgb, depth, opacity), blocks


@cached_njit(parallel=True, error_model="numpy")
def blend_backward(
    splats, ids, starts, blocks, rgb, depth, opacity, by_rgb, by_depth, by_opacity, threads
):
    """Each thread's share [T, N, 16] of the gradients by the splats, from those by the pictures."""
    height, width = depth.shape
    grads = np.zeros((threads, len(splats), COLUMNS), np.float32)
    columns = (width + TILE - 1) // TILE
    for thread in numba.prange(threads):
        state = aligned(6 * PIXELS)
        first, last = _share(starts, thread, threads)
        for tile in range(first, last):
            top, left = tile // columns * TILE, tile % columns * TILE
            state[:] = 0
            for y in range(min(TILE, height - top)):
                for x in range(min(TILE, width - left)):
                    at, row, column = _place(y, x), top + y, left + x
                    covered = opacity[row, column]
                    # By the sum of weight * z, and by opacity: depth is their quotient.
                    by_sum = by_depth[row, column] / covered if covered > 0 else np.float32(0)
                    by_covered = by_opacity[row, column] - by_sum * depth[row, column]
                    added = by_sum * covered * depth[row, column]
                    added -= (np.float32(1) - covered) * by_covered
                    state[at] = 1
                    for channel in range(3):
                        state[at + (2 + channel) * PIXELS] = by_rgb[row, column, channel]
                        added += by_rgb[row, column, channel] * rgb[row, column, channel]
                    state[at + PIXELS] = added
                    state[at + 5 * PIXELS] = by_sum
            start, stop = starts[tile], starts[tile + 1]
            _blend_tile_backward(
                splats, ids[start:stop], blocks[start:stop], np.float32(left), np.float32(top),
                state, grads[thread],
            )  # fmt: skip
    return grads
