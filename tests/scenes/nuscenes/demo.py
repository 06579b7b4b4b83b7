"""The real keyframe that mmdetection3d ships as a demo, made a nuScenes folder.

The demo has images and a sweep as nuScenes released them, but a pickle in place of the tables.
"""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.scenes.nuscenes.writer import FOLDER, write_tables

ADMITTED = {
    ("numpy", "dtype"): np.dtype,
    ("numpy.core.multiarray", "scalar"): lambda dtype, raw: np.frombuffer(raw, dtype)[0],
    ("_codecs", "encode"): lambda text, _: text.encode("latin-1"),
}
CATEGORIES = {
    "car": "vehicle.car",
    "truck": "vehicle.truck",
    "trailer": "vehicle.trailer",
    "bus": "vehicle.bus.rigid",
    "construction_vehicle": "vehicle.construction",
    "bicycle": "vehicle.bicycle",
    "motorcycle": "vehicle.motorcycle",
    "pedestrian": "human.pedestrian.adult",
    "traffic_cone": "movable_object.trafficcone",
    "barrier": "movable_object.barrier",
    "other": "movable_object.debris",  # of the other thirteen; the demo does not say which
}
ATTRIBUTES = ("vehicle.moving", "vehicle.parked", "pedestrian.moving", "pedestrian.standing")


class _Unpickler(pickle.Unpickler):
    """A pickle is a program: this one may call three names."""

    def find_class(self, module: str, name: str) -> Any:
        return ADMITTED[module, name]


def write_demo(demo: Path, folder: Path) -> Path:
    """Write the demo's keyframe as `scene-0061` into `folder`, with links to its files."""
    (path,) = demo.glob("*.pkl")
    with path.open("rb") as file:
        info = _Unpickler(file).load()
    frame = info["data_list"][0]
    world_from_car = np.array(frame["ego2global"])
    car_from_lidar = np.array(frame["lidar_points"]["lidar2ego"])
    world_from_lidar = world_from_car @ car_from_lidar
    sensors = [
        {
            "channel": "LIDAR_TOP",
            "file": frame["lidar_points"]["lidar_path"],
            "seconds": frame["timestamp"],
            "car_from_sensor": car_from_lidar,
            "world_from_car": world_from_car,
            "K": [],
            "size": (0, 0),
        }
    ]
    for channel, image in frame["images"].items():
        car_from_camera = np.array(image["cam2ego"])
        # The demo's `ego2global` is that of the sweep; each camera has its own.
        world_from_camera = world_from_lidar @ np.linalg.inv(image["lidar2cam"])
        sensors.append(
            {
                "channel": channel,
                "file": image["img_path"],
                "seconds": image["timestamp"],
                "car_from_sensor": car_from_camera,
                "world_from_car": world_from_camera @ np.linalg.inv(car_from_camera),
                "K": image["cam2img"],
                "size": (900, 1600),
            }
        )
    tables = {name: [] for name in ("visibility", "log", "map")} | _sensor_tables(sensors)
    micros = round(frame["timestamp"] * 1e6)
    tables["scene"] = [{"token": "scene", "name": "scene-0061", "first_sample_token": "sample"}]
    tables["sample"] = [
        {"token": "sample", "scene_token": "scene", "timestamp": micros, "prev": "", "next": ""}
    ]
    names = {number: name for name, number in info["metainfo"]["categories"].items()}
    names[-1] = "other"
    tables |= _box_tables(frame["instances"], names, world_from_lidar)
    write_tables(folder / FOLDER, tables)
    for sensor in sensors:
        path = folder / "samples" / sensor["channel"] / sensor["file"]
        path.parent.mkdir(parents=True)
        # A path that leaves the folder is refused, and so is a link out of it.
        path.write_bytes((demo / sensor["file"]).read_bytes())
    return folder


def _sensor_tables(sensors: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    tables = {name: [] for name in ("sensor", "calibrated_sensor", "ego_pose", "sample_data")}
    for sensor in sensors:
        channel, (height, width) = sensor["channel"], sensor["size"]
        micros = round(sensor["seconds"] * 1e6)
        tables["sensor"].append({"token": f"sensor-{channel}", "channel": channel})
        tables["calibrated_sensor"].append(
            {
                "token": f"calibrated-{channel}",
                "sensor_token": f"sensor-{channel}",
                "camera_intrinsic": sensor["K"],
                **_pose(sensor["car_from_sensor"]),
            }
        )
        tables["ego_pose"].append(
            {"token": f"pose-{channel}", "timestamp": micros, **_pose(sensor["world_from_car"])}
        )
        tables["sample_data"].append(
            {
                "token": f"data-{channel}",
                "sample_token": "sample",
                "ego_pose_token": f"pose-{channel}",
                "calibrated_sensor_token": f"calibrated-{channel}",
                "timestamp": micros,
                "is_key_frame": True,
                "height": height,
                "width": width,
                "filename": f"samples/{channel}/{sensor['file']}",
            }
        )
    return tables


def _box_tables(
    boxes: list[dict[str, Any]],
    names: dict[int, str],
    world_from_lidar: np.ndarray,
) -> dict[str, list[dict[str, Any]]]:
    tables = {name: [] for name in ("instance", "sample_annotation")}
    for number, box in enumerate(boxes):
        *centre, length, width, height, yaw = box["bbox_3d"]
        name = names[box["bbox_label_3d"]]
        forward = world_from_lidar[:3, :3] @ [np.cos(yaw), np.sin(yaw), 0]
        half = np.arctan2(forward[1], forward[0]) / 2
        moves = bool(np.hypot(*box["velocity"]) > 0.5)
        attribute = ""
        if name == "pedestrian":
            attribute = "pedestrian.moving" if moves else "pedestrian.standing"
        elif CATEGORIES[name].startswith("vehicle") and "cycle" not in name:
            attribute = "vehicle.moving" if moves else "vehicle.parked"
        tables["instance"].append({"token": f"object-{number}", "category_token": name})
        tables["sample_annotation"].append(
            {
                "token": f"box-{number}",
                "sample_token": "sample",
                "instance_token": f"object-{number}",
                "attribute_tokens": [attribute] if attribute else [],
                "translation": (world_from_lidar @ [*centre, 1])[:3].tolist(),
                "size": [width, length, height],
                "rotation": [float(np.cos(half)), 0.0, 0.0, float(np.sin(half))],
            }
        )
    tables["category"] = [{"token": key, "name": name} for key, name in CATEGORIES.items()]
    tables["attribute"] = [{"token": name, "name": name} for name in ATTRIBUTES]
    return tables


def _pose(matrix: np.ndarray) -> dict[str, list[float]]:
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
    return {"rotation": [w, x, y, z], "translation": matrix[:3, 3].tolist()}
