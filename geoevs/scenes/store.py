"""The scene store: a folder that nerfstudio opens; `geoevs.scenes.interop` makes one for COLMAP.

transforms.json            nerfstudio's format, plus camera, frame, timestamp and split
images/<camera>/<frame>.png
points.ply                 where nerfstudio starts: points that may condition methods
lidar/<frame>.npz          xyz, rgb, camera, sensor, beam (see PointCloud)
tracks.parquet             boxes, one row a frame and track (see TRACK_COLUMNS)
scene.json                 what `SceneInfo` has; written last

What only some sources know stands in further files (see `geoevs.scenes.extras`).
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.files import (
    new_folder,
    read_arrays,
    read_json,
    whole_file,
    write_arrays,
    write_bytes,
    write_json,
)
from geoevs.core.hashes import file_hash, text_hash
from geoevs.core.images import read_image, to_float, write_image
from geoevs.core.names import inside
from geoevs.core.text import clean
from geoevs.scenes.camera import Camera, view_key
from geoevs.scenes.camera_json import camera_from_json, camera_to_json, check_undistorted
from geoevs.scenes.checks import (
    check_exposure,
    check_info,
    check_rig,
    check_tracks,
    checked_points,
    frame_number,
    timestamp,
)
from geoevs.scenes.extras import (
    MAP,
    check_extras,
    read_ego_masks,
    read_map,
    read_synced_tracks,
    read_zones,
    write_extras,
)
from geoevs.scenes.interop import ThinnedPoints, write_ply
from geoevs.scenes.road_map import RoadMap
from geoevs.scenes.scene import (
    NO_EXTRAS,
    TRACK_COLUMNS,
    Exposure,
    Frame,
    PointCloud,
    Rig,
    SceneExtras,
    SceneInfo,
)

POINTS_FILE = "points.ply"
POINT_FIELDS = [field.name for field in dataclasses.fields(PointCloud)]


def write_scene(
    folder: Path,
    info: SceneInfo,
    tracks: pd.DataFrame,
    frames: Iterator[Frame],
    extras: SceneExtras = NO_EXTRAS,
    unseen: bool = False,
) -> None:
    """Write a scene store, whole or not at all, reading one frame at a time.

    Args:
        folder: the store.
        info: the scene's description.
        tracks: its boxes.
        frames: read once.
        extras: what its source knows besides.
        unseen: whether frames may lack images, for a method that must not see them.

    Raises:
        GeoEvsError: the scene has no frame, a camera lacks an image, something cannot be true of
            the scene (see `geoevs.scenes.checks`), or nothing can be written.
    """
    who = f"scene '{info.name}'"
    check_info(info, who)
    check_tracks(tracks, who)
    thinned = ThinnedPoints(info.rig)
    with new_folder(folder) as partial:
        entries: list[dict[str, Any]] = []
        sizes: dict[str, tuple[int, int]] = {}
        seconds = -math.inf
        for frame in frames:
            where = f"frame {frame_number(frame.frame, who)} of {who}"
            seconds = timestamp(frame.timestamp, where, seconds)
            points = _checked_frame(info, frame, where, unseen)
            for name in info.cameras:
                path = None
                if name in frame.images:
                    path = f"images/{view_key(name, frame.frame)}.png"
                    write_image(partial / path, frame.images[name])
                entry = {
                    "file_path": path,
                    "camera": name,
                    "frame": frame.frame,
                    "timestamp": frame.timestamp,
                    "split": "train",
                    **camera_to_json(frame.cameras[name]),
                }
                if name in frame.exposures:
                    entry["exposure"] = list(frame.exposures[name])
                entries.append(entry)
                sizes[name] = frame.cameras[name].height, frame.cameras[name].width
            thinned.add(points)
            arrays = {name: getattr(points, name) for name in POINT_FIELDS}
            write_arrays(partial / f"lidar/{frame.frame:06d}.npz", arrays)
        if not entries:
            raise GeoEvsError(f"scene '{info.name}' has no frames; check its frame range")
        check_extras(extras, sizes, who)
        write_extras(partial, extras)
        write_bytes(partial / "tracks.parquet", tracks[list(TRACK_COLUMNS)].to_parquet(index=False))
        cloud = {}
        if len(thinned.vertices):
            write_ply(partial / POINTS_FILE, thinned.vertices)
            cloud = {"ply_file_path": POINTS_FILE}
        views = {"camera_model": "OPENCV", **cloud, "frames": entries}
        write_json(partial / "transforms.json", views)
        described = {**vars(info), "rig": vars(info.rig), "made_with": dict(info.made_with)}
        write_json(partial / "scene.json", described)


def _checked_frame(info: SceneInfo, frame: Frame, where: str, unseen: bool) -> PointCloud:
    """A frame's points, after all that it holds was checked."""
    for name in info.cameras:
        if name not in frame.cameras or (name not in frame.images and not unseen):
            raise GeoEvsError(f"{where} has no camera '{name}'; supply it or leave out the frame")
        if name not in frame.images:
            continue
        camera, image = frame.cameras[name], frame.images[name]
        if image.shape != (camera.height, camera.width, 3):
            raise GeoEvsError(
                f"{where}: camera '{name}' is {camera.height} x {camera.width} but its image is "
                f"{' x '.join(map(str, image.shape[:2]))}; resize them together"
            )
        if image.dtype != np.uint8 and not np.isfinite(image).all():
            raise GeoEvsError(f"{where}: the image of camera '{name}' has NaN; make it again")
    for exposure in frame.exposures.values():
        check_exposure(exposure, where)
    check_rig(info.rig, {name: frame.cameras[name] for name in info.cameras}, where)
    return checked_points(frame.points, len(info.cameras), where)


