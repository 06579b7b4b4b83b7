"""EWA projection and shading of Gaussians, and their gradients: numba kernels, float64 inside.

A projected Gaussian is a row of 16 float32, a cache line, whose columns are named here. Its falloff
is kept whitened: in a pixel (dx, dy) off the centre, with u = root_xx * dx + root_yx * dy and
v = root_yy * dy, alpha is 2 ** (log_opacity - u * u - v * v). Unlike the inverse covariance, of
which that is the Cholesky factor, it loses no digits for footprints that are thin as needles.
"""

import math

import numba
import numpy as np

from baselines.gaussians.constants import (
    ALPHA_THRESHOLD,
    BLUR,
    FRAME_MARGIN,
    NEAR_PLANE,
    SH_C0,
    SH_C1,
)
from geoevs.core.compiled import cached_njit

COLUMNS = 16
CENTRE_X, CENTRE_Y, ROOT_XX, ROOT_YX, ROOT_YY, LOG_OPACITY, RED, GREEN, BLUE, DEPTH = range(10)
REACH, EXTENT_X, EXTENT_Y, TIP = range(10, 14)
"""Where alpha is the threshold, u * u + v * v is REACH. That ellipse reaches EXTENT_X and EXTENT_Y
to either side of the centre, and is widest at TIP below (right end) and above (left end)."""

GRAD_FALLOFF, GRAD_U, GRAD_V, GRAD_UU, GRAD_UV, GRAD_VV = range(4, 10)
"""Sums over pixels of g, g * u ... g * v * v with g = alpha * d loss / d alpha, after the gradients
by colour (0, 1, 2) and depth (3)."""

# exp(-sigma) = 2 ** -(u * u + v * v) where u and v are whitened and scaled by the root of this.
_SCALE = 0.5 / math.log(2.0)
_UNSCALE = 2.0 * math.log(2.0)
_LOG2_THRESHOLD = math.log2(ALPHA_THRESHOLD)
# The reach is meant for bins and blocks, which may hold a pixel too many but not one too few.
_SLACK = 2e-5

# No fastmath: a kernel just compiled and the same one from numba's cache are optimised apart, and
# only without it do both have the same last bits. Hence reciprocals are written out.
_jit = numba.njit(error_model="numpy")


@_jit
def _rotation(quats, i):
    """The rotation matrix by rows, the unit quaternion, and the length that it had."""
    w, x = np.float64(quats[i, 0]), np.float64(quats[i, 1])
    y, z = np.float64(quats[i, 2]), np.float64(quats[i, 3])
    length = math.sqrt(w * w + x * x + y * y + z * z)
    inverse = 1 / length
    w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return rows, (w, x, y, z), length


@_jit
def _turn(lens, x, y, z):
    """A direction in the world, in the camera."""
    return (
        lens[0] * x + lens[1] * y + lens[2] * z,
        lens[4] * x + lens[5] * y + lens[6] * z,
        lens[8] * x + lens[9] * y + lens[10] * z,
    )


@_jit
def _turn_back(lens, x, y, z):
    """A direction in the camera, in the world."""
    return (
        lens[0] * x + lens[4] * y + lens[8] * z,
        lens[1] * x + lens[5] * y + lens[9] * z,
        lens[2] * x + lens[6] * y + lens[10] * z,
    )


@_jit
def _place(means, i, lens):
    """The centre in the camera."""
    x, y, z = _turn(lens, np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2]))
    return x + lens[3], y + lens[7], z + lens[11]


@_jit
def _slopes(x, y, z, lens):
    """The slopes x / z and y / z, held to the frame and its margin: what is linearised."""
    fx, cx, fy, cy, width, height = lens[12:18]
    margin_x, margin_y = FRAME_MARGIN * width, FRAME_MARGIN * height
    slope_x = min(max(x / z, (-cx - margin_x) / fx), (width - cx + margin_x) / fx)
    slope_y = min(max(y / z, (-cy - margin_y) / fy), (height - cy + margin_y) / fy)
    return slope_x, slope_y


@_jit
def _axis(rotation, scales, i, k, lens):
    """Axis k of the Gaussian in the camera, one standard deviation long."""
    scale = np.float64(scales[i, k])
    x, y, z = _turn(lens, rotation[0][k], rotation[1][k], rotation[2][k])
    return scale * x, scale * y, scale * z


