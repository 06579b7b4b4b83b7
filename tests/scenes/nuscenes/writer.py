"""A tiny nuScenes folder in the format of the release: 13 tables, JPEGs and sweeps.

The car drives north (world y) at 10 m/s from (400, 1180, 0). Half a second lies between keyframes,
with two sweeps in each gap, of which every camera took an image of the first one alone.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

FOLDER = "v1.0-mini"
HEIGHT, WIDTH = 90, 160  # a tenth of the released images
START = 1_500_000_000_000_000  # microseconds
KEYFRAMES = 3
SWEEPS = (0, 200_000, 300_000, 500_000, 700_000, 800_000, 1_000_000)
"""Microseconds of the LiDAR's sweeps."""

IMAGED = (0, 200_000, 500_000, 700_000, 1_000_000)
"""Microseconds of the sweeps of which there are images."""

CAMERAS = {  # yaw to the left in degrees, microseconds before the sweep, colour
    "CAM_FRONT": (0, 35_000, (200, 40, 40)),
    "CAM_FRONT_LEFT": (55, 43_000, (40, 200, 40)),
    "CAM_FRONT_RIGHT": (-55, 27_000, (40, 40, 200)),
    "CAM_BACK": (180, 10_000, (120, 120, 120)),
    "CAM_BACK_LEFT": (110, 1_000, (200, 200, 40)),
    "CAM_BACK_RIGHT": (-110, 20_000, (40, 200, 200)),
}
CATEGORIES = ("vehicle.car", "human.pedestrian.adult", "vehicle.bicycle", "movable_object.barrier")
ATTRIBUTES = ("vehicle.moving", "vehicle.parked", "pedestrian.standing", "cycle.with_rider")
POINTS = np.array(  # right, forward, up, intensity, ring
    [
        (2, 10, -1, 7, 31),
        (-3, 20, 0, 8, 0),
        (0, 10, -1, 9, 12),
        (0.5, 1.5, -0.8, 9, 3),  # on the bonnet
    ],
    "<f4",
)
BOXES = (  # instance, category, attribute, place in the first keyframe, metres a keyframe, yaw
    ("parked", "vehicle.car", "vehicle.parked", (404.0, 1195.0, 0.8), 0.0, 90.0),
    ("driving", "vehicle.car", "vehicle.moving", (396.0, 1200.0, 0.9), 4.0, 90.0),
    ("standing", "human.pedestrian.adult", "pedestrian.standing", (407.0, 1190.0, 1.0), 0.4, 0.0),
    ("rider", "vehicle.bicycle", "cycle.with_rider", (398.0, 1192.0, 1.0), 2.0, 90.0),
    ("waiting", "vehicle.bicycle", "cycle.with_rider", (399.0, 1193.0, 1.0), 0.1, 45.0),
    ("barrier", "movable_object.barrier", None, (410.0, 1190.0, 0.5), 0.0, -30.0),
)
SIZE = (1.9, 4.6, 1.7)  # width, length, height


def turn(degrees: float) -> list[float]:
    """The quaternion w, x, y, z of a turn to the left about z."""
    half = np.radians(degrees) / 2
    return [float(np.cos(half)), 0.0, 0.0, float(np.sin(half))]


def facing(yaw: float) -> list[float]:
    """The quaternion of a level camera; for 0, its axis is the car's x, right is -y, down -z."""
    half = np.radians(yaw) / 2
    cos, sin = np.cos(half) / 2, np.sin(half) / 2
    # (cos, 0, 0, sin) about z, then (1, -1, 1, -1) / 2, by hand.
    return [float(value) for value in (cos + sin, -cos - sin, cos - sin, -cos + sin)]


