"""PandaSet's JSON files: intrinsics, one pose and one timestamp per frame."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json
from geoevs.core.text import clean
from geoevs.scenes.camera import Camera
from geoevs.scenes.checks import number, timestamp

# PandaSet's K is OpenCV's, which counts a pixel's centre as integer; ours is at +0.5.
CENTRE_SHIFT = 0.5


RELEASED_SIZE = (1080, 1920)  # height, width
RELEASED_FOCAL = {
    "front_camera": 1970.0,
    "front_left_camera": 930.0,
    "front_right_camera": 930.0,
    "left_camera": 930.0,
    "right_camera": 922.5,
    "back_camera": 934.0,
}
"""Pixels of the focal lengths at RELEASED_SIZE, rounded. They tell which size a K belongs to."""

RELEASED_TOLERANCE, SCALED_TOLERANCE = 0.25, 0.005
"""Shares by which the size that a K belongs to may differ from that of its image: one as released,
whose camera may have been calibrated anew, and one that somebody scaled."""


def read_camera(
    image: Path,
    frame: int,
    height: int,
    width: int,
    origin: tuple[float, float, float],
) -> Camera:
    """The camera of an image, by the JSON files beside it.

    Args:
        image: its file, in the camera's folder.
        frame: the instant.
        height: of the image in pixels.
        width: likewise.
        origin: metres that are subtracted from its position.

    Raises:
        GeoEvsError: a JSON file is missing, too short or unreadable, its values are impossible
            (see Camera), or belong to an image of another size; the sentence names the file.
    """
    folder = image.parent
    path = folder / "intrinsics.json"
    values = read_json(path)
    with _explain(path):
        fx, fy, cx, cy = (number(values[name], name, "K") for name in ("fx", "fy", "cx", "cy"))
    _check_size(folder.name, fx, fy, height, width, image)
    with _explain(path):
        K = np.array([[fx, 0, cx + CENTRE_SHIFT], [0, fy, cy + CENTRE_SHIFT], [0, 0, 1]])
        camera = Camera(K, np.eye(4), height, width, folder.name)
    path = folder / "poses.json"
    pose = read_pose(path, frame)
    pose[:3, 3] -= origin
    with _explain(path):
        return replace(camera, world_from_camera=pose)


def _check_size(name: str, fx: float, fy: float, height: int, width: int, image: Path) -> None:
    """Refuse an image of another size than that which its focal lengths belong to."""
    if name not in RELEASED_FOCAL or min(fx, fy) <= 0:  # Camera refuses the latter
        return
    size, released = np.array([height, width]), np.array(RELEASED_SIZE)
    belongs = released * [fy, fx] / RELEASED_FOCAL[name]
    tolerance = RELEASED_TOLERANCE if (size == released).all() else SCALED_TOLERANCE
    if (np.abs(size - belongs) > tolerance * released).any():
        raise GeoEvsError(
            f"{image} is {width} x {height}, but the focal lengths in intrinsics.json belong to an "
            f"image of {belongs[1]:.4g} x {belongs[0]:.4g}; copy images and intrinsics as they "
            f"were released ({released[1]} x {released[0]}), or scale both"
        )


def read_pose(path: Path, frame: int) -> np.ndarray:
    """(4, 4) world from sensor of `frame`.

    Raises:
        GeoEvsError: the file is missing, does not reach to `frame`, or holds no pose there.
    """
    entry = read_entry(path, frame)
    with _explain(path):
        return pose_matrix(entry)


def read_timestamp(path: Path, frame: int) -> float:
    """Seconds since 1970 of `frame`.

    Raises:
        GeoEvsError: the file is missing or unreadable, does not reach to `frame`, or holds no time.
    """
    return timestamp(read_entry(path, frame), path)


def read_entry(path: Path, frame: int) -> Any:
    """Entry number `frame` of a JSON list.

    Raises:
        GeoEvsError: the file is missing, is no list, or does not reach to `frame`.
    """
    entries = read_json(path)
    if not isinstance(entries, list) or frame >= len(entries):
        count = len(entries) if isinstance(entries, list) else 0
        raise GeoEvsError(
            f"{path} has {count} entries, too few for frame {frame}; download it again or leave "
            "out the frame"
        )
    return entries[frame]


def pose_matrix(pose: dict[str, Any]) -> np.ndarray:
    """(4, 4) world from sensor, of a `position` and a `heading` quaternion.

    The quaternion is not normalised, so that one whose length is not 1 gives a matrix with scale,
    which Camera refuses.
    """
    w, x, y, z = (number(pose["heading"][name], name, "heading") for name in "wxyz")
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    matrix[:3, 3] = [number(pose["position"][name], name, "position") for name in "xyz"]
    return matrix


@contextmanager
def _explain(path: Path) -> Iterator[None]:
    try:
        yield
    except GeoEvsError as error:
        raise GeoEvsError(f"{path}: {error}") from error
    except (KeyError, TypeError) as error:
        reason = clean(str(error), 60)
        raise GeoEvsError(f"{path} lacks a readable {reason}; download it again") from error
