"""Dense depth of a source view from its LiDAR points (classical completion, no learning)."""

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from geoevs.projection import zbuffer
from geoevs.scenes.camera import Camera

# A triangle whose corners differ more than this (as a ratio of depths) spans an occlusion edge:
# its pixels take the nearest corner's depth instead of a slope that no surface has.
EDGE_RATIO = 1.2


def complete_depth(
    points: np.ndarray,  # [N, 3]
    camera: Camera,
) -> np.ndarray:
    """Fill a view's sparse LiDAR depth to every pixel.

    Inverse depth is interpolated linearly (exact on planes) over the Delaunay triangles of the
    points that pass the footprint test; across occlusion edges and outside the points' hull the
    nearest point's depth is taken.

    Args:
        points: LiDAR points in the world, metres.
        camera: the view.

    Returns:
        (H, W) float32 depth in metres; all 0 where fewer than three points are visible.
    """
    sparse = zbuffer(points, camera, visibility="footprint")
    rows, columns = np.nonzero(sparse.index >= 0)
    if len(rows) < 3:
        return np.zeros((camera.height, camera.width), np.float32)
    pixels = np.column_stack([columns, rows]).astype(np.float64)
    inverse = 1.0 / sparse.depth[rows, columns]
    grid = np.mgrid[: camera.height, : camera.width][::-1].reshape(2, -1).T.astype(np.float64)
    filled = inverse[cKDTree(pixels).query(grid)[1]]
    try:
        triangulation = Delaunay(pixels)
    except QhullError:  # all points in one line: the nearest is all there is
        pass
    else:
        inside, smooth = _interpolate(triangulation, inverse, grid)
        filled[inside] = smooth
    return (1.0 / filled).reshape(camera.height, camera.width).astype(np.float32)


def _interpolate(
    triangulation: Delaunay,
    values: np.ndarray,  # [N]
    queries: np.ndarray,  # [M, 2]
) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric interpolation where a query's triangle spans no occlusion edge.

    Returns:
        (M,) bool, where that is, and the interpolated values there.
    """
    corners = values[triangulation.simplices]
    smooth = corners.max(axis=1) <= EDGE_RATIO * corners.min(axis=1)
    simplex = triangulation.find_simplex(queries)
    inside = (simplex >= 0) & smooth[simplex]
    simplex = simplex[inside]
    affine = triangulation.transform[simplex]
    first_two = np.einsum("nij,nj->ni", affine[:, :2], queries[inside] - affine[:, 2])
    weights = np.column_stack([first_two, 1.0 - first_two.sum(axis=1)])
    return inside, (weights * corners[simplex]).sum(axis=1)
