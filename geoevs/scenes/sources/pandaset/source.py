"""PandaSet sequences in the folder format of their public release (see docs/pandaset.md)."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.images import read_image
from geoevs.core.names import expanded
from geoevs.scenes.camera import WORLD_LIMIT
from geoevs.scenes.checks import check_info
from geoevs.scenes.scene import (
    Exposure,
    Frame,
    PointCloud,
    Rig,
    SceneExtras,
    SceneInfo,
    SceneRecord,
    SceneRef,
    scene_origin,
)
from geoevs.scenes.sources.conventions import RecordedSource
from geoevs.scenes.sources.pandaset.calibration import (
    read_camera,
    read_entry,
    read_pose,
    read_timestamp,
)
from geoevs.scenes.sources.pandaset.road_map import read_road_map
from geoevs.scenes.sources.pandaset.tracks import read_tracks
from geoevs.scenes.sources.pandaset.unpickle import check_numbers, read_table

RIG = Rig(
    front="front_camera",
    front_left="front_left_camera",
    front_right="front_right_camera",
    lidar_split="sensor",
)
RIG_CAMERAS = (RIG.front, RIG.front_left, RIG.front_right)
# Front to back, left before right; any other camera follows by name.
CAMERA_ORDER = (*RIG_CAMERAS, "left_camera", "right_camera", "back_camera")
LICENCE = "CC BY 4.0 with PandaSet's Dataset Terms of Use (Hesai and Scale AI)"
PARTS = ("camera", "lidar", "annotations/cuboids", "annotations/semseg")
SENSORS = {0: "Pandar64, which scores methods", 1: "PandarGT, which may condition them"}
"""What the column `d` of a sweep says."""


class Source(RecordedSource):
    """PandaSet: six cameras at 1920 x 1080, two LiDARs and boxes, ten times a second.

    The released images are already free of lens distortion and `intrinsics.json` is their pinhole
    K, so images are only resized. K gains half a pixel: PandaSet's is OpenCV's, whose pixel centres
    are integers. Camera poses, points and boxes share one world with z up; one far from its origin
    is moved there (see `scene_origin`). How each was checked is in docs/pandaset.md.

    Args:
        height, width: size of the run's images in pixels; whole images are resized to it.
        folder: holds one folder per sequence, such as 002 (see `expanded`).
    """

    scene_words = "PandaSet scene"

    def __init__(self, height: int, width: int, *, folder: str) -> None:
        self.height, self.width = height, width
        self.folder = expanded(folder)

    def files(self, scene: SceneRef) -> Iterable[Path]:
        """The folders of its sensors, boxes and labels."""
        folder = self.folder / scene.name
        return [folder / part for part in PARTS]

    def open(self, scene: SceneRef) -> SceneRecord:
        """Open one sequence; its boxes are read now, its images and sweeps as they are iterated.

        Without a range, its frames are those that have a LiDAR sweep or an image on disk; with a
        range, all of the range. Each must be whole.

        Raises:
            GeoEvsError: the folder, the sequence, a camera of the rig, a sweep, an image, a
                calibration entry or a box file is missing; the sentence names it.
        """
        folder = self._sequence(scene)
        cameras = _find_cameras(folder)
        frames = _find_frames(folder, cameras, scene)
        sensors = [folder / "lidar", *(folder / "camera" / name for name in cameras)]
        places = []
        for sensor in sensors:
            read_entry(sensor / "poses.json", frames[-1])
            for frame in frames:
                read_timestamp(sensor / "timestamps.json", frame)
            places.append(read_pose(sensor / "poses.json", frames[0])[:3, 3])
        # Not their mean: one sensor whose pose is wrong must not move the others.
        info = SceneInfo(
            name=scene.name,
            source="pandaset",
            licence=LICENCE,
            rig=RIG,
            cameras=cameras,
            origin=scene_origin(np.median(places, axis=0)),
            redistribute=True,
        )
        check_info(info, folder)
        return SceneRecord(
            info=info,
            tracks=read_tracks(folder / "annotations/cuboids", frames, info.origin),
            frames=(self._read_frame(folder, info, frame) for frame in frames),
            frame_count=len(frames),
            extras=SceneExtras(road_map=read_road_map(folder, frames, places[0], info.origin)),
        )

    def _sequence(self, scene: SceneRef) -> Path:
        if not self.folder.is_dir():
            raise GeoEvsError(
                f"there is no PandaSet folder '{self.folder}'; set GEOEVS_PANDASET to the folder "
                "that holds sequences such as 002"
            )
        folder = self.folder / scene.name
        if not folder.is_dir():
            raise GeoEvsError(
                f"there is no PandaSet sequence at {folder}; set GEOEVS_PANDASET to the folder "
                "that holds it, or name another scene"
            )
        return folder

    def _read_frame(self, folder: Path, info: SceneInfo, number: int) -> Frame:
        calibrated, images, exposures = {}, {}, {}
        for name in info.cameras:
            path = folder / f"camera/{name}/{number:02d}.jpg"
            image = read_image(path)
            height, width = image.shape[:2]
            camera = read_camera(path, number, height, width, info.origin)
            calibrated[name] = camera.resized(self.height, self.width)
            images[name] = cv2.resize(
                image, (self.width, self.height), interpolation=cv2.INTER_AREA
            )
            time = read_timestamp(path.parent / "timestamps.json", number)
            exposures[name] = Exposure(time, time, time)
        return Frame(
            frame=number,
            timestamp=read_timestamp(folder / "lidar/timestamps.json", number),
            cameras=calibrated,
            images=images,
            points=_read_sweep(folder / f"lidar/{number:02d}.pkl.gz", info.origin),
            exposures=exposures,
        )


def _find_cameras(folder: Path) -> tuple[str, ...]:
    """Names of the camera folders in CAMERA_ORDER, then by name."""
    for name in RIG_CAMERAS:
        if not (folder / "camera" / name).is_dir():
            raise GeoEvsError(
                f"{folder / 'camera' / name} is missing; download the sequence's camera folders"
            )
    # Archives leave other folders there, such as __MACOSX.
    folders = {
        path.name
        for path in (folder / "camera").iterdir()
        if path.is_dir() and (path.name in CAMERA_ORDER or (path / "intrinsics.json").exists())
    }
    known = [name for name in CAMERA_ORDER if name in folders]
    return (*known, *sorted(folders.difference(CAMERA_ORDER)))


def _find_frames(folder: Path, cameras: tuple[str, ...], scene: SceneRef) -> Sequence[int]:
    """Numbers of the frames to read, in order, after checking that every file of them is there."""
    files = {folder / "lidar": "pkl.gz"} | {folder / "camera" / name: "jpg" for name in cameras}
    numbers = {sensor: _frame_numbers(sensor, suffix) for sensor, suffix in files.items()}
    on_disk = set().union(*numbers.values())
    if not on_disk:
        raise GeoEvsError(f"{folder} has no LiDAR sweeps and no images; download the sequence")
    frames: Sequence[int] = sorted(on_disk)
    if scene.first is not None and scene.last is not None:
        frames = range(scene.first, scene.last + 1)
    for frame in frames:
        for sensor, suffix in files.items():
            if frame not in numbers[sensor]:
                raise GeoEvsError(
                    f"{sensor / f'{frame:02d}.{suffix}'} is missing; copy it there or choose "
                    f"other frames ({min(on_disk)} to {max(on_disk)} are on disk)"
                )
    return frames


def _frame_numbers(sensor: Path, suffix: str) -> set[int]:
    stems = (path.name.removesuffix(f".{suffix}") for path in sensor.glob(f"*.{suffix}"))
    return {int(stem) for stem in stems if stem.isdecimal() and stem == f"{int(stem):02d}"}


def _read_sweep(path: Path, origin: tuple[float, float, float]) -> PointCloud:
    """The points of both LiDARs, already in the world; the data do not say which beam."""
    table = read_table(path)
    for column in ("x", "y", "z", "d"):
        if column not in table:
            raise GeoEvsError(f"{path} has no column '{column}'; download it again")
    check_numbers(table, ("x", "y", "z", "d"), path)
    xyz = table[["x", "y", "z"]].to_numpy(np.float64) - origin  # [N, 3]
    good = (np.abs(xyz) <= WORLD_LIMIT).all(axis=1)  # NaN is not good either
    if not good.all():
        raise GeoEvsError(
            f"{path} has {(~good).sum()} of {len(good)} points that are NaN, infinite or more than "
            f"{WORLD_LIMIT / 1000:g} km from the cameras; download it again or drop those rows"
        )
    if not table["d"].isin(SENSORS).all():
        raise GeoEvsError(
            f"{path} has points whose LiDAR 'd' is neither 0 nor 1; download it again"
        )
    for sensor, does in SENSORS.items():
        if not (table["d"] == sensor).any():
            raise GeoEvsError(
                f"{path} has no points of d = {sensor} ({does}); download it again or leave out "
                "the frame"
            )
    return PointCloud.uncoloured(xyz, sensor=table["d"], beam=np.zeros(len(xyz)))
