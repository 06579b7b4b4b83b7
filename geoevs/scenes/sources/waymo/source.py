"""Segments of the Waymo Open Dataset, perception, v1 and v2 (see docs/waymo.md)."""

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.images import decode_image
from geoevs.core.names import expanded
from geoevs.scenes.camera import WORLD_LIMIT, Camera
from geoevs.scenes.checks import check_info
from geoevs.scenes.road_map import RoadMap
from geoevs.scenes.scene import (
    Frame,
    Rig,
    SceneExtras,
    SceneInfo,
    SceneRecord,
    SceneRef,
    scene_origin,
)
from geoevs.scenes.sources.conventions import RecordedSource
from geoevs.scenes.sources.waymo.camera import Lens, pinhole, read_exposure
from geoevs.scenes.sources.waymo.find import open_segment, segment_files
from geoevs.scenes.sources.waymo.lidar import joined, sweep_points
from geoevs.scenes.sources.waymo.road_map import road_map
from geoevs.scenes.sources.waymo.segment import (
    CAMERAS,
    CameraImage,
    FrameLabels,
    Segment,
    Sensors,
)
from geoevs.scenes.sources.waymo.tracks import read_tracks

RIG = Rig(front="front", front_left="front_left", front_right="front_right", lidar_split="beam")
LICENCE = "Waymo Dataset License Agreement for Non-Commercial Use"
BOX_DELAY = 0.0
"""Seconds from a frame's timestamp to its boxes: label.proto has them live at the frame's start."""


class Source(RecordedSource):
    """Waymo Open Dataset: five cameras, five LiDARs and boxes, ten times a second for 20 seconds.

    Images are undistorted with K unchanged, and have the pose of the instant at which the column of
    their principal point was exposed. Range images become points in float64, those of the top LiDAR
    by the pose of each pixel. The world is the data's, less the first frame's vehicle position.

    Args:
        height, width: size of the run's images in pixels; whole images are resized to it.
        folder: holds *.tfrecord files (v1), or folders of Parquet files (v2) (see `expanded`).
        second_returns: whether the LiDARs' second returns are points too.
    """

    scene_words = "Waymo segment"

    def __init__(
        self, height: int, width: int, *, folder: str, second_returns: bool = False
    ) -> None:
        self.height, self.width = height, width
        self.folder = expanded(folder)
        self.second_returns = second_returns

    def files(self, scene: SceneRef) -> Iterable[Path]:
        """The TFRecord file of a segment, or its Parquet files."""
        return segment_files(self.folder, scene.name)

    def open(self, scene: SceneRef) -> SceneRecord:
        """Open a segment; boxes and map are read now, images and sweeps as they are iterated.

        Raises:
            GeoEvsError: the segment is missing, there twice, in both versions or damaged, lacks a
                camera or the range of frames, or its boxes or map cannot be.
        """
        segment = open_segment(self.folder, scene.name)
        for name in CAMERAS:
            if name not in segment.cameras:
                raise GeoEvsError(
                    f"{segment.where}: there is no calibration of camera '{name}'; download the "
                    "file again"
                )
        frames = _range(segment, scene)
        labels = {frame: segment.labels(frame) for frame in frames}
        first = labels[frames[0]]
        info = SceneInfo(
            name=scene.name,
            source="waymo",
            licence=LICENCE,
            rig=RIG,
            cameras=CAMERAS,
            origin=scene_origin(first.pose[:3, 3]),
            redistribute=False,
            box_delay=BOX_DELAY,
        )
        check_info(info, segment.where)
        tracks, synced = read_tracks(labels, info.origin)
        extras = SceneExtras(
            road_map=_read_map(segment, first, info.origin),
            no_label_zones=_zones(labels, info.origin),
            synced_tracks=synced,
        )
        poses = {frame: drawn.pose for frame, drawn in labels.items()}
        return SceneRecord(
            info=info,
            tracks=tracks,
            frames=self._read_frames(segment, info, poses),
            frame_count=len(frames),
            extras=extras,
        )

    def _read_frames(
        self, segment: Segment, info: SceneInfo, poses: Mapping[int, np.ndarray]
    ) -> Iterator[Frame]:
        lenses = {name: Lens.of(segment.cameras[name], name) for name in CAMERAS}
        for frame, pose in poses.items():
            sensors = segment.sensors(frame)
            cameras, images, exposures = {}, {}, {}
            for name in CAMERAS:
                image, calibration = _image(sensors, name, segment, frame), segment.cameras[name]
                exposures[name] = read_exposure(calibration, image)
                time = exposures[name].time
                camera = pinhole(calibration, lenses[name], name, image, time, info.origin)
                cameras[name] = camera.resized(self.height, self.width)
                images[name] = cv2.resize(
                    lenses[name].undistort(_decode(image, camera)),
                    (self.width, self.height),
                    interpolation=cv2.INTER_AREA,
                )
            clouds = []
            for name, sweep in sensors.sweeps:
                if name not in segment.lasers:
                    raise GeoEvsError(
                        f"{sweep.where}: LiDAR '{name}' has no calibration; download the file again"
                    )
                clouds.append(
                    sweep_points(
                        name, sweep, segment.lasers[name], pose, info.origin, self.second_returns
                    )
                )
            yield Frame(
                frame=frame,
                timestamp=segment.times[frame] / 1e6,
                cameras=cameras,
                images=images,
                points=joined(clouds),
                exposures=exposures,
            )


