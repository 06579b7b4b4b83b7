"""What cannot be true of a scene: each rule once, for those who read it and those who write it."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.core.names import check_name
from geoevs.core.text import clean
from geoevs.scenes.camera import WORLD_LIMIT, Camera
from geoevs.scenes.scene import (
    MOST_CAMERAS,
    TRACK_COLUMNS,
    Exposure,
    PointCloud,
    Rig,
    SceneInfo,
)
from geoevs.scenes.virtual import yaw_gap

LAST_FRAME = 999_999
"""Files of frames have six digits."""

LONGEST_TAG = 100
"""Characters of a tag at most."""

LONGEST_BOX = 100.0
"""Metres of a box's side at most; the longest thing on a street is a tram."""

LARGEST_RIG = 100.0
"""Metres from a camera to the first one at most: one vehicle carries them all."""

UPRIGHT = 0.5
"""Cosine of the angle between world z and the mean up axis of a frame's cameras, at least."""

WRONG_SIDE = 10.0
"""Degrees by which a camera that is called left may look right: a stereo pair's may, a little."""

POINTS = {
    "xyz": (-WORLD_LIMIT, WORLD_LIMIT, np.float32, (3,)),
    "rgb": (0, 1, np.float32, (3,)),
    "camera": (-1, MOST_CAMERAS - 1, np.int8, ()),
    "sensor": (0, 255, np.uint8, ()),
    "beam": (0, 65535, np.uint16, ()),
}
"""Of each field of a PointCloud: its range, its type, and its shape after the first axis."""

Where = Path | str
"""What a sentence begins with: a file, or a scene and its frame."""


def number(value: Any, what: str, where: Where) -> float:
    """A finite number as it stands in a file.

    Raises:
        GeoEvsError: it is text, a truth value, NaN, infinite or too large for a float.
    """
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    try:
        if plain and math.isfinite(value):
            return float(value)
    except OverflowError:  # a whole number of hundreds of digits
        pass
    raise GeoEvsError(f"{where}: {what} is {_shown(value)}, no finite number; correct it")


def frame_number(value: Any, where: Where) -> int:
    """A frame's number as it stands in a file.

    Raises:
        GeoEvsError: it is no whole number from 0 to LAST_FRAME.
    """
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not (whole and 0 <= value <= LAST_FRAME):
        raise GeoEvsError(
            f"{where}: frame {_shown(value)} is no whole number from 0 to {LAST_FRAME}; renumber it"
        )
    return int(value)


def timestamp(value: Any, where: Where, last: float = -math.inf) -> float:
    """The seconds of a frame as they stand in a file.

    Args:
        value: what stands there.
        where: it stands, for errors.
        last: seconds of the frame before.

    Raises:
        GeoEvsError: it is no finite number of 0 or more, or not after `last`.
    """
    seconds = number(value, "the timestamp", where)
    if seconds < 0:
        raise GeoEvsError(f"{where}: the timestamp is {seconds:g}; count seconds from 0 upwards")
    if seconds <= last:
        raise GeoEvsError(
            f"{where}: the timestamp is {seconds:.6f}, but the frame before has {last:.6f}; number "
            "the frames in the order of their time"
        )
    return seconds


def check_exposure(value: Any, where: Where) -> Exposure:
    """When a camera took an image, as it stands in a file.

    Raises:
        GeoEvsError: it is not three numbers (see Exposure), or their order is impossible.
    """
    if not isinstance(value, (list, tuple)) or len(value) != len(Exposure._fields):
        raise GeoEvsError(f"{where}: the exposure is no list of time, start and end; correct it")
    exposure = Exposure(*(number(seconds, "the exposure", where) for seconds in value))
    if not exposure.start <= exposure.time <= exposure.end:
        raise GeoEvsError(
            f"{where}: the exposure's time {exposure.time:.6f} does not lie from its start "
            f"{exposure.start:.6f} to its end {exposure.end:.6f}; correct it"
        )
    return exposure


