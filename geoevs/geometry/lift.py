"""Lifting a frame's source views to one coloured cloud (the paper's F(M, I), section 3.2)."""

from collections.abc import Mapping

import cv2
import numpy as np

from geoevs.projection import unproject_depth
from geoevs.scenes.camera import Camera

LIFT_SCALE = 2
"""Views are lifted at this multiple of their resolution: one point a pixel leaves cracks that are
no disocclusions."""


def lift_view(
    image: np.ndarray,  # [H, W, 3] float
    depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
) -> tuple[np.ndarray, np.ndarray]:
    """One view's pixels as world points with colours, LIFT_SCALE points a pixel in x and in y.

    Returns:
        xyz (N, 3) float32 in metres and rgb (N, 3) float32; pixels without depth give none.
    """
    fine = camera.resized(camera.height * LIFT_SCALE, camera.width * LIFT_SCALE)
    size = (fine.width, fine.height)
    # Depth must not blend across edges; colours at the target's own resolution must not alias.
    fine_depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    fine_image = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
    xyz, pixels = unproject_depth(fine_depth, fine)
    return xyz.astype(np.float32), fine_image.reshape(-1, 3)[pixels]


def lift_frame(
    cameras: Mapping[str, Camera],
    images: Mapping[str, np.ndarray],  # each [H, W, 3] float
    depths: Mapping[str, np.ndarray],  # each [H, W] metres, 0 = none
) -> tuple[np.ndarray, np.ndarray]:
    """All views of one frame as one cloud, in the cameras' order (see `lift_view`)."""
    clouds = [lift_view(images[name], depths[name], camera) for name, camera in cameras.items()]
    return np.concatenate([xyz for xyz, _ in clouds]), np.concatenate([rgb for _, rgb in clouds])
