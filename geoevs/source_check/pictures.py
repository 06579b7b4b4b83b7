"""Pictures of a frame with its LiDAR points and boxes drawn over its images."""

import cv2
import numpy as np

from geoevs.projection import project_points, zbuffer
from geoevs.scenes.boxes import EDGES, Box
from geoevs.scenes.camera import Camera

NEAREST, FARTHEST = 2.0, 80.0
"""Metres of depth that have the colours at the two ends of the scale."""

CLOSEST = 0.3
"""Metres before the camera at which boxes are cut."""

BOX, FRONT = (255, 255, 255), (255, 60, 60)
"""Colours of a box's sides and of its front face."""


def overlay(
    image: np.ndarray,  # [H, W, 3] uint8
    camera: Camera,
    xyz: np.ndarray,  # [N, 3]
    boxes: list[Box],
) -> np.ndarray:
    """(H, W, 3) uint8: an image, points coloured from near (red) to far (blue), and boxes."""
    drawn = np.ascontiguousarray(image) // 2 + 40
    depth = zbuffer(xyz, camera).depth
    share = np.log(np.maximum(depth, NEAREST) / NEAREST) / np.log(FARTHEST / NEAREST)
    scale = np.rint(255 * (1 - np.minimum(share, 1))).astype(np.uint8)
    colours = cv2.cvtColor(cv2.applyColorMap(scale, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
    drawn[depth > 0] = colours[depth > 0]
    for box in boxes:
        _draw(drawn, camera, box)
    return drawn


def _draw(image: np.ndarray, camera: Camera, box: Box) -> None:
    local = box.corners @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    for edge in EDGES:
        ends = _before(*local[edge])
        if ends is None:
            continue
        uv, _ = project_points(ends @ camera.world_from_camera[:3, :3].T + camera.centre, camera)
        # OpenCV counts a pixel's centre as a whole number, and takes no huge ones.
        if np.abs(uv).max() < 1e5:
            start, end = (tuple(map(int, np.rint(16 * (p - 0.5)))) for p in uv)
            colour = FRONT if (edge < 4).all() else BOX
            cv2.line(image, start, end, colour, 1, cv2.LINE_AA, shift=4)


def _before(one: np.ndarray, other: np.ndarray) -> np.ndarray | None:
    """(2, 3) the part of a line in the camera's frame that lies before the camera; None if none."""
    if max(one[2], other[2]) <= CLOSEST:
        return None
    if one[2] > other[2]:
        one, other = other, one
    if one[2] < CLOSEST:
        one = one + (other - one) * (CLOSEST - one[2]) / (other[2] - one[2])
    return np.stack([one, other])