def write_tables(folder: Path, tables: dict[str, list[dict[str, Any]]]) -> None:
    """Write tables as the release does: a list, every field on a line of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, records in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(records, indent=0), encoding="utf-8")


def make_tables() -> dict[str, list[dict[str, Any]]]:
    """The 13 tables of two scenes; the other one has no records but its samples."""
    samples = [
        {
            "token": f"sample-{number}",
            "timestamp": START + 500_000 * number,
            "prev": f"sample-{number - 1}" if number else "",
            "next": f"sample-{number + 1}" if number + 1 < KEYFRAMES else "",
            "scene_token": "here",
        }
        for number in range(KEYFRAMES)
    ]
    other = {
        "token": "elsewhere",
        "timestamp": START,
        "prev": "",
        "next": "",
        "scene_token": "there",
    }
    data, poses = _sensor_data()
    return {
        "scene": [
            _scene("there", "scene-0001", "elsewhere", "elsewhere", 1),
            _scene("here", "scene-0061", "sample-0", f"sample-{KEYFRAMES - 1}", KEYFRAMES),
        ],
        "sample": [other, *samples],
        "sample_data": data,
        "ego_pose": poses,
        "calibrated_sensor": _calibrated(),
        "sensor": [
            {"token": f"sensor-{channel}", "channel": channel, "modality": "any"}
            for channel in (*CAMERAS, "LIDAR_TOP", "RADAR_FRONT")
        ],
        "sample_annotation": [
            _annotation(number, *box) for number in range(KEYFRAMES) for box in BOXES
        ],
        "instance": [
            {"token": name, "category_token": f"category-{category}"}
            for name, category, *_ in BOXES
        ],
        "category": [{"token": f"category-{name}", "name": name} for name in CATEGORIES],
        "attribute": [{"token": f"attribute-{name}", "name": name} for name in ATTRIBUTES],
        "visibility": [],
        "log": [],
        "map": [],
    }


def _scene(token: str, name: str, first: str, last: str, samples: int) -> dict[str, Any]:
    return {
        "token": token,
        "name": name,
        "first_sample_token": first,
        "last_sample_token": last,
        "nbr_samples": samples,
    }


def _calibrated() -> list[dict[str, Any]]:
    cameras = [
        {
            "token": f"calibrated-{channel}",
            "sensor_token": f"sensor-{channel}",
            "translation": [1.5, 0.0 if yaw in (0, 180) else float(np.sign(yaw)) / 2, 1.5],
            "rotation": facing(yaw),
            "camera_intrinsic": [[100.0, 0.0, 79.5], [0.0, 100.0, 44.5], [0.0, 0.0, 1.0]],
        }
        for channel, (yaw, *_) in CAMERAS.items()
    ]
    others = [
        {
            "token": f"calibrated-{channel}",
            "sensor_token": f"sensor-{channel}",
            "translation": [1.0, 0.0, 2.0],
            "rotation": turn(-90),
            "camera_intrinsic": [],
        }
        for channel in ("LIDAR_TOP", "RADAR_FRONT")
    ]
    return cameras + others


def _sensor_data() -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Records of `sample_data` and their poses of the car."""
    data, poses = [], []
    for micros in SWEEPS:
        sensors = [("LIDAR_TOP", 0, "pcd.bin"), ("RADAR_FRONT", 5_000, "pcd")]
        if micros in IMAGED:
            sensors += [(channel, early, "jpg") for channel, (_, early, _) in CAMERAS.items()]
        for channel, early, kind in sensors:
            time, token = micros - early, f"{channel}-{micros // 1000}"
            keyframe = micros % 500_000 == 0
            sample = -(-micros // 500_000)  # the one that follows
            data.append(
                {
                    "token": token,
                    "sample_token": f"sample-{sample}",
                    "ego_pose_token": f"pose-{token}",
                    "calibrated_sensor_token": f"calibrated-{channel}",
                    "timestamp": START + time,
                    "fileformat": kind.split(".", maxsplit=1)[0],
                    "is_key_frame": keyframe,
                    "height": HEIGHT if kind == "jpg" else 0,
                    "width": WIDTH if kind == "jpg" else 0,
                    "filename": f"{'samples' if keyframe else 'sweeps'}/{channel}/{token}.{kind}",
                }
            )
            poses.append(
                {
                    "token": f"pose-{token}",
                    "timestamp": START + time,
                    "rotation": turn(90),
                    "translation": [400.0, 1180.0 + time / 1e5, 0.0],
                }
            )
    return data, poses


def _annotation(
    number: int,
    name: str,
    category: str,
    attribute: str | None,
    place: tuple[float, float, float],
    step: float,
    yaw: float,
) -> dict[str, Any]:
    x, y, z = place
    return {
        "token": f"box-{name}-{number}",
        "sample_token": f"sample-{number}",
        "instance_token": name,
        "attribute_tokens": [] if attribute is None else [f"attribute-{attribute}"],
        "translation": [x, y + step * number, z],
        "size": list(SIZE),
        "rotation": turn(yaw),
        "num_lidar_pts": 1,
    }


def write_folder(folder: Path) -> Path:
    """Write the whole tiny release into `folder`."""
    tables = make_tables()
    write_tables(folder / FOLDER, tables)
    for record in tables["sample_data"]:
        path = folder / record["filename"]
        path.parent.mkdir(parents=True, exist_ok=True)
        channel = path.parent.name
        if channel in CAMERAS:
            colour = CAMERAS[channel][2]
            Image.new("RGB", (WIDTH, HEIGHT), colour).save(path, quality=95)
        elif channel == "LIDAR_TOP":
            path.write_bytes(POINTS.tobytes())
    return folder
