"""Version 1 of the data set: one TFRecord file a segment, one protocol buffer a frame.

Field numbers are those of Waymo's dataset.proto, label.proto and map.proto.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.protobuf import BYTES, VARINT, Message, damaged
from geoevs.core.text import clean
from geoevs.scenes.sources.waymo.matrices import read_matrix
from geoevs.scenes.sources.waymo.records import (
    Part,
    Record,
    find_records,
    first_record,
    opened,
    read_bytes,
    read_record,
    scan,
)
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

CONTEXT, TIME, POSE, IMAGES, SWEEPS, BOXES, ZONES, MAP, OFFSET = 1, 2, 3, 4, 5, 6, 7, 10, 11
"""Fields of a frame."""

CONTEXT_NAME = 1
DRAWN = (POSE, BOXES, ZONES, OFFSET)
"""Fields of a frame that are neither images nor sweeps."""

MAP_KINDS = {3: ("lane", 8), 4: ("road_line", 2), 8: ("crosswalk", 1), 10: ("driveway", 1)}
"""Of a map feature's fields: its kind, and the field of its points. Road edges, speed bumps and
stop signs say nothing of what the ground is."""

LANE_TYPE, BICYCLES = 2, 3
"""The field of a lane's type, and the type of lanes that no car drives on."""


def context_name(path: Path) -> str:
    """The segment that a file's first record belongs to; little more than the name is read.

    Raises:
        GeoEvsError: the file is missing or damaged, or its record names none.
    """
    state = path.stat() if path.exists() else None
    return _context_name(path, state and (state.st_size, state.st_mtime_ns))


@lru_cache(maxsize=10_000)
def _context_name(path: Path, _state: object) -> str:
    record = first_record(path)
    with opened(path) as file:
        return _context_and_time(file, record, {CONTEXT})[0]


def _context_and_time(file: BinaryIO, record: Record, wanted: set[int]) -> tuple[str, int]:
    """A record's segment and its timestamp in microseconds; no further read than is wanted."""
    name, time, missing = "", 0, set(wanted)
    for part in scan(file, record):
        if part.number == CONTEXT and part.kind == BYTES:
            inner = (p for p in scan(file, record, part) if p.number == CONTEXT_NAME)
            for found in inner:
                if found.kind == BYTES:
                    name = _text(file, record, found)
                break
        elif part.number == TIME and part.kind == VARINT:
            time = part.size
        missing.discard(part.number)
        if not missing:
            return name, time
    raise damaged(record.where, "it has no context, or no time")


def _text(file: BinaryIO, record: Record, part: Part) -> str:
    data = read_bytes(file, record, part.start, part.size)
    return bytes(data[:1000]).decode("utf-8", "replace")


class Segment:
    """A segment of version 1 (see `segment.Segment`); record N of its file is mostly frame N.

    Raises:
        GeoEvsError: the file is damaged, a record is of another segment, or two have one time.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.where = str(path)
        timed: list[tuple[int, Record]] = []
        with opened(path) as file:
            for record in find_records(path):
                found, time = _context_and_time(file, record, {CONTEXT, TIME})
                if found != name:
                    raise GeoEvsError(
                        f"{record.where} is of segment '{clean(found, 60)}', not of '{name}'; keep "
                        "one segment in a file"
                    )
                timed.append((time, record))
        timed.sort(key=lambda pair: pair[0])
        for (time, record), (later, other) in pairwise(timed):
            if time == later:
                raise GeoEvsError(
                    f"{path}: records {record.number} and {other.number} have the same time; "
                    "download it again"
                )
        self.times = [time for time, _ in timed]
        self._records = [record for _, record in timed]
        first = self._records[0]
        context = _fields(first, CONTEXT).message(CONTEXT)
        self.cameras: dict[str, CameraCalibration] = {}
        for message in context.messages(2):
            camera = named(message.whole(1), CAMERAS, "camera", first.where)
            self.cameras[camera] = _camera(message, camera)
        self.lasers: dict[str, LaserCalibration] = {}
        for message in context.messages(3):
            laser = named(message.whole(1), LASERS, "LiDAR", first.where)
            self.lasers[laser] = _laser(message, laser)

    def labels(self, frame: int) -> FrameLabels:
        """The pose and boxes of a frame; no image or sweep is read."""
        record = self._records[frame]
        message = _fields(record, *DRAWN)
        labels = [_label(label) for label in message.messages(BOXES) if 1 in label.fields]
        offset = message.message(OFFSET)
        return FrameLabels(
            _transform(message, POSE, "the vehicle's pose"),
            labels,
            [_zone(polygon) for polygon in message.messages(ZONES)],
            np.array([offset.double(axis) for axis in (1, 2, 3)]),
            record.where,
        )

    def sensors(self, frame: int) -> Sensors:
        """The images and sweeps of a frame, still encoded."""
        record = self._records[frame]
        message = Message(read_record(record), record.where)
        images: dict[str, CameraImage] = {}
        for image in message.messages(IMAGES):
            name = named(image.whole(1), CAMERAS, "camera", record.where)
            if name in images:
                raise damaged(record.where, f"it has two images of camera '{name}'")
            images[name] = _image(image, name)
        return Sensors(images, _sweeps(message))

    def map_features(self) -> list[MapFeature]:
        """The road map in the world, which stands in a segment's first frame alone."""
        message = _fields(self._records[0], MAP)
        features = (_map_feature(feature) for feature in message.messages(MAP))
        return [feature for feature in features if feature is not None]


