"""A made-up segment: boxes on the plane z = 0, seen by five cameras and five LiDARs that drive by.

It holds what the data set does, in plain numbers, for a writer of either version. Range images are
cast ray by ray, each pixel with its own pose, so that the points read back must lie on a surface.
"""

import io
from dataclasses import dataclass, field, replace

import numpy as np
from PIL import Image

NAME = "1000_000_000_020_000"
PLACE = np.array([-25211.25, 42391.5, -160.75])  # of the plane's origin, in the data's world
START = 1_553_735_853.0
SPEED, TURN = 12.0, 0.2  # m/s along the vehicle's x, rad/s to the left
CAMERAS = ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")
HEIGHT, SIDE_HEIGHT, WIDTH = 128, 88, 192
TYPES = {"car": 1, "bus": 1, "walker": 2, "board": 3, "bike": 4}
BOXES = {  # x, y, z, length, width, height, heading on the plane, at the first frame
    "car": (14.0, 4.0, 0.8, 4.5, 1.9, 1.6, 0.3),
    "bus": (30.0, -7.0, 1.6, 11.0, 2.6, 3.2, -0.1),
    "walker": (9.0, -3.0, 0.9, 0.7, 0.6, 1.8, 2.0),
    "board": (6.0, 6.0, 2.0, 0.1, 0.8, 0.6, 1.2),
    "bike": (-8.0, 3.0, 0.9, 1.8, 0.7, 1.8, 0.0),
}
ZONE = [[30, 30], [50, 30], [50, 60]]  # on the plane
SPEEDS = {"walker": (0.6, -0.9), "car": (0.3, 0.2)}  # the car's is below what counts as moving


