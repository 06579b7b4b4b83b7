"""The scene store: a folder that nerfstudio opens; no COLMAP model is written.

transforms.json            nerfstudio's format, plus camera, frame, timestamp and split
images/<camera>/<frame>.png
lidar/<frame>.npz          xyz, rgb, camera, sensor, beam (see PointCloud)
tracks.parquet             boxes, one row a frame and track (see TRACK_COLUMNS)
scene.json                 name, source, licence, rig; written last
"""

import dataclasses
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.files import (
    new_folder,
    read_arrays,
    read_image,
    read_json,
    to_float,
    whole_file,
    write_arrays,
    write_bytes,
    write_image,
    write_json,
)
from geoevs.scenes.camera import Camera, view_key
from geoevs.scenes.scene import TRACK_COLUMNS, Frame, PointCloud, Rig, SceneInfo

# nerfstudio's cameras are OpenGL's: y up, z backward.
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
POINT_FIELDS = [field.name for field in dataclasses.fields(PointCloud)]


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """One camera as nerfstudio's per-frame fields (OPENCV model, no distortion)."""
    pose = camera.world_from_camera @ OPENCV_FROM_OPENGL
    return {
        "fl_x": camera.K[0, 0],
        "fl_y": camera.K[1, 1],
        "cx": camera.K[0, 2],
        "cy": camera.K[1, 2],
        "w": camera.width,
        "h": camera.height,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
        "transform_matrix": pose.tolist(),
    }


def camera_from_json(entry: dict[str, Any], name: str, file: Path) -> Camera:
    """Inverse of `camera_to_json`; `file` is where the entry stands, for errors.

    Raises:
        GeoEvsError: a field is missing, or the calibration is impossible (see Camera).
    """
    try:
        rows = [[entry["fl_x"], 0, entry["cx"]], [0, entry["fl_y"], entry["cy"]], [0, 0, 1]]
        K = np.array(rows, np.float64)
        pose = np.array(entry["transform_matrix"], np.float64) @ OPENCV_FROM_OPENGL
        return Camera(K, pose, entry["h"], entry["w"], name)
    except GeoEvsError as error:
        raise GeoEvsError(f"{file}: {error}") from error
    except KeyError as error:
        raise GeoEvsError(f"{file}: camera '{name}' lacks {error}; add it") from error
    except (TypeError, ValueError) as error:
        raise GeoEvsError(
            f"{file}: camera '{name}' has a value that cannot be read ({error}); correct it"
        ) from error


def write_scene(
    folder: Path, info: SceneInfo, tracks: pd.DataFrame, frames: Iterator[Frame]
) -> None:
    """Write a scene store, whole or not at all, reading one frame at a time.

    Raises:
        GeoEvsError: the scene has no frame, a camera lacks an image, or nothing can be written.
    """
    with new_folder(folder) as partial:
        entries = []
        for frame in frames:
            _check_frame(info, frame)
            for name in info.cameras:
                path = f"images/{view_key(name, frame.frame)}.png"
                write_image(partial / path, frame.images[name])
                entries.append(
                    {
                        "file_path": path,
                        "camera": name,
                        "frame": frame.frame,
                        "timestamp": frame.timestamp,
                        "split": "train",
                        **camera_to_json(frame.cameras[name]),
                    }
                )
            arrays = {name: getattr(frame.points, name) for name in POINT_FIELDS}
            write_arrays(partial / f"lidar/{frame.frame:06d}.npz", arrays)
        if not entries:
            raise GeoEvsError(f"scene '{info.name}' has no frames; check its frame range")
        write_bytes(partial / "tracks.parquet", tracks[list(TRACK_COLUMNS)].to_parquet(index=False))
        write_json(partial / "transforms.json", {"camera_model": "OPENCV", "frames": entries})
        write_json(partial / "scene.json", dataclasses.asdict(info))


