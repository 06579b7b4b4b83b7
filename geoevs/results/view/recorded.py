"""What was recorded in a frame, as things to draw: cameras, LiDAR points, boxes, the road map."""

import math
from typing import NamedTuple

import numpy as np

from geoevs.core.images import to_uint8
from geoevs.scenes.boxes import EDGES, Box
from geoevs.scenes.camera import Camera
from geoevs.scenes.store import Scene

MOVES, STANDS, MAP = (255, 60, 60), (255, 255, 255), (120, 160, 255)
"""Colours of what moves, of what stands, and of the road map."""

UNSEEN = 128
"""Grey of points that no camera coloured."""

WIDEST = 4.0
"""Largest ratio of the sides of a picture: a window may be a strip."""


class Lines(NamedTuple):
    """Straight lines in the world and the colours of their ends."""

    ends: np.ndarray  # [N, 2, 3] float32, metres
    rgb: np.ndarray  # [N, 2, 3] uint8


def box_lines(scene: Scene, frame: int) -> Lines:
    """The edges of all boxes of a frame."""
    boxes = Box.rows(scene.tracks[scene.tracks["frame"] == frame])
    ends = [box.corners[EDGES] for box in boxes]
    return _lines(ends, [MOVES if box.moving else STANDS for box in boxes])


def map_lines(scene: Scene) -> Lines:
    """The outlines and holes of the road map's polygons; none where there is no map."""
    polygons = scene.road_map.polygons if scene.road_map else ()
    rings = [ring for polygon in polygons for ring in polygon.rings]
    ends = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings]
    return _lines(ends, [MAP] * len(ends))


def _lines(ends: list[np.ndarray], colours: list[tuple[int, int, int]]) -> Lines:
    rgb = [np.tile(np.uint8(c), (len(part), 2, 1)) for part, c in zip(ends, colours, strict=True)]
    return Lines(
        np.concatenate([np.zeros((0, 2, 3)), *ends]).astype(np.float32),
        np.concatenate([np.zeros((0, 2, 3), np.uint8), *rgb]),
    )


def lidar(scene: Scene, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) float32 positions and (N, 3) uint8 colours of a frame's points."""
    points = scene.points(frame)
    rgb = to_uint8(points.rgb)
    return points.xyz, np.where((points.camera >= 0)[:, None], rgb, np.uint8(UNSEEN))


def vertical_fov(camera: Camera) -> float:
    """The angle in radians that an image's height spans, its principal point taken as its middle.

    >>> from geoevs.methods.tiny import tiny_camera
    >>> round(math.degrees(vertical_fov(tiny_camera("front", 0.0, np.zeros(3)))), 2)
    37.85
    """
    return 2 * math.atan(camera.height / 2 / float(camera.K[1, 1]))


def free_camera(
    wxyz: np.ndarray,  # [4]
    position: np.ndarray,  # [3] metres
    fov: float,
    aspect: float,
    height: int,
) -> Camera:
    """A camera of square pixels at any pose.

    Args:
        wxyz: the rotation from the camera, whose axes are x right, y down, z forward, to the world.
        position: its centre in the world.
        fov: the angle in radians that its height spans.
        aspect: its width over its height; at most WIDEST, and no less than one over that.
        height: pixels.

    Raises:
        GeoEvsError: there is no such camera.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    width = round(height * min(max(aspect, 1 / WIDEST), WIDEST))
    focal = height / 2 / math.tan(fov / 2)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(np.roll(wxyz, -1)).as_matrix()
    pose[:3, 3] = position
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(K, pose, height, width, "free")
