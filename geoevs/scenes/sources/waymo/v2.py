"""Version 2 of the data set: a Parquet file for each component of a segment.

Columns are `[Component].field`. Waymo's own samples have other types than its code writes, such as
names of cameras for their numbers, so both are taken.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.text import clean
from geoevs.scenes.sources.waymo.matrices import shaped
from geoevs.scenes.sources.waymo.parquet import Table, readable
from geoevs.scenes.sources.waymo.segment import (
    CAMERAS,
    LASERS,
    CameraCalibration,
    CameraImage,
    FrameLabels,
    Label,
    LaserCalibration,
    MapFeature,
    RangeImages,
    Sensors,
    named,
    transform,
)

COMPONENTS = {
    "vehicle_pose": "VehiclePoseComponent",
    "camera_calibration": "CameraCalibrationComponent",
    "camera_image": "CameraImageComponent",
    "lidar_calibration": "LiDARCalibrationComponent",
    "lidar": "LiDARComponent",
    "lidar_pose": "LiDARPoseComponent",
    "lidar_box": "LiDARBoxComponent",
}
"""Folders that a segment needs a file in, and what columns there begin with."""

SYNCED, SYNCED_COMPONENT = "lidar_camera_synced_box", "LiDARCameraSyncedBoxComponent"
"""Boxes at the cameras' instants: read where they are."""

TIME, CAMERA, LASER = "key.frame_timestamp_micros", "key.camera_name", "key.laser_name"
TRACK = "key.laser_object_id"
INTRINSIC = tuple(
    f"intrinsic.{name}" for name in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
)
BOX = ("center.x", "center.y", "center.z", "size.x", "size.y", "size.z", "heading")
LINEAR = tuple(f"velocity.linear_velocity.{axis}" for axis in "xyz")
ANGULAR = tuple(f"velocity.angular_velocity.{axis}" for axis in "xyz")
SHUTTER = ("shutter", "camera_trigger_time", "camera_readout_done_time")
EXPOSURE = ("pose_timestamp", *(f"rolling_shutter_params.{name}" for name in SHUTTER))
EXTRINSIC = "extrinsic.transform"
RETURNS = ("range_image_return1", "range_image_return2")


def table_files(folder: Path, name: str) -> list[Path]:
    """The files of a segment that are there."""
    paths = (folder / tag / f"{name}.parquet" for tag in (*COMPONENTS, SYNCED))
    return [path for path in paths if path.is_file()]