def _check_frame(info: SceneInfo, frame: Frame) -> None:
    where = f"frame {frame.frame} of scene '{info.name}'"
    for name in info.cameras:
        if name not in frame.cameras or name not in frame.images:
            raise GeoEvsError(f"{where} has no camera '{name}'; supply it or leave out the frame")
        camera, image = frame.cameras[name], frame.images[name]
        if image.shape != (camera.height, camera.width, 3):
            raise GeoEvsError(
                f"{where}: camera '{name}' is {camera.height} x {camera.width} but its image is "
                f"{image.shape[0]} x {image.shape[1]}; resize them together"
            )
    if not np.isfinite(frame.points.xyz).all():
        raise GeoEvsError(f"{where} has LiDAR points that are NaN or infinite; drop those rows")


def _read_info(path: Path) -> SceneInfo:
    described = read_json(path)
    try:
        rig, cameras = Rig(**described["rig"]), tuple(described["cameras"])
        return SceneInfo(**{**described, "rig": rig, "cameras": cameras})
    except (KeyError, TypeError) as error:
        raise GeoEvsError(f"{path} describes no scene ({error}); remake the store") from error


class Scene:
    """A scene store opened for reading; images and points are read when asked for.

    Raises:
        GeoEvsError: the folder is no scene store, or a camera lacks one of the frames.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.info = _read_info(self.folder / "scene.json")
        self.cameras: tuple[str, ...] = self.info.cameras
        self._transforms = self.folder / "transforms.json"
        try:
            entries = read_json(self._transforms)["frames"]
            self._entries = {(entry["camera"], entry["frame"]): entry for entry in entries}
        except (KeyError, TypeError) as error:
            raise GeoEvsError(
                f"{self._transforms} lists no views with 'camera' and 'frame' ({error}); "
                "remake the store"
            ) from error
        self.frames: tuple[int, ...] = tuple(sorted({frame for _, frame in self._entries}))
        if not self.frames:
            raise GeoEvsError(f"{self._transforms} has no frames; remake the store")
        for frame in self.frames:
            for camera in self.cameras:
                if (camera, frame) not in self._entries:
                    raise GeoEvsError(
                        f"{self._transforms} has no camera '{camera}' in frame {frame}; "
                        "add the image or remove the frame"
                    )

    def camera(self, name: str, frame: int) -> Camera:
        """The calibrated camera `name` in `frame`."""
        return camera_from_json(self._entry(name, frame), name, self._transforms)

    def image(self, name: str, frame: int) -> np.ndarray:
        """(H, W, 3) float32 in [0, 1]: what camera `name` recorded in `frame`."""
        return to_float(read_image(self.folder / self._entry(name, frame)["file_path"]))

    def timestamp(self, frame: int) -> float:
        """Seconds at which `frame` was recorded."""
        return self._entry(self.cameras[0], frame)["timestamp"]

    def points(self, frame: int) -> PointCloud:
        """The coloured LiDAR points of `frame`."""
        path = self.folder / f"lidar/{frame:06d}.npz"
        arrays = read_arrays(path)
        with whole_file(path):
            return PointCloud(**{name: arrays[name] for name in POINT_FIELDS})

    @cached_property
    def tracks(self) -> pd.DataFrame:
        """Boxes of moving and parked objects, one row a frame and track (see TRACK_COLUMNS)."""
        path = self.folder / "tracks.parquet"
        with whole_file(path):
            return pd.read_parquet(path)

    def _entry(self, name: str, frame: int) -> dict[str, Any]:
        if name not in self.cameras:
            raise GeoEvsError(
                f"scene '{self.info.name}' has no camera '{name}'; "
                f"{did_you_mean(name, self.cameras)}"
            )
        if frame not in self.frames:
            raise GeoEvsError(
                f"scene '{self.info.name}' has no frame {frame} "
                f"(it has {self.frames[0]} to {self.frames[-1]})"
            )
        return self._entries[name, frame]
