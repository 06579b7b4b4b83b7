"""Checking what comes back from a method: the same in a run and in `geoevs check-adapter`."""

import math
import numbers
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.text import clean
from geoevs.methods.contract import FitReport, Rendering
from geoevs.scenes.camera import Camera
from geoevs.scenes.splats import Splats

MOST = 2**63
"""Numbers in tables are below this."""

LONGEST_TRAINING = 1e9
"""Seconds: 30 years."""

BEYOND = 1e-3
"""How far a float pixel may lie outside of [0, 1]; sums of floats do, by less than 8 bits show."""


def checked_report(report: object) -> FitReport:
    """A fit's report as plain numbers and a note of one line.

    Raises:
        GeoEvsError: it is none, or a number cannot be; the sentence names the field.
    """
    if not isinstance(report, FitReport):
        raise GeoEvsError(f"fit returned a {type(report).__name__}; return a FitReport")
    if not isinstance(report.note, str):
        raise GeoEvsError(f"FitReport.note is a {type(report.note).__name__}; make it a text")
    return FitReport(
        primitives=_count("primitives", report.primitives),
        parameters=_count("parameters", report.parameters),
        note=clean(report.note),
        training_seconds=_training(report.training_seconds),
    )


def _count(name: str, value: Any) -> int:
    try:
        count = operator.index(value)  # also of NumPy and PyTorch
    except Exception:
        count = -1
    if not 0 <= count < MOST:
        raise GeoEvsError(f"FitReport.{name} is {_shown(value)}; give a whole number from 0 on")
    return count


def _training(value: Any) -> float | None:
    if value is None:
        return None
    try:
        seconds = float(value) if isinstance(value, numbers.Real) else math.nan
    except Exception:
        seconds = math.nan
    if not 0 <= seconds <= LONGEST_TRAINING:
        raise GeoEvsError(
            f"FitReport.training_seconds is {_shown(value)}; give seconds, or None where nobody "
            "knows them"
        )
    return seconds


def _shown(value: Any) -> str:
    """What a stranger's value looks like, if it can be told."""
    try:
        return clean(repr(value), 40) or "nothing"
    except Exception:
        return f"a {type(value).__name__}"


def checked_rgb(rendering: object, camera: Camera) -> np.ndarray:
    """(H, W, 3) uint8, or float in [0, 1] up to BEYOND: the picture that a method returned.

    Raises:
        GeoEvsError: it has another type, size or range.
    """
    if not isinstance(rendering, Rendering):
        raise GeoEvsError(f"render returned {type(rendering).__name__}; return a Rendering")
    rgb = checked_array("rgb", rendering.rgb, (camera.height, camera.width, 3))
    if rgb.dtype == np.uint8:
        return rgb
    if not np.issubdtype(rgb.dtype, np.floating):
        raise GeoEvsError(f"rgb is {rgb.dtype}; give uint8, or float in [0, 1]")
    low, high = float(rgb.min()), float(rgb.max())  # NaN if one pixel is
    if not -BEYOND <= low <= high <= 1 + BEYOND:
        raise GeoEvsError(f"rgb spans {low:g} to {high:g}; keep it finite and in [0, 1]")
    return rgb


def checked_together(renderings: object, cameras: Sequence[Camera]) -> Sequence[Rendering]:
    """What `render_together` returned, one rendering a camera; `checked_rgb` looks at each.

    Raises:
        GeoEvsError: it is no sequence, or has another count.
    """
    if not isinstance(renderings, Sequence):
        raise GeoEvsError(
            f"render_together returned {type(renderings).__name__}; return a list of Renderings"
        )
    if len(renderings) != len(cameras):
        raise GeoEvsError(
            f"render_together returned {len(renderings)} renderings of {len(cameras)} cameras; "
            "return one of each, in their order"
        )
    return renderings


def checked_splats(splats: object) -> Splats:
    """The Gaussians that a method returned, which are checked where they are made.

    Raises:
        GeoEvsError: they are none.
    """
    if not isinstance(splats, Splats):
        raise GeoEvsError(f"splats returned a {type(splats).__name__}; return Splats")
    return splats


def checked_array(name: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    """A plain array of a shape.

    Raises:
        GeoEvsError: it is none, or has another shape.
    """
    if not isinstance(value, np.ndarray):
        raise GeoEvsError(f"{name} is a {type(value).__name__}; make it a NumPy array")
    if value.shape != shape:
        raise GeoEvsError(f"{name} has shape {value.shape}; the camera asks for {shape}")
    return np.ma.getdata(value) if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