class Segment:
    """A segment of version 2 (see `segment.Segment`), which has no map and no zones without labels.

    Raises:
        GeoEvsError: a file is missing or damaged, of another segment, or names a sensor twice.
    """

    def __init__(self, folder: Path, name: str) -> None:
        for tag in COMPONENTS:
            path = folder / tag / f"{name}.parquet"
            if not path.is_file():
                raise GeoEvsError(
                    f"{path} is missing; download the component '{tag}' of the segment"
                )
        tables = {
            tag: Table(folder / tag / f"{name}.parquet", component, name)
            for tag, component in COMPONENTS.items()
        }
        self._images, self._sweeps = tables["camera_image"], tables["lidar"]
        self._pixel_poses = tables["lidar_pose"]
        self._poses = _rows_by_time(tables["vehicle_pose"])
        self._pose_table, self._box_table = tables["vehicle_pose"], tables["lidar_box"]
        self.where = str(self._pose_table.path)
        self.times = sorted(self._poses)
        if not self.times:
            raise GeoEvsError(f"{self.where} holds no frame; download it again")
        self.cameras = dict(_cameras(tables["camera_calibration"]))
        self.lasers = dict(_lasers(tables["lidar_calibration"]))
        self._image_rows = _rows_by_sensor(self._images, CAMERA, CAMERAS, "camera")
        self._sweep_rows = _rows_by_sensor(self._sweeps, LASER, LASERS, "LiDAR")
        self._pose_rows = _rows_by_sensor(self._pixel_poses, LASER, LASERS, "LiDAR")
        synced = folder / SYNCED / f"{name}.parquet"
        self._labels = _labels(
            self._box_table, Table(synced, SYNCED_COMPONENT, name) if synced.is_file() else None
        )
        self._transforms = self._pose_table.values("world_from_vehicle.transform")

    def labels(self, frame: int) -> FrameLabels:
        """The pose and boxes of a frame; no image or sweep is read."""
        time = self.times[frame]
        rows = self._poses[time]
        where = self._pose_table.where(rows[0])
        if len(rows) > 1:
            raise GeoEvsError(f"{where} and row {rows[1]} are of one frame; download it again")
        pose = _transform(
            self._transforms[rows[0]]["world_from_vehicle.transform"], "the vehicle's pose", where
        )
        labels = self._labels.get(time, [])
        return FrameLabels(pose, labels, [], np.zeros(3), f"{self._box_table.path}: frame {frame}")

    def sensors(self, frame: int) -> Sensors:
        """The images and sweeps of a frame, still encoded."""
        time = self.times[frame]
        fields = ("image", "pose.transform", *LINEAR, *ANGULAR, *EXPOSURE)
        rows = self._image_rows.get(time, {})
        images = {
            rows[row]: _image(cells, rows[row], self._images.where(row))
            for row, cells in self._images.rows(list(rows), *fields)
        }
        return Sensors(images, self._read_sweeps(time))

    def map_features(self) -> list[MapFeature]:
        """Nothing: version 2 has no map."""
        return []

    def _read_sweeps(self, time: int) -> Iterator[tuple[str, RangeImages]]:
        rows, pose_rows = self._sweep_rows.get(time, {}), self._pose_rows.get(time, {})
        poses = {
            pose_rows[row]: _matrix(cells, RETURNS[0], 6, self._pixel_poses.where(row))
            for row, cells in self._pixel_poses.rows(list(pose_rows), *_of_image(RETURNS[0]))
        }
        fields = [field for image in RETURNS for field in _of_image(image)]
        for row, cells in self._sweeps.rows(list(rows), *fields):
            where, name = self._sweeps.where(row), rows[row]
            first, second = (_matrix(cells, image, 4, where) for image in RETURNS)
            yield name, RangeImages(first, second, poses.get(name), where)


def _of_image(name: str) -> tuple[str, str]:
    """The fields of a range image."""
    return f"{name}.values", f"{name}.shape"


def _rows_by_time(table: Table) -> dict[int, list[int]]:
    rows = defaultdict(list)
    for row, time in enumerate(table.keys(TIME)):
        with readable(table.where(row)):
            rows[int(time)].append(row)
    return dict(rows)


def _rows_by_sensor(
    table: Table, key: str, names: Sequence[str], what: str
) -> dict[int, dict[int, str]]:
    """By time, the sensor of each row."""
    sensors = table.keys(key)
    by_time = {}
    for time, rows in _rows_by_time(table).items():
        by_time[time] = {row: _sensor(sensors[row], names, what, table.where(row)) for row in rows}
        _check_once(by_time[time], what, table)
    return by_time


def _check_once(names: Mapping[int, str], what: str, table: Table) -> None:
    seen: dict[str, int] = {}
    for row, name in names.items():
        if name in seen:
            raise GeoEvsError(
                f"{table.where(seen[name])} and row {row} are of one {what} '{name}' and one "
                "frame; download the file again"
            )
        seen[name] = row


def _sensor(value: Any, names: Sequence[str], what: str, where: str) -> str:
    """The name of a sensor that a key gives by its number, or by its name in capitals."""
    if isinstance(value, str) and value.lower() in names:
        return value.lower()
    with readable(where):
        return named(int(value), names, what, where)


def _cameras(table: Table) -> Iterator[tuple[str, CameraCalibration]]:
    keys = table.keys(CAMERA)
    names = {row: _sensor(key, CAMERAS, "camera", table.where(row)) for row, key in enumerate(keys)}
    _check_once(names, "camera", table)
    fields = (*INTRINSIC, EXTRINSIC, "width", "height", "rolling_shutter_direction")
    for row, cells in enumerate(table.values(*fields)):
        where = table.where(row)
        with readable(where):
            yield (
                names[row],
                CameraCalibration(
                    intrinsic=np.array([float(cells[field]) for field in INTRINSIC]),
                    extrinsic=_transform(
                        cells[EXTRINSIC], f"the extrinsic of camera '{names[row]}'", where
                    ),
                    width=int(cells["width"]),
                    height=int(cells["height"]),
                    readout=int(cells["rolling_shutter_direction"]),
                    where=where,
                ),
            )


