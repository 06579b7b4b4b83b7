"""What a method rendered, sealed when its step ended, and looked at again when it is scored."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.hashes import file_hash
from geoevs.core.images import read_image, to_float
from geoevs.protocol.entries import FAILED, failed
from geoevs.protocol.targets import Target

PICTURES = "pictures"
"""The key of an outcome under which every picture's hash stands, by the target's key."""


def seal_pictures(folder: Path, targets: Iterable[Target]) -> dict[str, str]:
    """The SHA-256 of every picture that a step left in `folder`; a missing one has none."""
    hashes = {target.key: _hash(folder / f"{target.key}.png") for target in targets}
    return {key: digest for key, digest in hashes.items() if digest}


def read_view(
    folder: Path, target: Target, outcome: dict[str, Any]
) -> tuple[np.ndarray | None, dict[str, Any]]:
    """A rendered view as (H, W, 3) float32 in [0, 1], and how it ended.

    The view is None where the step failed, or this picture is missing, is no picture of the
    target's size, or is another one than was rendered: then the outcome is this view's own.

    Args:
        folder: of the renders.
        target: the view.
        outcome: of its set of sources (see `seal_pictures`).

    Raises:
        GeoEvsError: the outcome has no hashes, as in runs of earlier versions.
    """
    if outcome["status"] == FAILED:
        return None, outcome
    if not isinstance(outcome.get(PICTURES), dict):
        raise GeoEvsError(
            f"{folder} does not say which pictures were rendered, as runs of earlier versions; "
            "delete the folder and rerun"
        )
    reason, image = "", None
    path = folder / f"{target.key}.png"
    sealed = outcome[PICTURES].get(target.key)
    if sealed is None:
        reason = "no picture of this view was left"
    elif _hash(path) != sealed:
        reason = f"{path.name} is another picture than was rendered; something wrote over it"
        if not path.exists():
            reason = f"{path.name} was removed after it was rendered"
    else:
        try:
            image = read_image(path)
        except GeoEvsError as error:
            reason = str(error)
        expected = (target.camera.height, target.camera.width, 3)
        if image is not None and image.shape != expected:
            reason = f"the picture's shape is {image.shape}, not {expected}"
    if reason:
        return None, {**outcome, **failed("render", reason, outcome["log"])}
    return to_float(image), outcome


def _hash(path: Path) -> str:
    """Of a regular file; nothing if there is none."""
    return file_hash(path) if path.is_file() and not path.is_symlink() else ""
