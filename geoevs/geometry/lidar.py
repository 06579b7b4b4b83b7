"""Dense depth of a source view from its LiDAR points and its image (no learning)."""

import cv2
import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from geoevs.projection import project_points, zbuffer
from geoevs.scenes.camera import Camera

# Distances in the image are tangents (pixels over focal length), so that nothing here depends on
# the resolution. The values were chosen on procedural streets; benchmarks/README.md has the curve.

# A triangle whose corners' depths differ by more than this ratio spans an occlusion edge, and one
# with a longer side than this spans a gap between the points: neither is a surface.
EDGE_RATIO = 1.2
LONGEST_SIDE = 0.1
# How far in the image a point may lie to weigh as much as black against white in one channel.
COLOUR_REACH = 0.25
# Pixels: the colour of a point's neighbourhood, not of the texture it happened to hit.
BLUR = 1.0


def complete_depth(
    points: np.ndarray,  # [N, 3]
    camera: Camera,
    image: np.ndarray,  # [H, W, 3] float in [0, 1]
) -> np.ndarray:
    """Fill a view's sparse LiDAR depth to every pixel.

    Inverse depth is interpolated linearly (exact on planes) over the Delaunay triangles of the
    points that pass the footprint test. Pixels at occlusion edges, above the highest beam, or
    elsewhere without a triangle take the depth of the point that is nearest in image and colour
    together, so that outlines follow the image. Far from all points that is only a guess, kept
    because it is still better than a hole.

    Args:
        points: LiDAR points in the world, metres.
        camera: the view.
        image: what it recorded.

    Returns:
        (H, W) float32 depth in metres; all 0 where fewer than three points are visible.
    """
    shape = camera.height, camera.width
    index = zbuffer(points, camera, visibility="footprint").index
    seen = index >= 0
    if np.count_nonzero(seen) < 3:
        return np.zeros(shape, np.float32)
    uv, depth = project_points(points[index[seen]], camera)
    inverse = 1.0 / depth
    focal = camera.K[[0, 1], [0, 1]]
    places = uv / focal
    grid = (np.mgrid[: shape[0], : shape[1]][::-1].reshape(2, -1).T + 0.5) / focal

    surface, smooth = _interpolate(places, inverse, grid)
    filled = np.empty(len(grid))
    filled[surface] = smooth
    colours = cv2.GaussianBlur(image, (0, 0), BLUR) * COLOUR_REACH
    points_5d = np.hstack([places, colours[seen]])
    pixels_5d = np.hstack([grid, colours.reshape(-1, 3)])
    filled[~surface] = inverse[cKDTree(points_5d).query(pixels_5d[~surface])[1]]
    return (1.0 / filled).reshape(shape).astype(np.float32)


def _interpolate(
    places: np.ndarray,  # [N, 2]
    values: np.ndarray,  # [N] inverse depths
    queries: np.ndarray,  # [M, 2]
) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric interpolation where a query's triangle may be a surface.

    Returns:
        (M,) bool, where that is, and the interpolated values there.
    """
    try:
        triangles = Delaunay(places)
    except QhullError:  # all in one line
        return np.zeros(len(queries), bool), np.zeros(0)
    corners = values[triangles.simplices]
    vertices = places[triangles.simplices]
    sides = np.linalg.norm(vertices - np.roll(vertices, 1, axis=1), axis=2)
    solid = corners.max(axis=1) <= EDGE_RATIO * corners.min(axis=1)
    solid &= sides.max(axis=1) <= LONGEST_SIDE
    simplex = triangles.find_simplex(queries)
    surface = (simplex >= 0) & solid[simplex]
    simplex = simplex[surface]
    affine = triangles.transform[simplex]
    first_two = np.einsum("nij,nj->ni", affine[:, :2], queries[surface] - affine[:, 2])
    weights = np.column_stack([first_two, 1.0 - first_two.sum(axis=1)])
    return surface, (weights * corners[simplex]).sum(axis=1)
