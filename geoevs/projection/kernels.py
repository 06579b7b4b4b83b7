"""How `geoevs.projection` counts: a numba kernel for CPUs, and torch ops for other devices.

Every path does the same float64 operations in the same order, so that all give the same bits:
no fused multiply-adds, no reciprocals in place of divisions, no matrix products.
"""

from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from geoevs.core.compiled import cached_njit
from geoevs.scenes.camera import Camera

if TYPE_CHECKING:
    import torch  # importing it costs seconds, so only those who hold tensors pay

Numbers = tuple[float, ...]
"""A camera as `lens_of` or `placing_of` gives it."""

# Points are projected a block at a time, so that coordinates, pixels and depths (36 kB) stay in
# the L1 cache between the loops below, and each loop is simple enough to become SIMD code.
BLOCK = 1024


def lens_of(camera: Camera) -> Numbers:
    """A camera as 18 numbers: camera_from_world by rows, fx, cx, fy, cy, width, height."""
    K = camera.K
    intrinsics = (K[0, 0], K[0, 2], K[1, 1], K[1, 2], camera.width, camera.height)
    return tuple(map(float, (*camera.camera_from_world[:3].ravel(), *intrinsics)))


def project_columns(px: Any, py: Any, pz: Any, lens: Numbers) -> tuple[Any, Any, Any]:
    """(u, v, depth) of world coordinates: scalars, arrays or tensors, whatever they may hold."""
    x = lens[0] * px + lens[1] * py + lens[2] * pz + lens[3]
    y = lens[4] * px + lens[5] * py + lens[6] * pz + lens[7]
    z = lens[8] * px + lens[9] * py + lens[10] * pz + lens[11]
    u = lens[12] * x / z + lens[13]
    v = lens[14] * y / z + lens[15]
    return u, v, z


_project = numba.njit(project_columns, error_model="numpy")


@cached_njit(nogil=True, error_model="numpy")
def project_numba(points: np.ndarray, lens: Numbers) -> tuple[np.ndarray, np.ndarray]:
    """(uv [N, 2], depth [N]); uv is NaN where the depth is not positive and finite."""
    uv = np.empty((len(points), 2))
    depth = np.empty(len(points))
    for i in range(len(points)):
        px, py, pz = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        u, v, z = _project(px, py, pz, lens)
        ahead = 0.0 < z < np.inf
        uv[i, 0] = u if ahead else np.nan
        uv[i, 1] = v if ahead else np.nan
        depth[i] = z
    return uv, depth


@numba.njit(error_model="numpy")
def _split_columns(points: np.ndarray, xs: np.ndarray, ys: np.ndarray, zs: np.ndarray) -> None:
    """[n, 3] to three columns: apart from the arithmetic, which then runs on whole vectors."""
    for i in range(len(points)):
        xs[i] = points[i, 0]
        ys[i] = points[i, 1]
        zs[i] = points[i, 2]


@numba.njit(error_model="numpy")
def _find_pixels(
    xs: np.ndarray,
    ys: np.ndarray,
    zs: np.ndarray,
    lens: Numbers,
    pixel: np.ndarray,
    depth: np.ndarray,
) -> None:
    """The flat pixel and depth of each point; H * W and infinity for those outside the view."""
    width, height = lens[16], lens[17]
    for i in range(len(xs)):
        u, v, z = _project(xs[i], ys[i], zs[i], lens)
        inside = (z > 0.0) & (z < np.inf) & (u >= 0.0) & (u < width) & (v >= 0.0) & (v < height)
        # Still a float until it is known to be small: 1e300 does not fit an integer.
        place = np.floor(v) * width + np.floor(u) if inside else width * height
        pixel[i] = np.uint32(np.int32(place))  # through int32: all that AVX2 converts to
        depth[i] = z if inside else np.inf


@cached_njit(nogil=True, error_model="numpy")
def zbuffer_numba(points: np.ndarray, lens: Numbers) -> tuple[np.ndarray, np.ndarray]:
    """(index [H, W] or -1, depth [H, W] or 0) of the front-most points."""
    shape = int(lens[17]), int(lens[16])
    pixels = shape[0] * shape[1]
    # The last entry stands for "outside": nothing is nearer than infinity, so it is never written.
    index = np.full(pixels + 1, -1, np.int64)
    nearest = np.full(pixels + 1, np.inf)
    xs, ys, zs, depth = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    pixel = np.empty(BLOCK, np.uint32)  # unsigned: no test for indices that count from the end
    for start in range(0, len(points), BLOCK):
        block = points[start : start + BLOCK]
        n = len(block)
        _split_columns(block, xs, ys, zs)
        _find_pixels(xs[:n], ys[:n], zs[:n], lens, pixel, depth)
        for i in range(n):
            if depth[i] < nearest[pixel[i]]:  # strict: the lower index keeps a tie
                nearest[pixel[i]] = depth[i]
                index[pixel[i]] = start + i
    for i in range(pixels):
        nearest[i] = 0.0 if index[i] < 0 else nearest[i]
    return index[:pixels].reshape(shape), nearest[:pixels].reshape(shape)


