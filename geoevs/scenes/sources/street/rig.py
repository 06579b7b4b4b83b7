"""The vehicle: five cameras and a roof LiDAR like Waymo's, and its motion along the street."""

import numpy as np

from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import Rig
from geoevs.scenes.sources.street.layout import Street

TAN_ACROSS = np.tan(np.radians(25.0))  # 50 degrees wide
TAN_DOWN = TAN_ACROSS * 2 / 3  # 34.5 degrees high: square pixels where images are 2:3
# yaw in degrees, place in metres: x forward, y left, z up from the ground under the vehicle
MOUNTS = {
    "front": (0.0, (1.55, 0.00, 2.10)),
    "front_left": (45.0, (1.45, 0.32, 2.10)),
    "front_right": (-45.0, (1.45, -0.32, 2.10)),
    "side_left": (90.0, (1.15, 0.46, 2.08)),
    "side_right": (-90.0, (1.15, -0.46, 2.08)),
}
LIDAR_MOUNT = (1.25, 0.0, 2.32)
RIG = Rig(front="front", front_left="front_left", front_right="front_right", lidar_split="beam")


class Ego:
    """The vehicle's motion: constant speed along its lane."""

    def __init__(self, street: Street, speed: float) -> None:
        self._street, self.speed = street, speed

    def pose(self, time: float) -> np.ndarray:
        """(4, 4) world from vehicle at `time` seconds."""
        s = self.speed * time
        x, y = self._street.path.at(s, self._street.ego_offset)
        yaw = self._street.path.heading(s)
        cos, sin = np.cos(yaw), np.sin(yaw)
        pose = np.eye(4)
        pose[:3] = [[cos, -sin, 0, x], [sin, cos, 0, y], [0, 0, 1, 0]]
        return pose


def make_cameras(world_from_vehicle: np.ndarray, height: int, width: int) -> dict[str, Camera]:
    """The five cameras at a (4, 4) vehicle pose, level, at any resolution."""
    K = np.array([[width / 2 / TAN_ACROSS, 0, width / 2],
                  [0, height / 2 / TAN_DOWN, height / 2], [0, 0, 1]])  # fmt: skip
    cameras = {}
    for name, (yaw, place) in MOUNTS.items():
        cos, sin = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        mount = np.eye(4)  # columns: image right, image down, forward
        mount[:3] = np.array([[sin, 0, cos, place[0]], [-cos, 0, sin, place[1]],
                              [0, -1, 0, place[2]]])  # fmt: skip
        cameras[name] = Camera(K, world_from_vehicle @ mount, height, width, name)
    return cameras
