"""nuScenes in the folder format of its release (see docs/nuscenes.md)."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.files import check_file
from geoevs.core.images import read_image
from geoevs.core.names import expanded, inside
from geoevs.core.settings import OneOf
from geoevs.scenes.camera import WORLD_LIMIT, Camera
from geoevs.scenes.checks import LARGEST_RIG
from geoevs.scenes.scene import (
    Exposure,
    Frame,
    Rig,
    SceneExtras,
    SceneInfo,
    SceneRecord,
    SceneRef,
    scene_origin,
)
from geoevs.scenes.sources.conventions import RecordedSource
from geoevs.scenes.sources.nuscenes.instants import (
    CAMERAS,
    CHANNELS,
    LIDAR,
    Instant,
    Reading,
    read_recording,
)
from geoevs.scenes.sources.nuscenes.lidar import read_sweep
from geoevs.scenes.sources.nuscenes.tracks import read_tracks

VERSIONS = ("v1.0-mini", "v1.0-trainval", "v1.0-test")
RIG = Rig(
    front="CAM_FRONT",
    front_left="CAM_FRONT_LEFT",
    front_right="CAM_FRONT_RIGHT",
    lidar_split="beam",
)
LICENCE = "CC BY-NC-SA 4.0 (nuScenes)"

# nuScenes' K is OpenCV's, which counts a pixel's centre as integer; ours is at +0.5.
CENTRE_SHIFT = 0.5

EVERYWHERE = WORLD_LIMIT * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
"""The zone without boxes of a frame that nobody labelled."""


class Source(RecordedSource):
    """nuScenes: six cameras at 1600 x 900 and a LiDAR of 32 beams, with boxes twice a second.

    Its images are free of lens distortion, so they are only resized. Every image and every sweep
    has its own pose of the car. The world is nuScenes' global frame, whose z is up; a scene more
    than 1 km from its origin is moved there (see `scene_origin`). Points on the car itself are left
    out. How each was checked is in docs/nuscenes.md.

    Args:
        height, width: size of the run's images in pixels; whole images are resized to it.
        folder: holds the folders of tables, samples and sweeps (see `expanded`).
        version: which folder of tables is read.
        sweeps: whether frames between keyframes are read too. Nobody drew boxes in them, and
            `no_label_zones` covers them whole.
        ego_masks: a folder of pictures `<CAMERA>.png`, white where that camera sees the car that
            carries it.
    """

    scene_words = "nuScenes scene"

    def __init__(
        self,
        height: int,
        width: int,
        *,
        folder: str,
        version: Annotated[str, OneOf(VERSIONS)] = VERSIONS[0],
        sweeps: bool = False,
        ego_masks: str | None = None,
    ) -> None:
        self.height, self.width = height, width
        self.folder = expanded(folder)
        self.version = version
        self.sweeps = sweeps
        self.ego_masks = None if ego_masks is None else expanded(ego_masks)

    def files(self, scene: SceneRef) -> Iterable[Path]:
        """The tables, and the pictures of the car; listing all samples would take minutes."""
        tables = self.folder / self.version
        return [tables] if self.ego_masks is None else [tables, self.ego_masks]

    def open(self, scene: SceneRef) -> SceneRecord:
        """Open a scene; its tables are read now, its images and sweeps as they are iterated.

        Frames are counted from 0 in the order of time: keyframes, or with `sweeps` all instants of
        which every sensor has a recording.

        Raises:
            GeoEvsError: a folder, table or file is missing, a record is broken or points nowhere,
                or the scene has not all frames of the range; the sentence names the file and the
                record.
        """
        tables = self._tables()
        recording = read_recording(tables, scene.name, self.sweeps)
        instants = _chosen(scene, recording.instants, tables)
        readings = [
            reading for instant in instants.values() for reading in instant.readings.values()
        ]
        for reading in readings:
            check_file(self._file(reading))
        start = next(iter(instants.values())).readings
        # Not their mean: one sensor whose pose is wrong must not move the others.
        places = [_pose(start[channel])[:3, 3] for channel in CHANNELS]
        info = SceneInfo(
            name=scene.name,
            source="nuscenes",
            licence=LICENCE,
            rig=RIG,
            cameras=CAMERAS,
            origin=scene_origin(np.median(places, axis=0)),
        )
        for reading in readings:
            _placed(reading, info)
        frames = {
            instant.sample: number
            for number, instant in instants.items()
            if instant.sample is not None
        }
        return SceneRecord(
            info=info,
            tracks=read_tracks(tables, recording.samples, frames, info.origin),
            frames=(self._read_frame(info, *instant) for instant in instants.items()),
            frame_count=len(instants),
            extras=SceneExtras(
                ego_masks=self._read_masks(),
                no_label_zones={
                    number: [EVERYWHERE]
                    for number, instant in instants.items()
                    if instant.sample is None or self.version == "v1.0-test"
                },
            ),
        )

    def _tables(self) -> Path:
        if not self.folder.is_dir():
            raise GeoEvsError(
                f"there is no nuScenes folder '{self.folder}'; set GEOEVS_NUSCENES to the folder "
                "that holds v1.0-mini, samples and sweeps"
            )
        tables = self.folder / self.version
        if not tables.is_dir():
            there = ", ".join(name for name in VERSIONS if (self.folder / name).is_dir())
            raise GeoEvsError(
                f"{tables} is missing; unpack its archive there, or set 'version' to one that is "
                f"({there or 'there is none'})"
            )
        return tables

    def _file(self, reading: Reading) -> Path:
        return inside(self.folder, reading.data.text("filename"), reading.data.where)

    def _read_frame(self, info: SceneInfo, number: int, instant: Instant) -> Frame:
        cameras, images, exposures = {}, {}, {}
        for name in CAMERAS:
            reading = instant.readings[name]
            image = read_image(self._file(reading))
            camera = _camera(name, image, self._file(reading), reading, info)
            cameras[name] = camera.resized(self.height, self.width)
            images[name] = cv2.resize(
                image, (self.width, self.height), interpolation=cv2.INTER_AREA
            )
            exposures[name] = Exposure(*[reading.data.seconds] * 3)
        reading = instant.readings[LIDAR]
        return Frame(
            frame=number,
            timestamp=reading.data.seconds,
            cameras=cameras,
            images=images,
            points=read_sweep(
                self._file(reading), reading.sensor.pose, _moved_to(reading.ego.pose, info)
            ),
            exposures=exposures,
        )

    def _read_masks(self) -> dict[str, np.ndarray]:
        """(H, W) bool by camera, of those that have a picture."""
        if self.ego_masks is None:
            return {}
        masks = {}
        for path in sorted(self.ego_masks.glob("*.png")):
            if path.stem not in CAMERAS:
                hint = did_you_mean(path.stem, CAMERAS)
                raise GeoEvsError(f"{path} is named after no camera of nuScenes; {hint}")
            mask = cv2.resize(
                read_image(path)[..., 0],
                (self.width, self.height),
                interpolation=cv2.INTER_NEAREST,
            )
            masks[path.stem] = mask > 127
        if not masks:
            raise GeoEvsError(
                f"{self.ego_masks} has no masks of the car; put pictures such as CAM_BACK.png "
                "there, or set 'ego_masks' to null"
            )
        return masks


def _chosen(scene: SceneRef, instants: Sequence[Instant], tables: Path) -> dict[int, Instant]:
    """The instants of a scene's range, by frame."""
    first = 0 if scene.first is None else scene.first
    last = len(instants) - 1 if scene.last is None else scene.last
    who = f"{tables / 'sample_data.json'}: scene '{scene.name}'"
    if last >= len(instants):
        raise GeoEvsError(
            f"{who} has no frame {max(first, len(instants))}; choose from 0 to {len(instants) - 1}"
        )
    chosen = {number: instants[number] for number in range(first, last + 1)}
    if all(instant.sample is None for instant in chosen.values()):
        keyframes = [
            str(number) for number, instant in enumerate(instants) if instant.sample is not None
        ]
        raise GeoEvsError(
            f"{who} has no boxes in frames {first} to {last}, which are sweeps between keyframes; "
            f"choose a range with one of the keyframes ({', '.join(keyframes)})"
        )
    return chosen