def placing_of(camera: Camera) -> Numbers:
    """A camera the other way round: world_from_camera by rows, fx, cx, fy, cy."""
    K = camera.K
    intrinsics = (K[0, 0], K[0, 2], K[1, 1], K[1, 2])
    return tuple(map(float, (*camera.world_from_camera[:3].ravel(), *intrinsics)))


def unproject_columns(column: Any, row: Any, z: Any, placing: Numbers) -> tuple[Any, Any, Any]:
    """The world coordinates of pixels' centres at depth z: scalars, arrays or tensors."""
    x = (column + 0.5 - placing[13]) / placing[12] * z
    y = (row + 0.5 - placing[15]) / placing[14] * z
    px = placing[0] * x + placing[1] * y + placing[2] * z + placing[3]
    py = placing[4] * x + placing[5] * y + placing[6] * z + placing[7]
    pz = placing[8] * x + placing[9] * y + placing[10] * z + placing[11]
    return px, py, pz


_unproject = numba.njit(unproject_columns, error_model="numpy")


@cached_njit(nogil=True, error_model="numpy")
def unproject_numba(depth: np.ndarray, placing: Numbers) -> tuple[np.ndarray, np.ndarray]:
    """(points [M, 3], flat pixels [M]) of the pixels whose depth is positive and finite."""
    height, width = depth.shape
    points = np.empty((height * width, 3))
    pixels = np.empty(height * width, np.int64)
    count = 0
    for row in range(height):
        for column in range(width):
            z = np.float64(depth[row, column])
            if 0.0 < z < np.inf:
                px, py, pz = _unproject(column, row, z, placing)
                points[count, 0], points[count, 1], points[count, 2] = px, py, pz
                pixels[count] = row * width + column
                count += 1
    return points[:count], pixels[:count]


def unproject_torch(
    depth: "torch.Tensor", placing: Numbers
) -> tuple["torch.Tensor", "torch.Tensor"]:
    """`unproject_numba` in torch ops, on the depth's device."""
    import torch

    width = depth.shape[1]
    flat = depth.detach().double().reshape(-1)
    pixels = ((flat > 0) & (flat < torch.inf)).nonzero()[:, 0]
    row, column = (pixels // width).double(), (pixels % width).double()
    return torch.stack(unproject_columns(column, row, flat[pixels], placing), 1), pixels


def project_torch(points: "torch.Tensor", lens: Numbers) -> tuple["torch.Tensor", "torch.Tensor"]:
    """`project_numba` in torch ops, on the points' device."""
    import torch

    px, py, pz = points.double().unbind(1)
    u, v, depth = project_columns(px, py, pz, lens)
    ahead = (depth > 0) & (depth < torch.inf)
    return torch.stack([u, v], 1).masked_fill(~ahead[:, None], torch.nan), depth


def zbuffer_torch(points: "torch.Tensor", lens: Numbers) -> tuple["torch.Tensor", "torch.Tensor"]:
    """`zbuffer_numba` in torch ops, on the points' device; a minimum has no order to depend on."""
    import torch

    width, height = lens[16], lens[17]
    pixels = int(width) * int(height)
    px, py, pz = points.double().unbind(1)
    u, v, z = project_columns(px, py, pz, lens)
    valid = (z > 0) & (z < torch.inf) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    order = valid.nonzero().squeeze(1)  # [M] indices of the valid points, rising
    z = z[order]
    pixel = v[order].long() * int(width) + u[order].long()
    nearest = torch.full((pixels,), torch.inf, dtype=torch.float64, device=points.device)
    nearest.scatter_reduce_(0, pixel, z, "amin")
    front = z == nearest[pixel]
    index = torch.full((pixels,), len(points), dtype=torch.int64, device=points.device)
    index.scatter_reduce_(0, pixel[front], order[front], "amin")
    empty = index == len(points)
    shape = int(height), int(width)
    return index.masked_fill(empty, -1).view(shape), nearest.masked_fill(empty, 0).view(shape)
