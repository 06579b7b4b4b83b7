"""Cameras that the car does not carry: poses between its front camera and a side one."""

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera


def virtual_camera(
    front: Camera,
    side: Camera,
    angle: float,
    lateral: float,
    name: str,
    ego: Camera | None = None,
) -> Camera:
    """A camera between the front one and a side one, shifted sideways (paper section 4.3).

    Args:
        front: gives the intrinsics, pitch and roll.
        side: the front-side camera to turn towards.
        angle: yaw in degrees from the front camera towards the side one.
        lateral: metres to the left, horizontal and perpendicular to the ego heading.
        name: the new camera's name.
        ego: the camera that looks along the ego heading; None: the front one. Between two side
            cameras it is another one.

    Returns:
        A camera whose centre lies on the line between the two at the same fraction as its yaw.

    Raises:
        GeoEvsError: the side camera is not turned that far, or not at all.
    """
    gap = yaw_gap(front, side)
    if gap == 0:
        raise GeoEvsError(
            f"cameras '{front.name}' and '{side.name}' look the same way; a rig's front-side "
            "cameras must be turned aside"
        )
    if angle > abs(gap):
        raise GeoEvsError(
            f"target '{name}' turns {angle} degrees but camera '{side.name}' is only "
            f"{abs(gap):.1f} degrees from '{front.name}'; lower protocol.pose_sweep.angles or "
            "protocol.masked.yaw"
        )
    fraction = angle / abs(gap)
    turn = np.radians(fraction * gap)
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    left = left_of(front if ego is None else ego)
    pose = np.eye(4)
    pose[:3, :3] = rotation @ front.world_from_camera[:3, :3]
    pose[:3, 3] = (1 - fraction) * front.centre + fraction * side.centre + lateral * left
    return Camera(front.K, pose, front.height, front.width, name)


def left_of(ego: Camera) -> np.ndarray:
    """(3,) unit vector to the left of a camera's horizontal heading, in the world."""
    heading = ego.optical_axis[:2] / np.linalg.norm(ego.optical_axis[:2])
    return np.array([-heading[1], heading[0], 0.0])


def yaw_gap(front: Camera, side: Camera) -> float:
    """Degrees from the front camera's yaw to the side one's, in [-180, 180), left positive."""
    return (side.yaw - front.yaw + 180.0) % 360.0 - 180.0