def turned(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """(3, 3) Rz(yaw) Ry(pitch) Rx(roll), multiplied out by numpy."""
    c, s = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    z = np.array([[c[0], -s[0], 0], [s[0], c[0], 0], [0, 0, 1]])
    y = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    x = np.array([[1, 0, 0], [0, c[2], -s[2]], [0, s[2], c[2]]])
    return z @ y @ x


def rigid(rotation: np.ndarray, place) -> np.ndarray:
    """(4, 4) of a rotation and a translation."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


def vehicle_state(seconds: float) -> tuple[float, np.ndarray]:
    """Yaw and place of the vehicle some seconds after START: an arc, slightly pitched."""
    yaw = TURN * seconds
    radius = SPEED / TURN
    return yaw, PLACE + np.array([radius * np.sin(yaw), radius * (1 - np.cos(yaw)), 0.0])


def vehicle_pose(seconds: float) -> np.ndarray:
    """(4, 4) world from vehicle."""
    yaw, place = vehicle_state(seconds)
    return rigid(turned(yaw, pitch=0.01, roll=-0.005), place)


@dataclass
class Segment:
    """What either version holds; frames are dictionaries, and tests spoil them."""

    name: str = NAME
    cameras: dict[int, dict] = field(default_factory=dict)
    lasers: dict[int, dict] = field(default_factory=dict)
    frames: list[dict] = field(default_factory=list)
    map_features: list[tuple[int, int, np.ndarray]] = field(default_factory=list)

    def copy(self) -> "Segment":
        """A copy that can be spoiled: the frames' own dictionaries are new, two levels down."""
        frames = [
            {
                key: {k: dict(v) for k, v in value.items()} if isinstance(value, dict) else value
                for key, value in frame.items()
            }
            for frame in self.frames
        ]
        return replace(
            self,
            cameras={k: dict(v) for k, v in self.cameras.items()},
            lasers={k: dict(v) for k, v in self.lasers.items()},
            frames=frames,
        )


def camera_calibrations() -> dict[int, dict]:
    """By number; lenses distort as the real ones do, a tenth of their size."""
    yaws = (0.0, 0.8, -0.8, 1.6, -1.6)
    return {
        number: {
            "intrinsic": [
                *(205.0 + number, 206.0, 95.0, height * 0.49),
                *(0.04, -0.33, 0.001, -0.0015, 0.01),
            ],
            "extrinsic": rigid(turned(yaw, pitch=0.02), [1.5, 0.1 * number, 2.1]),
            "width": WIDTH,
            "height": height,
            "readout": 2,
        }
        for number, yaw, height in zip(
            range(1, 6), yaws, (HEIGHT,) * 3 + (SIDE_HEIGHT,) * 2, strict=True
        )
    }


def laser_calibrations() -> dict[int, dict]:
    """By number; the top one lists its beams, bottom up, and the others have even ones."""
    top = np.linspace(-0.31, 0.045, 64) + 0.002 * np.sin(np.arange(64))
    lasers = {
        1: {
            "inclinations": sorted(top.tolist()),
            "low": -0.31,
            "high": 0.045,
            "extrinsic": rigid(turned(2.6, 0.01, -0.02), [1.4, 0.0, 2.2]),
        }
    }
    for number, (x, y, yaw) in enumerate(
        [(4.0, 0.0, 0.0), (3.2, 1.0, 1.6), (3.2, -1.0, -1.5), (-1.1, 0.0, 3.1)], start=2
    ):
        lasers[number] = {
            "inclinations": [],
            "low": -np.pi / 2,
            "high": np.pi / 6,
            "extrinsic": rigid(turned(yaw), [x, y, 0.7]),
        }
    return lasers


def box_at(track: str, frame: int) -> np.ndarray:
    """(7,) the box on the plane in a frame; those with a speed move."""
    box = np.array(BOXES[track])
    box[:2] += 0.1 * frame * np.array(SPEEDS.get(track, (0, 0)))
    return box


def cast(origins: np.ndarray, directions: np.ndarray, frame: int, reach: float) -> np.ndarray:
    """(N,) metres along each ray to the plane or a box, whichever is nearer; -1 beyond reach."""
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = -origins[:, 2] / directions[:, 2]
        metres[~(metres > 0)] = np.inf
        for track in BOXES:
            box = box_at(track, frame)
            axes = turned(box[6])
            start, way = (origins - box[:3]) @ axes, directions @ axes
            ends = np.stack([(-box[3:6] / 2 - start) / way, (box[3:6] / 2 - start) / way])
            enter, leave = ends.min(0).max(1), ends.max(0).min(1)
            hit = (enter <= leave) & (enter > 0)
            metres = np.where(hit & (enter < metres), enter, metres)
    return np.where(metres < reach, metres, -1.0)


def sweep(number: int, laser: dict, frame: int) -> dict:
    """The range images of one LiDAR; of the top one, the pose of each pixel."""
    height, width = (64, 530) if number == 1 else (60, 120)
    middle = 0.1 * frame + 0.05
    listed = np.array(laser["inclinations"])
    even = laser["low"] + (np.arange(height) + 0.5) / height * (laser["high"] - laser["low"])
    inclination = (listed if len(listed) else even)[::-1]
    extrinsic = laser["extrinsic"]
    azimuth = np.pi - 2 * np.pi * (np.arange(width) + 0.5) / width
    azimuth -= np.arctan2(extrinsic[1, 0], extrinsic[0, 0])
    image = np.full((height, width, 4), -1, np.float32)
    second = image.copy()
    poses = np.zeros((height, width, 6), np.float32)
    for column in range(width):
        rays = np.stack(
            [
                np.cos(azimuth[column]) * np.cos(inclination),
                np.sin(azimuth[column]) * np.cos(inclination),
                np.sin(inclination),
            ]
        )
        pose = vehicle_pose(middle)
        if number == 1:
            yaw, place = vehicle_state(middle + 0.1 * (column / width - 0.5))
            poses[:, column] = [-0.005, 0.01, yaw, *place]
            roll, pitch, yaw, *place = poses[0, column].astype(float)
            pose = rigid(turned(yaw, pitch, roll), place)
        turn = pose @ extrinsic
        origin = np.tile(turn[:3, 3] - PLACE, (height, 1))
        way = (turn[:3, :3] @ rays).T
        image[:, column, 0] = cast(origin, way, frame, 75.0 if number == 1 else 20.0)
    image[image[..., 0] > 0, 1:] = [0.5, 0.1, -1]
    some = (image[..., 0] > 0) & (np.arange(width) % 7 == 0)
    second[some] = image[some] + [0.25, 0, 0, 0]
    return {"first": image, "second": second, "poses": poses if number == 1 else None}


def picture(height: int, number: int) -> np.ndarray:
    """(H, W, 3) uint8 whose red and green tell the place, smoothly, and whose blue the camera."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(height) + 0.5)
    parts = (40 + x / WIDTH * 160, 40 + y / height * 160, np.full_like(x, 40 * number))
    return np.rint(np.stack(parts, axis=-1)).astype(np.uint8)


def image(number: int, camera: dict, frame: int) -> dict:
    """A picture and when it was taken; a camera's pose stands 20 ms after its middle."""
    buffer = io.BytesIO()
    Image.fromarray(picture(camera["height"], number)).save(buffer, "jpeg", quality=98)
    trigger = 0.1 * frame + 0.01 * number
    seconds = trigger + 0.043
    yaw, _ = vehicle_state(seconds)
    return {
        "jpeg": buffer.getvalue(),
        "pose": vehicle_pose(seconds),
        "linear": [SPEED * np.cos(yaw), SPEED * np.sin(yaw), 0.0],
        "angular": (turned(yaw, 0.01, -0.005).T @ [0, 0, TURN]).tolist(),
        "pose_time": START + seconds,
        "shutter": 0.002,
        "trigger": START + trigger,
        "done": START + trigger + 0.046,
    }


def label(track: str, frame: int) -> dict:
    """A box in the vehicle's axes; the walker's also at the instant of a camera."""
    pose = vehicle_pose(0.1 * frame + 0.05)
    box = box_at(track, frame)
    ahead = pose[:3, :3].T @ [np.cos(box[6]), np.sin(box[6]), 0]
    place = pose[:3, :3].T @ (box[:3] + PLACE - pose[:3, 3])
    inside = [*place, *box[3:6], np.arctan2(ahead[1], ahead[0])]
    synced = [place[0] + 0.01, *inside[1:]] if track == "walker" else None
    return {
        "track": track,
        "type": TYPES[track],
        "box": [float(value) for value in inside],
        "speed": SPEEDS.get(track, (0.0, 0.0)),
        "camera": 3 if synced else 0,
        "synced": synced,
    }


def make_segment(frames: int = 2) -> Segment:
    """The segment, its frames in the order of time."""
    segment = Segment(cameras=camera_calibrations(), lasers=laser_calibrations())
    for frame in range(frames):
        segment.frames.append(
            {
                "time": round((START + 0.1 * frame) * 1e6),
                "pose": vehicle_pose(0.1 * frame + 0.05),
                "images": {n: image(n, c, frame) for n, c in segment.cameras.items()},
                "sweeps": {n: sweep(n, laser, frame) for n, laser in segment.lasers.items()},
                "labels": {track: label(track, frame) for track in BOXES},
                "zones": [PLACE[:2] + np.array(ZONE)] if frame == 0 else [],
                "offset": [0.5, -0.25, 0.125],
            }
        )
    line = np.array([[0.0, 0, 0], [10, 0, 0], [20, 1, 0]])
    segment.map_features = [
        (number, points, line[: 1 if number == 7 else 3] + PLACE + number)
        for number, points in ((3, 8), (4, 2), (5, 2), (7, 2), (8, 1), (9, 1), (10, 1))
    ]
    return segment