@_jit
def _project_one(means, quats, scales, opacities, i, lens, splat):
    """Fill in all columns but the colour, and give the radius; 0 if it is not in the picture."""
    x, y, z = _place(means, i, lens)
    opacity = np.float64(opacities[i])
    if not (z > NEAR_PLANE and ALPHA_THRESHOLD <= opacity < np.inf):
        return 0.0
    fx, cx, fy, cy, width, height = lens[12:18]
    u, v = fx * x / z + cx, fy * y / z + cy
    slope_x, slope_y = _slopes(x, y, z, lens)
    rotation, _, _ = _rotation(quats, i)
    xx, xy, yy = BLUR, 0.0, BLUR
    zoom_x, zoom_y = fx / z, fy / z
    for k in range(3):
        axis = _axis(rotation, scales, i, k, lens)
        across = zoom_x * (axis[0] - slope_x * axis[2])
        down = zoom_y * (axis[1] - slope_y * axis[2])
        xx += across * across
        xy += across * down
        yy += down * down
    determinant = xx * yy - xy * xy
    reach = math.log2(opacity) - _LOG2_THRESHOLD + _SLACK
    deviation_x, deviation_y = math.sqrt(xx), math.sqrt(yy)
    deviations = math.sqrt(reach * _UNSCALE)
    extent_x, extent_y = deviations * deviation_x, deviations * deviation_y
    inside = (
        (u + extent_x > 0)
        and (u - extent_x < width)
        and (v + extent_y > 0)
        and (v - extent_y < height)
    )
    if not (inside and 0 < determinant < np.inf):  # a NaN anywhere ends here too
        return 0.0
    root_yy = math.sqrt(_SCALE) / deviation_y
    root_xx = math.sqrt(_SCALE / determinant) * deviation_y
    splat[CENTRE_X], splat[CENTRE_Y] = u, v
    splat[ROOT_XX] = root_xx
    splat[ROOT_YX] = -xy / yy * root_xx
    splat[ROOT_YY] = root_yy
    splat[LOG_OPACITY] = reach + (_LOG2_THRESHOLD - _SLACK)
    splat[DEPTH] = z
    splat[REACH] = reach
    splat[EXTENT_X], splat[EXTENT_Y] = extent_x, extent_y
    splat[TIP] = xy / xx * extent_x
    return max(extent_x, extent_y)


@_jit
def _ray(means, i, lens):
    """The unit vector from the camera to the centre, and the distance, from `_place`."""
    x, y, z = _place(means, i, lens)
    distance = math.sqrt(x * x + y * y + z * z)
    inverse = 1 / distance
    x, y, z = _turn_back(lens, x * inverse, y * inverse, z * inverse)
    return x, y, z, distance


@_jit
def _shade_one(means, sh, i, lens, splat):
    """Fill in the colour."""
    x, y, z, _ = _ray(means, i, lens)
    for channel in range(3):
        value = 0.5 + SH_C0 * sh[i, 0, channel]
        if sh.shape[1] > 1:
            first, second, third = sh[i, 1, channel], sh[i, 2, channel], sh[i, 3, channel]
            value += SH_C1 * (z * second - y * first - x * third)
        splat[RED + channel] = 0.0 if value < 0 else value


@cached_njit(parallel=True, error_model="numpy")
def project(means, quats, scales, opacities, sh, lens):
    """(splats [N, 16], radii [N]); the rows of those with radius 0 hold nothing."""
    splats = np.empty((len(means), COLUMNS), np.float32)
    radii = np.empty(len(means), np.float32)
    for i in numba.prange(len(means)):
        radii[i] = _project_one(means, quats, scales, opacities, i, lens, splats[i])
        if radii[i] > 0:
            _shade_one(means, sh, i, lens, splats[i])
    return splats, radii


@_jit
def _turn_gradient_back(turned, unit, length):
    """From the gradient by a unit vector of four (or three and a 0) to that by the vector."""
    along = unit[0] * turned[0] + unit[1] * turned[1] + unit[2] * turned[2] + unit[3] * turned[3]
    inverse = 1 / length
    return (
        (turned[0] - along * unit[0]) * inverse,
        (turned[1] - along * unit[1]) * inverse,
        (turned[2] - along * unit[2]) * inverse,
        (turned[3] - along * unit[3]) * inverse,
    )


@_jit
def _quaternion_gradient(columns, unit, length):
    """From the gradient by the rotation's columns to that by the quaternion."""
    (xx, yx, zx), (xy, yy, zy), (xz, yz, zz) = columns
    w, x, y, z = unit
    by_unit = (
        2 * (x * (zy - yz) + y * (xz - zx) + z * (yx - xy)),
        2 * (w * (zy - yz) - 2 * x * (yy + zz) + y * (xy + yx) + z * (xz + zx)),
        2 * (w * (xz - zx) + x * (xy + yx) - 2 * y * (xx + zz) + z * (yz + zy)),
        2 * (w * (yx - xy) + x * (xz + zx) + y * (yz + zy) - 2 * z * (xx + yy)),
    )
    return _turn_gradient_back(by_unit, unit, length)


@_jit
def _footprint_gradient(splat, grad):
    """By the centre (x, y) and by the covariance (xx, xy, yy) in pixels, from the moments."""
    a, b, c = _UNSCALE * splat[ROOT_XX], _UNSCALE * splat[ROOT_YX], _UNSCALE * splat[ROOT_YY]
    centre_x = a * grad[GRAD_U]
    centre_y = b * grad[GRAD_U] + c * grad[GRAD_V]
    uu, uv, vv = 0.5 * grad[GRAD_UU], 0.5 * grad[GRAD_UV], 0.5 * grad[GRAD_VV]
    xx = a * a * uu
    xy = a * (b * uu + c * uv)
    yy = b * b * uu + 2 * b * c * uv + c * c * vv
    return centre_x, centre_y, xx, xy, yy


