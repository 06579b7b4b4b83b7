"""What both versions of the data set give of a segment, in the data's own axes and numbers.

A segment is 20 seconds of driving. Transforms are (4, 4) float64. The vehicle's axes are x forward,
y left, z up; `world` is the data's global frame, whose origin may be tens of kilometres away.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import is_rigid

CAMERAS = ("front", "front_left", "front_right", "side_left", "side_right")
"""The cameras, numbered from 1 in the data."""

LASERS = ("top", "front", "side_left", "side_right", "rear")
"""The LiDARs, numbered from 1 in the data."""

LABELS = ("unknown", "vehicle", "pedestrian", "sign", "cyclist")
"""What boxes hold, numbered from 0 in the data."""

FARTHEST = 1e6
"""Metres of a transform at most: beyond, the float32 of the LiDAR's poses steps by centimetres."""


class CameraCalibration(NamedTuple):
    """A camera: `intrinsic` is f_u, f_v, c_u, c_v, k1, k2, p1, p2, k3.

    `extrinsic` is vehicle from camera, whose axes are x forward, y left, z up; `readout` is the
    direction of its rolling shutter (see `camera.READOUTS`), `where` the calibration stands.
    """

    intrinsic: np.ndarray  # [9] float64
    extrinsic: np.ndarray
    width: int
    height: int
    readout: int
    where: str


class LaserCalibration(NamedTuple):
    """A LiDAR: elevations of its beams in radians, bottom up, or the range that they fill evenly.

    `extrinsic` is vehicle from LiDAR, `where` the calibration stands.
    """

    inclinations: np.ndarray  # [N] float64, N = 0 for even ones
    low: float
    high: float
    extrinsic: np.ndarray
    where: str


class CameraImage(NamedTuple):
    """An image: its JPEG, the vehicle's pose and velocity at `pose_time`, and its exposure.

    `linear` is in m/s in the world, `angular` in rad/s about the vehicle's own axes. Seconds since
    1970: the shutter opens at `trigger` and the last line is read at `done`; each line is exposed
    for `shutter` seconds.
    """

    jpeg: bytes
    pose: np.ndarray
    linear: np.ndarray  # [3]
    angular: np.ndarray  # [3]
    pose_time: float
    shutter: float
    trigger: float
    done: float
    where: str


class RangeImages(NamedTuple):
    """A LiDAR's sweep: metres in channel 0 of `first` and `second`, the second returns.

    `poses` is roll, pitch, yaw, x, y, z of the vehicle in the world for each pixel, where known.
    """

    first: np.ndarray | None  # [H, W, 4] float32
    second: np.ndarray | None  # [H, W, 4] float32
    poses: np.ndarray | None  # [H, W, 6] float32
    where: str


class Label(NamedTuple):
    """A box: x, y, z, length, width, height in metres and heading in radians, in the vehicle.

    `kind` is an index into LABELS; `speed` is along the world's x and y in m/s. `synced` is the box
    at the instant of `camera`, a number from 1, or None.
    """

    track: str
    kind: int
    box: Sequence[float]
    speed: tuple[float, float]
    camera: int
    synced: Sequence[float] | None


class FrameLabels(NamedTuple):
    """The vehicle's pose of a frame and what was drawn in it.

    `zones` are polygons (N, 2) of the world's ground plane without boxes. `map_offset` is what
    takes this frame's points to the map, in metres.
    """

    pose: np.ndarray
    labels: list[Label]
    zones: list[np.ndarray]
    map_offset: np.ndarray  # [3]
    where: str


class MapFeature(NamedTuple):
    """A piece of Waymo's map: its kind, as map.proto calls it, and (N, 3) float64 metres."""

    kind: str
    points: np.ndarray


class Sensors(NamedTuple):
    """What a frame's cameras and LiDARs recorded, by CAMERAS and LASERS.

    `sweeps` are read as they are iterated, so that one is in memory at a time.
    """

    images: dict[str, CameraImage]
    sweeps: Iterator[tuple[str, RangeImages]]


class Segment(Protocol):
    """A segment opened for reading; its frames are counted from 0 in the order of time.

    `times` are their timestamps in microseconds, `where` is what sentences call the segment.
    """

    where: str
    times: list[int]
    cameras: dict[str, CameraCalibration]
    lasers: dict[str, LaserCalibration]

    def labels(self, frame: int) -> FrameLabels:
        """The pose and boxes of a frame; no image or sweep is read."""
        ...

    def sensors(self, frame: int) -> Sensors:
        """The images and sweeps of a frame, still encoded."""
        ...

    def map_features(self) -> list[MapFeature]:
        """The pieces of the map that `road_map` takes; empty where there is none."""
        ...


def transform(values: np.ndarray, what: str, where: str) -> np.ndarray:
    """(4, 4) float64 of 16 numbers, row by row.

    Args:
        values: as they stand in the data.
        what: they are, for errors.
        where: they stand.

    Raises:
        GeoEvsError: they are not 16 finite numbers of a rigid transform, or beyond FARTHEST.
    """
    if len(values) != 16 or not np.isfinite(values).all():
        raise GeoEvsError(f"{where}: {what} is not 16 finite numbers; download the file again")
    matrix = np.asarray(values, np.float64).reshape(4, 4)
    if np.abs(matrix[:3, 3]).max() > FARTHEST:
        far = np.abs(matrix[:3, 3]).max()
        raise GeoEvsError(
            f"{where}: {what} lies {far:g} m from the world's origin, and no Waymo one beyond "
            f"{FARTHEST:g}; download the file again"
        )
    if not is_rigid(matrix):
        raise GeoEvsError(f"{where}: {what} is no rigid transform; download the file again")
    return matrix


def named(number: int, names: Sequence[str], what: str, where: str) -> str:
    """The name of a camera or LiDAR that the data number from 1.

    Raises:
        GeoEvsError: there is none of that number.
    """
    if not 1 <= number <= len(names):
        raise GeoEvsError(
            f"{where}: there is no {what} {number}, only 1 to {len(names)} ({', '.join(names)}); "
            "download the file again"
        )
    return names[number - 1]
