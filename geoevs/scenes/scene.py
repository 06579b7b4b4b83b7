"""What a data source hands over: frames of camera images and LiDAR points, boxes, and a rig."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.plugins import find_plugins, load_plugin, one_sentence
from geoevs.core.settings import check_options
from geoevs.core.stamps import Stamp
from geoevs.scenes.camera import Camera
from geoevs.scenes.road_map import RoadMap

LIDAR_SPLITS = ("sensor", "beam")
MOST_CAMERAS = 127
"""Cameras of a scene at most, as a point's `camera` is an int8."""

NEAR = 1000.0
"""Metres from the world's origin up to which a scene keeps its coordinates: float32 holds them to
0.06 mm."""

SOURCE_GROUP = "geoevs.sources"
"""Entry points by which installed packages offer data sources."""

TRACK_COLUMNS = (
    "frame",
    "track",
    "label",
    "x",
    "y",
    "z",
    "length",
    "width",
    "height",
    "yaw",
    "moving",
)


@dataclass(frozen=True)
class PointCloud:
    """LiDAR points of one frame, in the world.

    Args:
        xyz: positions in metres.
        rgb: colours in [0, 1]; zero where `camera` is -1.
        camera: index into the scene's cameras of the image that gave the colour, or -1 for none.
        sensor: which LiDAR of the rig measured the point.
        beam: the laser of that LiDAR, counted from the top; 0 where the data do not say.
    """

    xyz: np.ndarray  # [N, 3] float32
    rgb: np.ndarray  # [N, 3] float32
    camera: np.ndarray  # [N] int8
    sensor: np.ndarray  # [N] uint8
    beam: np.ndarray  # [N] uint16

    @classmethod
    def uncoloured(cls, xyz: np.ndarray, sensor: np.ndarray, beam: np.ndarray) -> "PointCloud":
        """Points that no camera has coloured yet, in the store's number types."""
        return cls(
            xyz=np.ascontiguousarray(xyz, np.float32),
            rgb=np.zeros((len(xyz), 3), np.float32),
            camera=np.full(len(xyz), -1, np.int8),
            sensor=np.asarray(sensor, np.uint8),
            beam=np.asarray(beam, np.uint16),
        )

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, keep: np.ndarray) -> "PointCloud":
        """The points that a boolean mask or an index array picks, in order."""
        return PointCloud(
            self.xyz[keep], self.rgb[keep], self.camera[keep], self.sensor[keep], self.beam[keep]
        )


class Exposure(NamedTuple):
    """When a camera took an image, in the seconds of its frame's timestamp.

    `time` is the instant of the camera's pose; a rolling shutter reads its first column or row
    at `start` and its last one at `end`.
    """

    time: float
    start: float
    end: float


@dataclass(frozen=True)
class Frame:
    """One instant as a source gives it: every camera's image, and the LiDAR sweep.

    `cameras` and `images` share their keys, the camera names, in the rig's order; images are
    (H, W, 3) uint8 at the run's resolution, free of lens distortion. `depths` is dense truth of
    the same views, (H, W) float32 metres with 0 = none, where the source knows it; it is kept
    apart from the scene store, out of every method's sight. `exposures` says when each camera took
    its image, where the source knows that it was not at `timestamp`.
    """

    frame: int
    timestamp: float
    cameras: dict[str, Camera]
    images: dict[str, np.ndarray]
    points: PointCloud
    depths: dict[str, np.ndarray] = field(default_factory=dict)
    exposures: dict[str, Exposure] = field(default_factory=dict)


@dataclass(frozen=True)
class Rig:
    """The roles that the protocol needs, and how the LiDAR is split without leaks.

    Args:
        front, front_left, front_right: camera names.
        lidar_split: `sensor` (sensor 0 scores, the others condition methods) or `beam`
            (odd beams score, even beams condition).
    """

    front: str
    front_left: str
    front_right: str
    lidar_split: str

    def __post_init__(self) -> None:
        if self.lidar_split not in LIDAR_SPLITS:
            hint = did_you_mean(str(self.lidar_split), LIDAR_SPLITS)
            raise GeoEvsError(f"there is no lidar_split '{self.lidar_split}'; {hint}")

    def scores(self, points: PointCloud) -> np.ndarray:
        """(N,) bool: points that may score a method; the others may condition it, never both."""
        if self.lidar_split == "sensor":
            return points.sensor == 0
        return points.beam % 2 == 1


@dataclass(frozen=True)
class SceneInfo:
    """A scene's name, source, licence, rig and cameras.

    `origin` is what was subtracted from its source's coordinates, in metres (see `scene_origin`);
    `made_with` tells the settings and the data of the store. `redistribute` is whether the licence
    lets anybody hand on the pictures. `box_delay` is seconds from a frame's timestamp to the
    instant of its boxes. `tags` are what a prompt would say of all its pictures, such as `junction`
    or `overcast`.
    """

    name: str
    source: str
    licence: str
    rig: Rig
    cameras: tuple[str, ...]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    made_with: Stamp = field(default_factory=dict)
    redistribute: bool = False
    box_delay: float = 0.0
    tags: tuple[str, ...] = ()


