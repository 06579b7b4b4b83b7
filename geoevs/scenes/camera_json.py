"""A camera in nerfstudio's format: the OPENCV model without distortion, and OpenGL's axes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.text import clean
from geoevs.scenes.camera import Camera
from geoevs.scenes.checks import number

# nerfstudio's cameras are OpenGL's: y up, z backward.
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
CAMERA_MODELS = ("OPENCV", "PINHOLE")
DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """One camera as nerfstudio's per-frame fields (OPENCV model, no distortion)."""
    pose = camera.world_from_camera @ OPENCV_FROM_OPENGL
    return {
        "fl_x": camera.K[0, 0],
        "fl_y": camera.K[1, 1],
        "cx": camera.K[0, 2],
        "cy": camera.K[1, 2],
        "w": camera.width,
        "h": camera.height,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
        "transform_matrix": pose.tolist(),
    }


def camera_from_json(entry: Mapping[str, Any], name: str, file: Path) -> Camera:
    """Inverse of `camera_to_json`; `file` is where the entry stands, for errors.

    Raises:
        GeoEvsError: a field is missing or no number, the lens is distorted, or the calibration is
            impossible (see Camera).
    """
    who = f"{file}: camera '{name}'"
    for field in ("fl_x", "cx", "fl_y", "cy", "w", "h", "transform_matrix"):
        if field not in entry:
            raise GeoEvsError(f"{who} lacks '{field}'; add it")
    check_undistorted(entry, who)
    fx, fy, cx, cy = (number(entry[field], field, who) for field in ("fl_x", "fl_y", "cx", "cy"))
    pose = _matrix(entry["transform_matrix"], who) @ OPENCV_FROM_OPENGL
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    try:
        return Camera(K, pose, entry["h"], entry["w"], name)
    except GeoEvsError as error:
        raise GeoEvsError(f"{file}: {error}") from error


def _matrix(rows: Any, who: str) -> np.ndarray:
    """(4, 4) float64 of a list of lists of numbers."""
    whole = isinstance(rows, list) and len(rows) == 4
    if not (whole and all(isinstance(row, list) and len(row) == 4 for row in rows)):
        raise GeoEvsError(f"{who} has a transform_matrix that is not 4 x 4; correct it")
    return np.array([[number(value, "transform_matrix", who) for value in row] for row in rows])


def check_undistorted(entry: Mapping[str, Any], who: str) -> None:
    """Check that an entry, or what holds for all of a file, is of a lens without distortion.

    Raises:
        GeoEvsError: it is of another model, or a coefficient is not 0.
    """
    model = entry.get("camera_model", CAMERA_MODELS[0])
    if model not in CAMERA_MODELS:
        raise GeoEvsError(
            f"{who} is of the model '{clean(str(model), 40)}'; undistort its images to a pinhole, "
            f"and write {' or '.join(CAMERA_MODELS)}"
        )
    for field in DISTORTION:
        if number(entry.get(field, 0), field, who) != 0:
            raise GeoEvsError(
                f"{who} has the lens distortion {field} = {entry[field]:g}; undistort its images "
                "to a pinhole, and write 0"
            )