def _range(segment: Segment, scene: SceneRef) -> Sequence[int]:
    """The numbers of the frames to read."""
    count = len(segment.times)
    if scene.first is None or scene.last is None:
        return range(count)
    if scene.last >= count:
        raise GeoEvsError(
            f"{segment.where} has frames 0 to {count - 1}, not {scene.first} to {scene.last}; name "
            "a range within them"
        )
    return range(scene.first, scene.last + 1)


def _image(sensors: Sensors, name: str, segment: Segment, frame: int) -> CameraImage:
    if name not in sensors.images:
        raise GeoEvsError(
            f"{segment.where}: frame {frame} has no image of camera '{name}'; download the file "
            "again or leave out the frame"
        )
    return sensors.images[name]


def _decode(image: CameraImage, camera: Camera) -> np.ndarray:
    """(H, W, 3) uint8 of the size that the camera was calibrated for."""
    where = f"{image.where}: the image of camera '{camera.name}'"
    pixels = decode_image(io.BytesIO(image.jpeg), where)
    if pixels.shape[:2] != (camera.height, camera.width):
        raise GeoEvsError(
            f"{where} has {pixels.shape[0]} x {pixels.shape[1]} pixels, its calibration "
            f"{camera.height} x {camera.width}; download the file again"
        )
    return pixels


def _zones(
    labels: Mapping[int, FrameLabels], origin: tuple[float, float, float]
) -> dict[int, list[np.ndarray]]:
    """By frame, the polygons without boxes, of frames that have some."""
    zones = {}
    for frame, drawn in labels.items():
        if drawn.zones:
            zones[frame] = [zone - origin[:2] for zone in drawn.zones]
            _check_near(zones[frame], "a zone without labels", drawn.where)
    return zones


def _read_map(
    segment: Segment, first: FrameLabels, origin: tuple[float, float, float]
) -> RoadMap | None:
    """The road map where the scene's first frame sees it; None where the segment has none."""
    shift = np.array(origin) + first.map_offset
    features = [
        feature._replace(points=feature.points - shift) for feature in segment.map_features()
    ]
    _check_near([feature.points for feature in features], "the map", segment.where)
    return road_map(features)


def _check_near(outlines: Iterable[np.ndarray], what: str, where: str) -> None:
    for outline in outlines:
        if not (np.abs(outline) <= WORLD_LIMIT).all():  # NaN is not near either
            raise GeoEvsError(
                f"{where}: {what} has points that are NaN or more than {WORLD_LIMIT / 1000:g} km "
                "from where the scene begins; download the file again"
            )
