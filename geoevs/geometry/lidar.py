"""Dense depth of a source view from its LiDAR points and its image (no learning)."""

import cv2
import numba
import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from geoevs.projection import project_points, zbuffer
from geoevs.scenes.camera import Camera

# Distances in the image are tangents (pixels over focal length), so that nothing here depends on
# the resolution. Values were chosen on procedural streets, and benchmarks/README.md has the gains.

# A triangle whose corners' depths differ by more than this ratio spans an occlusion edge, and one
# with a longer side than this spans a gap between the points: neither is a surface.
EDGE_RATIO = 1.2
LONGEST_SIDE = 0.1
# Farther than this beside or below all points, LiDAR says nothing about a view.
REACH = 0.1
# How far in the image a point may lie to weigh as much as black against white in one channel.
COLOUR_REACH = 0.25
# Pixels: the colour of a point's neighbourhood, not of the texture it happened to hit.
BLUR = 1.0
# Of this many nearest points, those up to this much farther than the nearest count as tied.
NEIGHBOURS = 4
TIE = 1.1


def complete_depth(
    points: np.ndarray,  # [N, 3]
    camera: Camera,
    image: np.ndarray,  # [H, W, 3] float in [0, 1]
) -> np.ndarray:
    """Fill a view's sparse LiDAR depth to every pixel.

    Inverse depth is interpolated linearly (exact on planes) over the Delaunay triangles of the
    points that pass the footprint test. Pixels at occlusion edges, above the highest beam, or
    elsewhere without a triangle take the depth of the point that is nearest in image and colour
    together, so that outlines follow the image. Where the LiDAR does not reach (`lidar_reach`)
    there is no depth.

    Args:
        points: LiDAR points in the world, metres.
        camera: the view.
        image: what it recorded.

    Returns:
        (H, W) float32 depth in metres, 0 = none; all 0 where fewer than three points are visible.
    """
    shape = camera.height, camera.width
    index = zbuffer(points, camera, visibility="footprint").index
    hits = index >= 0
    if np.count_nonzero(hits) < 3:
        return np.zeros(shape, np.float32)
    points = points[index[hits]]
    uv, depth = project_points(points, camera)
    inverse = 1.0 / depth
    focal = camera.K[[0, 1], [0, 1]]
    grid = np.mgrid[: shape[0], : shape[1]][::-1].reshape(2, -1).T + 0.5
    surface, smooth = _interpolate(uv / focal, inverse, grid / focal)
    filled = np.empty(len(grid))
    filled[surface] = smooth

    colours = cv2.GaussianBlur(image, (0, 0), BLUR) * COLOUR_REACH
    candidates = np.hstack([uv / focal, colours[hits]])
    queries = np.hstack([grid / focal, colours.reshape(-1, 3)])
    # What shows above the horizon stands higher than the camera.
    rises = _upward(grid, camera) > 0
    high = points[:, 2] > camera.centre[2]
    for pixels, usable in ((~surface & ~rises, slice(None)), (~surface & rises, high)):
        if not high.any():
            usable = slice(None)
        filled[pixels] = _farthest_of_nearest(candidates[usable], inverse[usable], queries[pixels])
    depth = (1.0 / filled).reshape(shape).astype(np.float32)
    return np.where(lidar_reach(hits, camera) > 0, depth, np.float32(0))


def lidar_reach(
    hits: np.ndarray,  # [H, W] bool: pixels that hold a LiDAR point
    camera: Camera,
) -> np.ndarray:
    """Weights of LiDAR against a network's depth, by pixel: it decides near its points alone.

    A LiDAR that looks ahead meets the rim of a side camera's view, and none sees what stands
    closer than its range or below its lowest beam; what it saw there must not spread over the
    rest. Above its highest beam stands what the beam hit, or the sky.

    Returns:
        (H, W) float32: 1 at points and above them, from there falling to 0 at REACH beside or
        below.
    """
    covered = np.logical_or.accumulate(hits[::-1], axis=0)[::-1].astype(np.float32)
    across, down = (2 * round(REACH * camera.K[axis, axis] / 2) + 1 for axis in (0, 1))
    covered = cv2.dilate(covered, np.ones((down, across), np.uint8))
    return cv2.blur(covered, (across, down), borderType=cv2.BORDER_REPLICATE)


def _upward(
    uv: np.ndarray,  # [N, 2] pixels
    camera: Camera,
) -> np.ndarray:
    """(N,) vertical part of the rays through pixel positions, in the world."""
    rays = np.linalg.solve(camera.K, np.column_stack([uv, np.ones(len(uv))]).T)
    return camera.world_from_camera[2, :3] @ rays


def _farthest_of_nearest(
    candidates: np.ndarray,  # [N, D]
    inverse: np.ndarray,  # [N] inverse depths
    queries: np.ndarray,  # [M, D]
) -> np.ndarray:
    """(M,) inverse depths of the nearest candidates; of those as good as tied, the farthest away.

    A background wrongly brought forward hides things; a foreground wrongly sent back does not.
    """
    distance, index = nearest(candidates, queries, NEIGHBOURS)
    tied = distance <= TIE * distance[:, :1]
    return np.where(tied, inverse[index], np.inf).min(axis=1)


def nearest(
    candidates: np.ndarray,  # [N, D]
    queries: np.ndarray,  # [M, D]
    count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices, each (M, K), of the K = min(count, N) nearest candidates in order."""
    ranks = np.arange(1, min(count, len(candidates)) + 1)
    # What the job may have; numba.get_num_threads() would set PyTorch's threads too, which share
    # its OpenMP.
    threads = numba.config.NUMBA_NUM_THREADS
    return cKDTree(candidates).query(queries, k=ranks, workers=threads)


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