def _pose(reading: Reading) -> np.ndarray:
    """(4, 4) nuScenes' global frame from the sensor."""
    return reading.ego.pose @ reading.sensor.pose


def _moved_to(pose: np.ndarray, info: SceneInfo) -> np.ndarray:
    """A pose less the scene's origin."""
    moved = pose.copy()
    moved[:3, 3] -= info.origin
    return moved


def _placed(reading: Reading, info: SceneInfo) -> np.ndarray:
    """(4, 4) world from the sensor, on its car and near the scene's origin.

    Raises:
        GeoEvsError: it is not.
    """
    for record, place, called, most in (
        (reading.sensor, (0, 0, 0), "the car", LARGEST_RIG),
        (reading.ego, info.origin, "where the scene begins", WORLD_LIMIT),
    ):
        away = float(np.abs(record.array("translation", (3,)) - place).max())
        if away > most:
            raise GeoEvsError(
                f"{record.where} has a translation {away:.4g} m from {called}, more than {most:g}; "
                "download the table again"
            )
    return _moved_to(_pose(reading), info)


def _camera(name: str, image: np.ndarray, path: Path, reading: Reading, info: SceneInfo) -> Camera:
    """The camera of an image, at the image's own size."""
    height, width = image.shape[:2]
    for field, size in (("height", height), ("width", width)):
        if reading.data.values.get(field) != size:
            raise GeoEvsError(
                f"{path} is {width} x {height}, but {reading.data.where} says otherwise; copy the "
                "image as it was released"
            )
    K = reading.sensor.array("camera_intrinsic", (3, 3))
    K[:2, 2] += CENTRE_SHIFT
    try:
        camera = Camera(K, np.eye(4), height, width, name)
    except GeoEvsError as error:
        raise GeoEvsError(f"{reading.sensor.where}: {error}") from error
    return replace(camera, world_from_camera=_placed(reading, info))
