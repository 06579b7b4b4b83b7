"""Lifting a frame's source views to one coloured cloud (the paper's F(M, I), section 3.2)."""

from collections.abc import Mapping

import cv2
import numpy as np

from geoevs.adapter import Views
from geoevs.geometry.lidar import complete_depth
from geoevs.projection import unproject_depth
from geoevs.scenes.camera import Camera

LIFT_SCALE = 2
"""Views are lifted at this multiple of the target's resolution: one point a pixel leaves cracks
that are no disocclusions."""


def lift_view(
    image: np.ndarray,  # [H, W, 3] float
    depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
    target: Camera,
) -> tuple[np.ndarray, np.ndarray]:
    """One view's pixels as world points with colours, LIFT_SCALE points a target's pixel each way.

    Args:
        image: the view's colours.
        depth: along its optical axis.
        camera: its calibration.
        target: where the points will be projected; only its focal lengths count. Rigs mix
            lenses: PandaSet's side cameras have half the focal length of its front camera.

    Returns:
        xyz (N, 3) float32 in metres and rgb (N, 3) float32; pixels without depth give none.
    """
    across, down = (
        max(1, round(LIFT_SCALE * target.K[axis, axis] / camera.K[axis, axis])) for axis in (0, 1)
    )
    fine = camera.resized(camera.height * down, camera.width * across)
    size = (fine.width, fine.height)
    # Depth must not blend across edges; colours at the target's own resolution must not alias.
    fine_depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    fine_image = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
    xyz, pixels = unproject_depth(fine_depth, fine)
    return xyz.astype(np.float32), fine_image.reshape(-1, 3)[pixels]


def lift_frame(
    views: Views,
    frame: int,
    depths: Mapping[str, np.ndarray],  # each [H, W] metres, 0 = none
    target: Camera,
) -> tuple[np.ndarray, np.ndarray]:
    """All source views of one frame as one cloud, in the cameras' order (see `lift_view`)."""
    clouds = [
        lift_view(views.image(name, frame), depths[name], views.camera(name, frame), target)
        for name in views.cameras
    ]
    return np.concatenate([xyz for xyz, _ in clouds]), np.concatenate([rgb for _, rgb in clouds])


def lidar_depths(views: Views, frame: int) -> dict[str, np.ndarray]:
    """(H, W) depth of every source view of a frame, completed from the LiDAR methods may use."""
    points = views.lidar(frame).xyz
    return {
        name: complete_depth(points, views.camera(name, frame), views.image(name, frame))
        for name in views.cameras
    }
