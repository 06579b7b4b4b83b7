"""A made-up drive in the conventions of many data sets, for the source that `new-source` writes.

It stands in for files: every function gives what a file of a recording may hold.
"""

from typing import Any

import numpy as np

HEIGHT, WIDTH, FOCAL = 240, 360, 300.0
FRAMES = 12
INTERVAL = 0.2  # seconds
CAMERAS = {"front": 0.0, "front_left": 50.0, "front_right": -50.0}  # degrees to the left
CAMERA_PLACE = {
    "front": (1.6, 0, 1.7),
    "front_left": (1.4, 0.4, 1.7),
    "front_right": (1.4, -0.4, 1.7),
}
LIDAR_PLACE = (1.2, 0.0, 1.9)
PLACE = np.array([500_000.0, 4_649_776.0, 220.0])  # where the world's coordinates begin: UTM
THINGS, MOVING = 60, 6
BEAMS, AZIMUTHS = 48, 1800
EGO_SPEED, EGO_TURN = 8.0, 0.15  # metres and radians a second


def turn(angle: float) -> np.ndarray:
    """(3, 3) rotation about z by radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def rigid(rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(4, 4) of a rotation and a translation in metres."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


def _make_objects() -> np.ndarray:
    """(N, 8) x, y, z, length, width, height, heading (radians) and speed (m/s) at the start."""
    rng = np.random.default_rng(7)
    rows = []
    for number in range(THINGS):
        side = (-1) ** number
        place = (rng.uniform(-25, 70), side * rng.uniform(5, 30))
        if number < MOVING:  # traffic beside the ego car's lane
            place = (10 + 7 * number, -side * 3.5)
        size = rng.uniform([3.6, 1.5, 1.3], [5.2, 2.1, 2.6])
        heading = rng.uniform(-3, 3) if number >= MOVING else (0.4, 3.4)[side > 0]
        speed = rng.uniform(6, 11) if number < MOVING else 0.0
        rows.append((*place, size[2] / 2, *size, heading, speed))
    return np.array(rows)


OBJECTS = _make_objects()
COLOURS = np.random.default_rng(3).uniform(20, 235, (len(OBJECTS), 3, 3))  # of faces across x, y, z


def pose(frame: int) -> np.ndarray:
    """(4, 4) world from vehicle: x forward, y left, z up, on an arc that begins at PLACE."""
    heading = EGO_TURN * INTERVAL * frame
    x, y = EGO_SPEED / EGO_TURN * np.array([np.sin(heading), 1 - np.cos(heading)])
    return rigid(turn(heading), PLACE + np.array([x, y, 0]))


def _objects(frame: int) -> np.ndarray:
    now = OBJECTS.copy()
    way = now[:, 7] * INTERVAL * frame
    now[:, 0] += way * np.cos(now[:, 6])
    now[:, 1] += way * np.sin(now[:, 6])
    return now


def _cast(frame: int, sensor: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) in ray lengths, inf for the sky, and colours (N, 3), of a sensor's rays."""
    sensor = pose(frame) @ sensor
    start, rays = sensor[:3, 3] - PLACE, rays @ sensor[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(rays[:, 2] < 0, -start[2] / rays[:, 2], np.inf)
    colour = np.where(np.isfinite(distance)[:, None], (90.0, 90, 95), (190.0, 210, 235))
    lengths = np.square(rays).sum(axis=1)
    for thing, faces in zip(_objects(frame), COLOURS, strict=True):
        # Most rays pass a thing by: those that miss the ball around it.
        to, ball = thing[:3] - start, np.square(thing[3:6]).sum() / 4
        along = rays @ to
        near_by = np.flatnonzero((along > 0) & ((to @ to - ball) * lengths < along**2))
        axes, half = turn(thing[6]), thing[3:6] / 2
        local, ray = -to @ axes, rays[near_by] @ axes
        with np.errstate(divide="ignore", invalid="ignore"):
            near, far = np.sort([(-half - local) / ray, (half - local) / ray], axis=0)
        enter = near.max(axis=1)
        seen = (enter > 0) & (enter < far.min(axis=1)) & (enter < distance[near_by])
        hit = near_by[seen]
        distance[hit], colour[hit] = enter[seen], faces[near[seen].argmax(axis=1)]
    return distance, colour


def image(frame: int, name: str) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) uint8, what a camera sees."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].reshape(2, -1)  # centres of pixels are integers
    centre = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    rays = np.stack([np.full(rows.size, FOCAL), centre[0] - columns, centre[1] - rows], axis=1)
    colour = _cast(frame, mount(name), rays)[1]
    return np.rint(colour).astype(np.uint8).reshape(HEIGHT, WIDTH, 3)


def mount(name: str) -> np.ndarray:
    """(4, 4) vehicle from camera; a camera's axes are x forward, y left and z up."""
    return rigid(turn(np.radians(CAMERAS[name])), np.array(CAMERA_PLACE[name]))


def lidar_mount() -> np.ndarray:
    """(4, 4) vehicle from LiDAR."""
    return rigid(np.eye(3), np.array(LIDAR_PLACE))


def sweep(frame: int) -> np.ndarray:
    """(N, 3) metres from the LiDAR; nothing says which beam measured a point."""
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(6, -20, BEAMS)), np.arange(AZIMUTHS) * 2 * np.pi / AZIMUTHS
    )
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    rays = rays.reshape(-1, 3)
    distance = _cast(frame, lidar_mount(), rays)[0]
    seen = distance < 70
    return distance[seen, None] * rays[seen]


def boxes(frame: int) -> list[dict[str, Any]]:
    """Boxes in the vehicle's frame, heading in radians about its z."""
    vehicle = np.linalg.inv(pose(frame))
    heading = EGO_TURN * INTERVAL * frame
    return [
        {
            "id": f"object-{number}",
            "centre": vehicle[:3, :3] @ (PLACE + thing[:3]) + vehicle[:3, 3],
            "length": thing[3],
            "width": thing[4],
            "height": thing[5],
            "heading": thing[6] - heading,
            "speed": thing[7],
        }
        for number, thing in enumerate(_objects(frame))
    ]
