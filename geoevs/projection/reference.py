"""The validity rule in plain numpy: the twin that the fast paths are checked against."""

import numpy as np

from geoevs.projection.kernels import lens_of, project_columns
from geoevs.scenes.camera import Camera


def zbuffer_reference(
    points: np.ndarray,  # [N, 3]
    camera: Camera,
) -> tuple[np.ndarray, np.ndarray]:
    """`geoevs.projection.zbuffer` in plain steps: project, filter, sort, keep each pixel's first.

    Args:
        points: (N, 3) world positions in metres.
        camera: the view.

    Returns:
        index (H, W) int64 of the front-most point or -1, and its depth (H, W) float64 or 0.
    """
    points = np.asarray(points, np.float64)
    with np.errstate(all="ignore"):  # behind the camera, at infinity and NaN: filtered below
        px, py, pz = points.T
        u, v, z = project_columns(px, py, pz, lens_of(camera))
        in_frame = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        order = np.flatnonzero((z > 0) & (z < np.inf) & in_frame)
    pixel = v[order].astype(np.int64) * camera.width + u[order].astype(np.int64)
    by_pixel = np.lexsort((z[order], pixel))  # stable: ties stay in the order of the points
    order, pixel = order[by_pixel], pixel[by_pixel]
    first = np.diff(pixel, prepend=-1) > 0
    index = np.full(camera.height * camera.width, -1)
    depth = np.zeros(camera.height * camera.width)
    index[pixel[first]] = order[first]
    depth[pixel[first]] = z[order[first]]
    shape = camera.height, camera.width
    return index.reshape(shape), depth.reshape(shape)
