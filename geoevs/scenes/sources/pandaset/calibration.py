"""PandaSet's JSON files: intrinsics, one pose and one timestamp per frame."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json
from geoevs.scenes.camera import Camera

# PandaSet's K is OpenCV's, which counts a pixel's centre as integer; ours is at +0.5.
CENTRE_SHIFT = 0.5


def read_camera(folder: Path, frame: int, height: int, width: int) -> Camera:
    """The camera of `folder` in `frame`, for its full-size image of height x width pixels.

    Raises:
        GeoEvsError: a JSON file is missing, too short or unreadable, or its values are impossible
            (see Camera); the sentence names that file.
    """
    path = folder / "intrinsics.json"
    values = read_json(path)
    with _explain(path):
        fx, fy, cx, cy = (float(values[name]) for name in ("fx", "fy", "cx", "cy"))
        K = np.array([[fx, 0, cx + CENTRE_SHIFT], [0, fy, cy + CENTRE_SHIFT], [0, 0, 1]])
        camera = Camera(K, np.eye(4), height, width, folder.name)
    path = folder / "poses.json"
    pose = read_entry(path, frame)
    with _explain(path):
        return replace(camera, world_from_camera=pose_matrix(pose))


def read_timestamp(path: Path, frame: int) -> float:
    """Seconds since 1970 of `frame`.

    Raises:
        GeoEvsError: the file is missing or unreadable, or does not reach to `frame`.
    """
    value = read_entry(path, frame)
    with _explain(path):
        return float(value)


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
    w, x, y, z = (float(pose["heading"][name]) for name in "wxyz")
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    matrix[:3, 3] = [float(pose["position"][name]) for name in "xyz"]
    return matrix


@contextmanager
def _explain(path: Path) -> Iterator[None]:
    try:
        yield
    except GeoEvsError as error:
        raise GeoEvsError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise GeoEvsError(f"{path} lacks a readable {error}; download it again") from error