def _read_info(path: Path) -> SceneInfo:
    described = _fields(read_json(path), SceneInfo, path)
    try:
        described["rig"] = Rig(**_fields(described["rig"], Rig, path))
    except GeoEvsError as error:
        raise error if str(path) in str(error) else GeoEvsError(f"{path}: {error}") from error
    for name in ("cameras", "origin", "tags"):
        if not isinstance(described.get(name, []), list):
            raise GeoEvsError(f"{path} describes no scene ('{name}' is no list); remake the store")
    described |= {
        name: tuple(described[name]) for name in ("cameras", "origin", "tags") if name in described
    }
    if not isinstance(described.get("made_with", {}), dict):
        raise GeoEvsError(f"{path} describes no scene ('made_with' is none); remake the store")
    info = SceneInfo(**described)
    check_info(info, path)
    return info


def _fields(value: Any, kind: type, path: Path) -> dict[str, Any]:
    """A JSON object that has the fields of a dataclass and no others."""
    missing = dataclasses.MISSING
    names = {
        field.name: field.default is field.default_factory is missing
        for field in dataclasses.fields(kind)
    }
    if not isinstance(value, dict):
        raise GeoEvsError(f"{path} describes no scene (no {kind.__name__}); remake the store")
    for name in (*(name for name in names if names[name] and name not in value), *value):
        if name not in names or name not in value:
            shown = clean(name, 40)
            raise GeoEvsError(f"{path} describes no scene ('{shown}'); remake the store")
    return dict(value)


class _View(NamedTuple):
    """What a camera recorded in a frame; no image where the store's reader must not see it."""

    camera: Camera
    image: Path | None
    timestamp: float
    exposure: Exposure | None


def _read_views(folder: Path, cameras: tuple[str, ...]) -> dict[tuple[str, int], _View]:
    """The views of a store by camera and frame; those of cameras that no scene lists are left out.

    Raises:
        GeoEvsError: an entry lacks something, stands there twice, or names a file that is missing,
            another view's, or outside the store.
    """
    path = folder / "transforms.json"
    described = read_json(path)
    entries = described.get("frames") if isinstance(described, dict) else None
    if not isinstance(entries, list):
        raise GeoEvsError(f"{path} lists no views in 'frames'; remake the store")
    check_undistorted(described, f"{path}: the camera of all views")
    views: dict[tuple[str, int], _View] = {}
    images: set[Path] = set()
    for entry in entries:
        if not (isinstance(entry, dict) and {"camera", "frame"} <= entry.keys()):
            raise GeoEvsError(f"{path} has a view without 'camera' or 'frame'; remake the store")
        if entry["camera"] not in cameras:
            continue
        key = name, frame = entry["camera"], frame_number(entry["frame"], path)
        who = f"{path}: camera '{name}' in frame {frame}"
        for field in ("file_path", "timestamp"):
            if field not in entry:
                raise GeoEvsError(f"{who} lacks '{field}'; add it")
        image = None
        if entry["file_path"] is not None:
            image = inside(folder, entry["file_path"], path)
        if key in views or image in images:
            raise GeoEvsError(f"{who} stands there twice, or has another view's image; correct it")
        if image is not None:
            if not image.is_file():
                raise GeoEvsError(f"{image} is missing; copy it there or drop its frame")
            images.add(image)
        camera = camera_from_json(entry, name, path)
        exposure = entry.get("exposure")
        views[key] = _View(
            camera,
            image,
            timestamp(entry["timestamp"], who),
            None if exposure is None else check_exposure(exposure, who),
        )
    return views


