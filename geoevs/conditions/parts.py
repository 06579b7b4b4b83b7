"""Training sets of many scenes: one file each, joined when they are read."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geoevs.core.errors import GeoEvsError


def join_parts(
    parts: Sequence[dict[str, np.ndarray]],  # `target` [N, H, W, 3], others [N, ...]
    paths: Sequence[Path],
    what: str,
) -> dict[str, np.ndarray]:
    """Join the arrays of each name; the parts are emptied, so that no more than one is held twice.

    Args:
        parts: arrays by the same names.
        paths: the files they come from.
        what: they hold, for errors.

    Raises:
        GeoEvsError: their resolutions differ.
    """
    size = parts[0]["target"].shape[1:3]
    for path, part in zip(paths, parts, strict=True):
        shape = part["target"].shape[1:3]
        if shape != size:
            raise GeoEvsError(
                f"the {what} of {path} are {shape[0]} x {shape[1]} but those of {paths[0]} are "
                f"{size[0]} x {size[1]}; make them at one resolution"
            )
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}