def check_info(info: SceneInfo, where: Where) -> None:
    """Check a scene's description.

    Raises:
        GeoEvsError: a name that is no path's part, a camera named twice, none or too many cameras,
            an origin that is no place, or a tag that is no text.
    """
    check_name(info.name, "scene", where)
    for role in fields(Rig)[:3]:
        check_name(getattr(info.rig, role.name), f"{role.name} of the rig", where)
    for name in info.cameras:
        check_name(name, "camera", where)
    for what in ("source", "licence"):
        if not isinstance(getattr(info, what), str):
            raise GeoEvsError(f"{where}: the {what} is no text; write it in quotes")
    if len(set(info.cameras)) < len(info.cameras):
        raise GeoEvsError(f"{where}: a camera is listed twice; name each once")
    if not 0 < len(info.cameras) <= MOST_CAMERAS:
        raise GeoEvsError(
            f"{where}: the scene has {len(info.cameras)} cameras; a scene has 1 to {MOST_CAMERAS}"
        )
    if len(info.origin) != 3:
        raise GeoEvsError(f"{where}: the origin is no list of three metres; correct it")
    for metres in info.origin:
        number(metres, "the origin", where)
    number(info.box_delay, "box_delay", where)
    for tag in info.tags:
        if not isinstance(tag, str) or not tag or tag != clean(tag, LONGEST_TAG):
            raise GeoEvsError(
                f"{where}: the tag {_shown(tag)} is no text of 1 to {LONGEST_TAG} characters in a "
                "line; correct it"
            )
    if not isinstance(info.redistribute, bool):
        raise GeoEvsError(f"{where}: 'redistribute' is neither true nor false; correct it")


def check_rig(rig: Rig, cameras: Mapping[str, Camera], where: Where) -> None:
    """Check the cameras of one frame against each other, the world and their names.

    Raises:
        GeoEvsError: z is not up, two cameras have one pose, one stands far from the vehicle, or
            one looks to the side that it is not called after.
    """
    _check_up(cameras, where)
    for (name, camera), (other, beside) in combinations(cameras.items(), 2):
        if np.array_equal(camera.world_from_camera, beside.world_from_camera):
            raise GeoEvsError(
                f"{where}: cameras '{name}' and '{other}' have the same pose; give each its own"
            )
    first = next(iter(cameras.values()))
    for name, camera in cameras.items():
        away = float(np.linalg.norm(camera.centre - first.centre))
        if away > LARGEST_RIG:
            raise GeoEvsError(
                f"{where}: camera '{name}' is {away:.0f} m from camera '{first.name}', further "
                "than one vehicle reaches; correct its pose"
            )
    _check_sides(rig, cameras, where)


def _check_up(cameras: Mapping[str, Camera], where: Where) -> None:
    up = -np.mean([camera.world_from_camera[:3, 1] for camera in cameras.values()], axis=0)
    if up[2] < UPRIGHT * np.linalg.norm(up):
        axis = int(np.argmax(np.abs(up)))
        sign = "-" if up[axis] < 0 else ""
        raise GeoEvsError(
            f"{where}: the world's z is not up, for the cameras' upward axes point along "
            f"{sign}{'xyz'[axis]}; turn poses, points and boxes until z is up (worlds of OpenGL "
            "and nerfstudio often have y up; in transforms.json a camera's own y is up, its z "
            "backward)"
        )


def _check_sides(rig: Rig, cameras: Mapping[str, Camera], where: Where) -> None:
    front = cameras.get(rig.front)
    for name, camera in cameras.items():
        if front is None or name == rig.front:
            continue
        side = _side_of(rig, name)
        gap = side * yaw_gap(front, camera)
        role = name in (rig.front_left, rig.front_right)
        wrong = gap <= 0 if role else -180 + WRONG_SIDE < gap < -WRONG_SIDE
        if side and wrong:
            called, looks = ("left", "right") if side > 0 else ("right", "left")
            raise GeoEvsError(
                f"{where}: camera '{name}' is the {called} one but looks {abs(gap):.0f} degrees "
                f"to the {looks} of '{rig.front}'; its pose or its name is another camera's"
            )


def _side_of(rig: Rig, name: str) -> int:
    """1 for a camera of the left, -1 of the right, 0 for one that does not say so."""
    if name in (rig.front_left, rig.front_right):
        return 1 if name == rig.front_left else -1
    words = name.lower().replace("-", "_").replace(".", "_").split("_")
    return ("left" in words) - ("right" in words)


def checked_points(points: PointCloud, cameras: int, where: Where) -> PointCloud:
    """The points of a frame, in the store's number types.

    Args:
        points: as they were read or made.
        cameras: how many the scene has.
        where: they stand, for errors.

    Raises:
        GeoEvsError: a field of another shape, type or range, NaN among them; or a colour from a
            camera that the scene does not have.
    """
    arrays = {}
    count = len(points.xyz) if np.ndim(points.xyz) else 0
    for name, (low, high, dtype, shape) in POINTS.items():
        array = np.asarray(getattr(points, name))
        kinds = "iuf" if dtype is np.float32 else "iu"
        if array.shape != (count, *shape) or array.dtype.kind not in kinds:
            raise GeoEvsError(
                f"{where}: '{name}' of the LiDAR points is {array.dtype} of shape {array.shape}; "
                f"give {np.dtype(dtype)} of shape {(count, *shape)}"
            )
        good = (array >= low) & (array <= (cameras - 1 if name == "camera" else high))
        if not good.all():  # NaN is not good either
            bad = count - int(good.reshape(count, -1).all(axis=1).sum())
            raise GeoEvsError(
                f"{where}: {bad} of {count} LiDAR points are {_fault(name)}; correct or drop them"
            )
        arrays[name] = array.astype(dtype, copy=False)
    return PointCloud(**arrays)