@_jit
def _project_one_backward(
    means, quats, scales, i, lens, footprint, by_depth, means_grad, quats_grad, scales_grad
):
    """Write the gradients by the centre, the quaternion and the scales."""
    x, y, z = _place(means, i, lens)
    fx, fy = lens[12], lens[14]
    slope_x, slope_y = _slopes(x, y, z, lens)
    rotation, unit, length = _rotation(quats, i)
    centre_x, centre_y, xx, xy, yy = footprint
    inverse = 1 / z
    zoom_x, zoom_y = fx * inverse, fy * inverse
    by_zoom_x = by_zoom_y = by_slope_x = by_slope_y = 0.0
    columns = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for k in range(3):
        axis = _axis(rotation, scales, i, k, lens)
        across = axis[0] - slope_x * axis[2]
        down = axis[1] - slope_y * axis[2]
        by_across = 2 * (xx * zoom_x * across + xy * zoom_y * down)
        by_down = 2 * (xy * zoom_x * across + yy * zoom_y * down)
        by_zoom_x += by_across * across
        by_zoom_y += by_down * down
        by_slope_x -= by_across * zoom_x * axis[2]
        by_slope_y -= by_down * zoom_y * axis[2]
        by_x, by_y = by_across * zoom_x, by_down * zoom_y
        turned = _turn_back(lens, by_x, by_y, -by_x * slope_x - by_y * slope_y)
        scales_grad[i, k] = (
            turned[0] * rotation[0][k] + turned[1] * rotation[1][k] + turned[2] * rotation[2][k]
        )
        scale = np.float64(scales[i, k])
        columns = (
            columns[1],
            columns[2],
            (scale * turned[0], scale * turned[1], scale * turned[2]),
        )
    by_quat = _quaternion_gradient(columns, unit, length)
    for k in range(4):
        quats_grad[i, k] = by_quat[k]
    by_x, by_y = centre_x * zoom_x, centre_y * zoom_y
    if slope_x == x / z:
        by_x += by_slope_x * inverse
    if slope_y == y / z:
        by_y += by_slope_y * inverse
    # What scales as 1 / z: both zooms, and x / z and y / z wherever they are used.
    by_z = by_depth - (by_zoom_x * zoom_x + by_zoom_y * zoom_y + by_x * x + by_y * y) * inverse
    by_mean = _turn_back(lens, by_x, by_y, by_z)
    for k in range(3):
        means_grad[i, k] = by_mean[k]


@_jit
def _shade_one_backward(means, sh, i, lens, splat, grad, means_grad, sh_grad):
    """Write the gradient by the coefficients, and add to that by the centre what the ray gives."""
    x, y, z, distance = _ray(means, i, lens)
    by_x = by_y = by_z = 0.0
    for channel in range(3):
        by_colour = grad[channel] if splat[RED + channel] > 0 else 0.0
        sh_grad[i, 0, channel] = SH_C0 * by_colour
        if sh.shape[1] > 1:
            scaled = SH_C1 * by_colour
            sh_grad[i, 1, channel] = -y * scaled
            sh_grad[i, 2, channel] = z * scaled
            sh_grad[i, 3, channel] = -x * scaled
            by_x -= scaled * sh[i, 3, channel]
            by_y -= scaled * sh[i, 1, channel]
            by_z += scaled * sh[i, 2, channel]
    if sh.shape[1] > 1:
        by_ray = _turn_gradient_back((by_x, by_y, by_z, 0.0), (x, y, z, 0.0), distance)
        for k in range(3):
            means_grad[i, k] += by_ray[k]


@cached_njit(parallel=True, error_model="numpy")
def project_backward(means, quats, scales, opacities, sh, lens, splats, radii, grads):
    """Gradients by the five parameters and by the centres in the picture [N, 2].

    `grads` [T, N, 16] holds each thread's share of the gradients by the rows of `splats`.
    """
    means_grad, quats_grad = np.zeros_like(means), np.zeros_like(quats)
    scales_grad, opacities_grad = np.zeros_like(scales), np.zeros_like(opacities)
    sh_grad, centres_grad = np.zeros_like(sh), np.zeros((len(means), 2), np.float32)
    for i in numba.prange(len(means)):
        if radii[i] > 0:
            grad = grads[0, i]
            for thread in range(1, len(grads)):
                for k in range(COLUMNS):
                    grad[k] += grads[thread, i, k]
            footprint = _footprint_gradient(splats[i], grad)
            opacities_grad[i] = grad[GRAD_FALLOFF] / opacities[i]
            centres_grad[i, 0], centres_grad[i, 1] = footprint[0], footprint[1]
            _project_one_backward(
                means, quats, scales, i, lens, footprint, grad[3], means_grad, quats_grad,
                scales_grad,
            )  # fmt: skip
            _shade_one_backward(means, sh, i, lens, splats[i], grad, means_grad, sh_grad)
    return means_grad, quats_grad, scales_grad, opacities_grad, sh_grad, centres_grad