class Scene:
    """A scene store opened for reading; images and points are read when asked for.

    Raises:
        GeoEvsError: the folder is no scene store, a camera lacks one of the frames, or what it
            says of cameras and times cannot be true (see `geoevs.scenes.checks`).
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.info = _read_info(self.folder / "scene.json")
        self.cameras: tuple[str, ...] = self.info.cameras
        self._views = _read_views(self.folder, self.cameras)
        self.frames: tuple[int, ...] = tuple(sorted({frame for _, frame in self._views}))
        path = self.folder / "transforms.json"
        if not self.frames:
            raise GeoEvsError(f"{path} has no frames; remake the store")
        seconds = -math.inf
        for frame in self.frames:
            for camera in self.cameras:
                if (camera, frame) not in self._views:
                    raise GeoEvsError(
                        f"{path} has no camera '{camera}' in frame {frame}; "
                        "add the image or remove the frame"
                    )
            where = f"{path}: frame {frame}"
            seconds = timestamp(self.timestamp(frame), where, seconds)
            check_rig(
                self.info.rig, {name: self.camera(name, frame) for name in self.cameras}, where
            )

    @cached_property
    def stamp(self) -> str:
        """Hash of what the store says of itself: made with what, its cameras and poses, its map."""
        files = [self.folder / name for name in ("scene.json", "transforms.json", MAP)]
        return text_hash(" ".join(file_hash(path) for path in files if path.exists()))

    def camera(self, name: str, frame: int) -> Camera:
        """The calibrated camera `name` in `frame`."""
        return self._view(name, frame).camera

    def image(self, name: str, frame: int) -> np.ndarray:
        """(H, W, 3) float32 in [0, 1]: what camera `name` recorded in `frame`.

        Raises:
            GeoEvsError: there is none, the file is no image, or one of another size than its
                camera.
        """
        camera, path = self.camera(name, frame), self.image_path(name, frame)
        image = read_image(path)
        if image.shape[:2] != (camera.height, camera.width):
            raise GeoEvsError(
                f"{path} is {image.shape[0]} x {image.shape[1]}, but transforms.json says "
                f"{camera.height} x {camera.width}; resize the image, or w, h and the intrinsics"
            )
        return to_float(image)

    def image_path(self, name: str, frame: int) -> Path:
        """The file of what camera `name` recorded in `frame`.

        Raises:
            GeoEvsError: the store has none, as it was written for a method that must not see it.
        """
        path = self._view(name, frame).image
        if path is None:
            raise GeoEvsError(
                f"{self.folder} has no image of camera '{name}' in frame {frame}; it was saved by "
                "a method that does not see it"
            )
        return path

    def timestamp(self, frame: int) -> float:
        """Seconds at which `frame` was recorded."""
        return self._view(self.cameras[0], frame).timestamp

    def exposure(self, name: str, frame: int) -> Exposure | None:
        """When camera `name` took its image of `frame`; None where its source does not know."""
        return self._view(name, frame).exposure

    @cached_property
    def ego_masks(self) -> dict[str, np.ndarray]:
        """(H, W) bool by camera: pixels that show the car which carries it (see SceneExtras)."""
        return read_ego_masks(self.folder, self._sizes)

    @cached_property
    def road_map(self) -> RoadMap | None:
        """The ground around the scene; None where the source has no map."""
        return read_map(self.folder)

    @cached_property
    def no_label_zones(self) -> dict[int, list[np.ndarray]]:
        """Polygons (N, 2) in which nobody drew boxes, by frame (see SceneExtras)."""
        return read_zones(self.folder)

    @cached_property
    def synced_tracks(self) -> pd.DataFrame | None:
        """Boxes at the instants of the cameras; None where the source has none."""
        return read_synced_tracks(self.folder, self._sizes)

    def extras(self, cameras: Sequence[str]) -> SceneExtras:
        """What only some sources know of the scene, for a store with some of its cameras."""
        synced = self.synced_tracks
        return SceneExtras(
            {name: mask for name, mask in self.ego_masks.items() if name in cameras},
            self.road_map,
            self.no_label_zones,
            None if synced is None else synced[synced["camera"].isin(cameras)],
        )

    @property
    def _sizes(self) -> dict[str, tuple[int, int]]:
        """Height and width by camera."""
        cameras = {name: self.camera(name, self.frames[0]) for name in self.cameras}
        return {name: (camera.height, camera.width) for name, camera in cameras.items()}

    def points(self, frame: int) -> PointCloud:
        """The coloured LiDAR points of `frame`.

        Raises:
            GeoEvsError: the file is missing or damaged, or holds what no LiDAR measures.
        """
        path = self.folder / f"lidar/{frame:06d}.npz"
        arrays = read_arrays(path)
        for name in POINT_FIELDS:
            if name not in arrays:
                raise GeoEvsError(f"{path} has no array '{name}'; add it or remake the store")
        points = PointCloud(**{name: arrays[name] for name in POINT_FIELDS})
        return checked_points(points, len(self.cameras), path)

    @cached_property
    def tracks(self) -> pd.DataFrame:
        """Boxes of moving and parked objects, one row a frame and track (see TRACK_COLUMNS).

        Raises:
            GeoEvsError: the file is missing or damaged, or holds boxes that cannot be.
        """
        path = self.folder / "tracks.parquet"
        with whole_file(path):
            tracks = pd.read_parquet(path)
        return check_tracks(tracks, path)

    def _view(self, name: str, frame: int) -> _View:
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
        return self._views[name, frame]