def _fields(record: Record, *numbers: int) -> Message:
    """A record's message with some of its fields, the others skipped unread."""
    message = Message(b"", record.where)
    with opened(record.path) as file:
        for part in scan(file, record):
            if part.number in numbers and part.kind == BYTES:
                chunk = read_bytes(file, record, part.start, part.size)
                message.fields.setdefault(part.number, []).append(chunk)
    return message


def _transform(message: Message, number: int, what: str) -> np.ndarray:
    return transform(message.message(number).doubles(1), what, message.where)


def _camera(message: Message, name: str) -> CameraCalibration:
    return CameraCalibration(
        intrinsic=message.doubles(2),
        extrinsic=_transform(message, 3, f"the extrinsic of camera '{name}'"),
        width=message.whole(4),
        height=message.whole(5),
        readout=message.whole(6),
        where=message.where,
    )


def _laser(message: Message, name: str) -> LaserCalibration:
    return LaserCalibration(
        inclinations=message.doubles(2),
        low=message.double(3),
        high=message.double(4),
        extrinsic=_transform(message, 5, f"the extrinsic of LiDAR '{name}'"),
        where=message.where,
    )


def _image(message: Message, name: str) -> CameraImage:
    velocity = message.message(4)
    return CameraImage(
        jpeg=bytes(message.chunk(2)),
        pose=_transform(message, 3, f"the pose of camera '{name}'"),
        linear=np.array([velocity.float(axis) for axis in (1, 2, 3)]),
        angular=np.array([velocity.double(axis) for axis in (4, 5, 6)]),
        pose_time=message.double(5),
        shutter=message.double(6),
        trigger=message.double(7),
        done=message.double(8),
        where=message.where,
    )


def _sweeps(frame: Message) -> Iterator[tuple[str, RangeImages]]:
    seen = set()
    for message in frame.messages(SWEEPS):
        first, second = message.message(2), message.message(3)
        if not (first.fields or second.fields):
            continue
        name = named(message.whole(1), LASERS, "LiDAR", frame.where)
        if name in seen:
            raise damaged(frame.where, f"it has two sweeps of LiDAR '{name}'")
        seen.add(name)
        yield (
            name,
            RangeImages(
                read_matrix(first, 2, 4),
                read_matrix(second, 2, 4),
                read_matrix(first, 4, 6),
                frame.where,
            ),
        )


def _label(message: Message) -> Label:
    camera = message.text(11).lower()
    if camera and camera not in CAMERAS:
        raise GeoEvsError(
            f"{message.where}: a box names camera '{clean(camera, 40)}'; "
            f"{did_you_mean(camera, CAMERAS)}"
        )
    speed = message.message(2)
    return Label(
        track=message.text(4),
        kind=message.whole(3),
        box=_box(message.message(1)),
        speed=(speed.double(1), speed.double(2)),
        camera=CAMERAS.index(camera) + 1 if camera else 0,
        synced=_box(message.message(12)) if 12 in message.fields else None,
    )


def _box(message: Message) -> list[float]:
    # Width is field 4, before length.
    return [message.double(number) for number in (1, 2, 3, 5, 4, 6, 7)]


def _zone(message: Message) -> np.ndarray:
    x, y = message.doubles(1), message.doubles(2)
    if len(x) != len(y) or not len(x):
        raise damaged(message.where, "a zone without labels is no polygon")
    return np.stack([x, y], axis=1)


def _map_feature(message: Message) -> MapFeature | None:
    """A feature of the map; None of one that is no ground for cars or their drivers."""
    for number, (kind, points) in MAP_KINDS.items():
        if number in message.fields:
            feature = message.message(number)
            if kind == "lane" and feature.whole(LANE_TYPE) == BICYCLES:
                return None
            corners = feature.messages(points)
            xyz = np.array([[point.double(axis) for axis in (1, 2, 3)] for point in corners])
            return MapFeature(kind, xyz) if len(xyz) else None
    return None