def _lasers(table: Table) -> Iterator[tuple[str, LaserCalibration]]:
    keys = table.keys(LASER)
    names = {row: _sensor(key, LASERS, "LiDAR", table.where(row)) for row, key in enumerate(keys)}
    _check_once(names, "LiDAR", table)
    listed, low, high = (f"beam_inclination.{name}" for name in ("values", "min", "max"))
    for row, cells in enumerate(table.values(listed, low, high, EXTRINSIC)):
        where = table.where(row)
        with readable(where):
            yield (
                names[row],
                LaserCalibration(
                    inclinations=np.array(cells[listed] or [], np.float64),
                    low=float(cells[low]),
                    high=float(cells[high]),
                    extrinsic=_transform(
                        cells[EXTRINSIC], f"the extrinsic of LiDAR '{names[row]}'", where
                    ),
                    where=where,
                ),
            )


def _transform(values: Any, what: str, where: str) -> np.ndarray:
    with readable(where):
        return transform(np.asarray(values, np.float64), what, where)


def _image(cells: Mapping[str, Any], name: str, where: str) -> CameraImage:
    with readable(where):
        linear, angular = (
            np.array([float(cells[field]) for field in fields]) for fields in (LINEAR, ANGULAR)
        )
        pose_time, shutter, trigger, done = (float(cells[field]) for field in EXPOSURE)
        return CameraImage(
            jpeg=bytes(cells["image"]),
            pose=_transform(cells["pose.transform"], f"the pose of camera '{name}'", where),
            linear=linear,
            angular=angular,
            pose_time=pose_time,
            shutter=shutter,
            trigger=trigger,
            done=done,
            where=where,
        )


def _matrix(cells: Mapping[str, Any], image: str, channels: int, where: str) -> np.ndarray | None:
    """(H, W, channels) float32 of a range image; None where there is none."""
    values, shape = (cells[field] for field in _of_image(image))
    if values is None or not len(values):
        return None
    with readable(where):
        sides = [int(side) for side in shape]
        return shaped(np.asarray(values, np.float32), sides, channels, where)


def _labels(table: Table, synced_table: Table | None) -> dict[int, list[Label]]:
    """The boxes of all frames by their time; they are small."""
    synced = {} if synced_table is None else _synced(synced_table)
    times, tracks = table.keys(TIME), table.keys(TRACK)
    fields = (*(f"box.{field}" for field in BOX), "type", "speed.x", "speed.y")
    labels = defaultdict(list)
    for row, cells in enumerate(table.values(*fields)):
        where = table.where(row)
        with readable(where):
            time, track = int(times[row]), clean(str(tracks[row]), 100)
            camera, box = synced.get((time, track), (0, None))
            labels[time].append(
                Label(
                    track=track,
                    kind=int(cells["type"]),
                    box=[float(cells[f"box.{field}"]) for field in BOX],
                    speed=(float(cells["speed.x"] or 0), float(cells["speed.y"] or 0)),
                    camera=camera,
                    synced=box,
                )
            )
    return dict(labels)


def _synced(table: Table) -> dict[tuple[int, str], tuple[int, list[float]]]:
    """The camera, counted from 1, and the box at its instant, by time and track."""
    times, tracks = table.keys(TIME), table.keys(TRACK)
    fields = ("most_visible_camera_name", *(f"camera_synced_box.{field}" for field in BOX))
    synced = {}
    for row, cells in enumerate(table.values(*fields)):
        where = table.where(row)
        with readable(where):
            key = int(times[row]), clean(str(tracks[row]), 100)
            camera = _sensor(cells[fields[0]], CAMERAS, "camera", where)
            box = [float(cells[field]) for field in fields[1:]]
            synced[key] = CAMERAS.index(camera) + 1, box
    return synced
