"""How `geoevs.projection` counts: a numba kernel for CPUs, and torch ops for other devices.

Every path does the same float64 operations in the same order, so that all give the same bits:
no fused multiply-adds, no reciprocals in place of divisions, no matrix products.
"""

import numba
import numpy as np

from geoevs.scenes.camera import Camera

# One block of points, pixels and depths (28 kB with float32 points) stays in the L1 cache
# between the loop that projects it and the loop that scatters it.
BLOCK = 1024


def lens_of(camera: Camera) -> tuple[float, ...]:
    """A camera as 19 numbers: camera_from_world by rows, fx, skew, cx, fy, cy, width, height."""
    K = camera.K
    intrinsics = (K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2], camera.width, camera.height)
    return tuple(map(float, (*camera.camera_from_world[:3].ravel(), *intrinsics)))


def project_columns(px, py, pz, lens):
    """World coordinates to (u, v, depth): scalars, arrays or tensors, whatever they may hold."""
    x = lens[0] * px + lens[1] * py + lens[2] * pz + lens[3]
    y = lens[4] * px + lens[5] * py + lens[6] * pz + lens[7]
    z = lens[8] * px + lens[9] * py + lens[10] * pz + lens[11]
    u = (lens[12] * x + lens[13] * y) / z + lens[14]
    v = lens[15] * y / z + lens[16]
    return u, v, z


_project = numba.njit(project_columns, error_model="numpy")


@numba.njit(cache=True, nogil=True, error_model="numpy")
def project_numba(points, lens):
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def zbuffer_numba(points, lens):
    """(index [H * W] or -1, depth [H * W] or 0) of the front-most points."""
    width, height = lens[17], lens[18]
    pixels = int(width) * int(height)
    index = np.full(pixels, -1, np.int64)
    depth = np.full(pixels, np.inf)
    for i in range(len(points)):
        px, py, pz = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        u, v, z = _project(px, py, pz, lens)
        # Compared as floats, before the cast: 1e300 does not fit an integer.
        if 0.0 < z < np.inf and 0.0 <= u < width and 0.0 <= v < height:
            pixel = int(v) * int(width) + int(u)
            if z < depth[pixel]:  # strict: the lower index keeps a tie
                depth[pixel] = z
                index[pixel] = i
    for pixel in range(pixels):
        if index[pixel] < 0:
            depth[pixel] = 0.0
    return index.reshape(int(height), int(width)), depth.reshape(int(height), int(width))


def zbuffer_torch(points, lens):
    """`zbuffer_numba` in torch ops, on the points' device; a minimum has no order to depend on."""
    import torch

    width, height = lens[17], lens[18]
    pixels = int(width) * int(height)
    u, v, z = project_columns(*points.double().unbind(1), lens)
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