@dataclass(frozen=True)
class SceneExtras:
    """What only some sources know.

    Args:
        ego_masks: (H, W) bool by camera: the pixels where it sees the car that carries it, in every
            frame. They count in no score, condition or colouring.
        road_map: the ground around the scene.
        no_label_zones: by frame, polygons (N, 2) float64 metres of the world's ground plane in
            which nobody drew boxes.
        synced_tracks: boxes with TRACK_COLUMNS and `camera`, at the instant of that camera's image.
    """

    ego_masks: Mapping[str, np.ndarray] = field(default_factory=dict)
    road_map: RoadMap | None = None
    no_label_zones: Mapping[int, Sequence[np.ndarray]] = field(default_factory=dict)
    synced_tracks: pd.DataFrame | None = None


NO_EXTRAS = SceneExtras()


@dataclass(frozen=True)
class SceneRecord:
    """A scene as a source gives it: read `frames` once, one frame in memory at a time.

    `tracks` has TRACK_COLUMNS: box centres and sizes in metres, yaw in degrees about world z,
    `length` along the heading, `moving` true for a track that moves during the scene. From its
    positions, and those of the frames, `info.origin` is subtracted, in float64.
    """

    info: SceneInfo
    tracks: pd.DataFrame
    frames: Iterator[Frame]
    frame_count: int
    extras: SceneExtras = NO_EXTRAS


def scene_origin(place: np.ndarray) -> tuple[float, float, float]:
    """What a source subtracts from its coordinates, so that float32 holds them.

    Args:
        place: (3,) metres, where the scene begins.

    Returns:
        Zeros near the world's origin, whose scenes keep their coordinates; else whole metres, so
        that adding them again is exact.

    >>> scene_origin(np.array([9.4, -9.3, 1.8]))
    (0.0, 0.0, 0.0)
    >>> scene_origin(np.array([500009.4, 4649785.7, 221.8]))
    (500009.0, 4649786.0, 222.0)
    """
    if np.abs(place).max() <= NEAR:
        return (0.0, 0.0, 0.0)
    x, y, z = np.rint(place).tolist()
    return (x, y, z)


class Truth(NamedTuple):
    """Dense truth at a pose that no camera recorded."""

    rgb: np.ndarray  # [H, W, 3] uint8
    depth: np.ndarray  # [H, W] float32 metres along the optical axis, 0 = none


class SceneSource(Protocol):
    """A kind of driving data: the class `Source` in `geoevs/scenes/sources/<name>/source.py`.

    Its options are keyword arguments; they come from the run's config.
    """

    has_truth: bool

    def __init__(self, height: int, width: int, **options: Any) -> None: ...

    def check(self, scene: "SceneRef") -> None:
        """Refuse a scene, or a range of frames, that its options rule out; no data are looked at.

        Raises:
            GeoEvsError: there can be no such scene.
        """
        ...

    def files(self, scene: "SceneRef") -> Iterable[Path]:
        """The files and folders that a scene is read from; none where it is made.

        They are only listed, so that a change of one is noticed; nothing need be there.
        """
        ...

    def open(self, scene: "SceneRef") -> SceneRecord:
        """Open a scene; its frames are read or rendered as they are iterated."""
        ...

    def truth(self, scene: "SceneRef", views: Sequence[tuple[Camera, int]]) -> Iterable[Truth]:
        """Dense truth for (camera, frame) pairs, in order; only where `has_truth`."""
        ...


class SceneRef(NamedTuple):
    """A scene and, optionally, a range of its frames: `002` or `002@59-70` in the config."""

    name: str
    first: int | None = None
    last: int | None = None

    @classmethod
    def parse(cls, text: str) -> "SceneRef":
        """Read `NAME` or `NAME@FIRST-LAST` (both ends included).

        Raises:
            GeoEvsError: the text is of neither form; names have letters, digits and `_ . -`, so
                that none leaves its folder or needs quotes, frames at most six digits.
        """
        match = re.fullmatch(r"([a-zA-Z0-9_][a-zA-Z0-9_.-]*)(?:@([0-9]{1,6})-([0-9]{1,6}))?", text)
        if match is not None:
            name, first, last = match.groups()
            if first is None:
                return cls(name)
            if int(first) <= int(last):
                return cls(name, int(first), int(last))
        raise GeoEvsError(
            f"scene '{text}' is not of the form NAME or NAME@FIRST-LAST, such as 002@59-70"
        )

    def holds(self, frame: int) -> bool:
        """Whether the range, if there is one, includes `frame`."""
        return self.first is None or self.last is None or self.first <= frame <= self.last

    def overlaps(self, other: "SceneRef") -> bool:
        """Whether the two share a frame of the same scene."""
        if self.name != other.name:
            return False
        if self.first is None or self.last is None or other.first is None or other.last is None:
            return True
        return self.first <= other.last and other.first <= self.last


def find_sources() -> dict[str, str]:
    """Every data source's name and module, those of installed packages among them."""
    return find_plugins("source", SOURCE_GROUP, "geoevs.scenes.sources")


def source_class(name: str) -> type[SceneSource]:
    """The class of the data source called `name`.

    Raises:
        GeoEvsError: there is none; the sentence names the nearest one.
    """
    sources = find_sources()
    with one_sentence(sources.get(name, "").replace(".", "/") + ".py"):
        return load_plugin("data source", name, sources, "Source")


def load_source(name: str, height: int, width: int, options: dict[str, Any]) -> SceneSource:
    """Make the data source called `name` for one resolution.

    Raises:
        GeoEvsError: no such source, or an option that it does not have.
    """
    source = source_class(name)
    check_options(f"data source '{name}'", source, options, positional=2)
    return source(height, width, **options)
