"""Lifting a frame's source views to one coloured cloud (the paper's F(M, I), section 3.2)."""

from collections.abc import Mapping

import cv2
import numpy as np

from geoevs.geometry.lidar import complete_depth
from geoevs.methods.contract import Views
from geoevs.projection import unproject_depth
from geoevs.scenes.camera import Camera

LIFT_SCALE = 2
"""Multiple of the target's resolution at which views are lifted: one point a pixel leaves cracks
that are no disocclusions."""


def lift_depth(
    depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
    target: Camera,
) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """One view's pixels as world points, LIFT_SCALE points a target's pixel each way.

    Args:
        depth: along the view's optical axis.
        camera: its calibration.
        target: where the points will be projected; only its focal lengths count. Rigs mix
            lenses: PandaSet's side cameras have half the focal length of its front camera.

    Returns:
        xyz (N, 3) float32 in metres, none for pixels without depth; the flat pixels (N,) that they
        come from in the view resized to a finer (height, width), which is the third.
    """
    across, down = (
        max(1, round(LIFT_SCALE * target.K[axis, axis] / camera.K[axis, axis])) for axis in (0, 1)
    )
    fine = camera.resized(camera.height * down, camera.width * across)
    # Depth must not blend across edges.
    size = fine.width, fine.height
    fine_depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    xyz, pixels = unproject_depth(fine_depth, fine)
    return xyz.astype(np.float32), pixels, (fine.height, fine.width)


def lift_view(
    image: np.ndarray,  # [H, W, 3] float
    depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
    target: Camera,
) -> tuple[np.ndarray, np.ndarray]:
    """`lift_depth`, which names the arguments, with colours: xyz (N, 3) and rgb (N, 3) float32."""
    xyz, pixels, (height, width) = lift_depth(depth, camera, target)
    # Colours at the target's own resolution must not alias.
    fine_image = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    return xyz, fine_image.reshape(-1, 3)[pixels]


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
        name: views.without_ego(
            name, complete_depth(points, views.camera(name, frame), views.image(name, frame))
        )
        for name in views.cameras
    }