def _fault(name: str) -> str:
    if name == "xyz":
        far = f"more than {WORLD_LIMIT / 1000:g} km from the origin"
        return f"NaN or infinite, or {far}, where float32 loses millimetres (subtract an origin)"
    if name == "camera":
        return "coloured by a camera that the scene does not have (-1 is none)"
    low, high, *_ = POINTS[name]
    return f"of a '{name}' that is not within {low:g} and {high:g}"


def check_depth(depth: np.ndarray, where: Where) -> None:
    """Check a depth map.

    Raises:
        GeoEvsError: it is no (H, W) of floats, or has NaN, infinite or negative metres.
    """
    if depth.ndim != 2 or depth.dtype.kind != "f" or not ((depth >= 0) & (depth < np.inf)).all():
        raise GeoEvsError(f"{where} is no map of finite metres, 0 or more; make it again")


def check_sensors(rig: Rig, points: PointCloud, where: Where) -> None:
    """Check that a frame's LiDAR can score methods and can condition them.

    Raises:
        GeoEvsError: there are no points of the one or the other, or no image gave a scoring point
            its colour.
    """
    scores = rig.scores(points)
    one, other = ("sensor 0", "another sensor") if rig.lidar_split == "sensor" else ("odd", "even")
    beam = "" if rig.lidar_split == "sensor" else " beams"
    for sensor, empty, does in (
        (one, not scores.any(), "score methods"),
        (other, scores.all(), "condition them"),
    ):
        if empty:
            raise GeoEvsError(
                f"{where}: no LiDAR point is of {sensor}{beam}, which {does}; supply its sweep or "
                "leave out the frame"
            )
    if (points.camera[scores] < 0).all():
        raise GeoEvsError(
            f"{where}: no LiDAR point of {one}{beam} falls into an image, so nothing can be "
            "scored; correct the poses, or leave out the frame"
        )


def check_tracks(tracks: pd.DataFrame, where: Where) -> pd.DataFrame:
    """Check boxes, and hand them on.

    Raises:
        GeoEvsError: a column is missing or of another type; a side, place or yaw is impossible;
            or a frame has two boxes of one track.
    """
    for column in TRACK_COLUMNS:
        if column not in tracks:
            raise GeoEvsError(f"{where}: boxes have no column '{column}'; add it")
    if not len(tracks):
        return tracks
    for column in ("track", "label"):
        if not _all(tracks[column], str):
            raise GeoEvsError(f"{where}: '{column}' of a box is no text; write text")
    if not _all(tracks["moving"], bool | np.bool_):
        raise GeoEvsError(f"{where}: 'moving' of a box is neither true nor false; correct it")
    for frame in tracks["frame"].unique():
        frame_number(frame, where)
    for columns, low, high, fault in (
        ("xyz", -WORLD_LIMIT, WORLD_LIMIT, f"beyond {WORLD_LIMIT / 1000:g} km or none"),
        (("length", "width", "height"), np.nextafter(0, 1), LONGEST_BOX, "no side of a box"),
        (("yaw",), -360, 360, "no angle in degrees"),
    ):
        for column in columns:
            _check_column(tracks[column], low, high, fault, where)
    if tracks.duplicated(["frame", "track"]).any():
        raise GeoEvsError(f"{where}: a frame has two boxes of one track; keep one of them")
    return tracks


def _check_column(values: pd.Series, low: float, high: float, fault: str, where: Where) -> None:
    array = values.to_numpy()
    if array.dtype.kind not in "iuf":
        raise GeoEvsError(f"{where}: '{values.name}' of boxes holds no numbers; correct it")
    good = (array >= low) & (array <= high)
    if not good.all():
        wrong = array[~good]
        raise GeoEvsError(
            f"{where}: '{values.name}' of {len(wrong)} boxes is {fault}, such as {wrong[0]:g}; "
            "drop or correct these boxes"
        )


def _all(values: Iterable[Any], kind: Any) -> bool:
    return all(isinstance(value, kind) for value in values)


def _shown(value: Any) -> str:
    """A value of a file in a few characters, however large or deep it is."""
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 64:
        return "too large"
    if isinstance(value, (int, float, np.number, np.bool_)) or value is None:
        return str(value)
    return f"'{clean(value, 40)}'" if isinstance(value, str) else f"a {type(value).__name__}"
