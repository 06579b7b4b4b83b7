"""Training sets of many scenes: one file each, joined when they are read; images stay on disk."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.conditions.bits import unpack_masks
from geoevs.core.errors import GeoEvsError
from geoevs.core.mapped import Stack, read_mapped

Part = dict[str, Stack]
"""A scene's arrays: `target` [N, H, W, 3], others [N, ...]."""


LABELS = ("scene", "camera", "frame")
"""Arrays that say which view a row is of."""


def read_part(path: Path, prefix: str = "", shown: tuple[int, ...] = ()) -> Part:
    """A scene's `rgb`, `valid`, `target` and LABELS, of which no image is read yet.

    Args:
        path: what `write_mapped` wrote.
        prefix: of the arrays' names.
        shown: how many images a row of `rgb` and of `valid` has, () for one without an axis.

    Raises:
        GeoEvsError: the file is missing or damaged, or an array is missing or another one.
    """
    arrays = read_mapped(path, prefix)
    target = arrays["target"].shape if "target" in arrays else ()
    count, height, width = (*target, 0, 0, 0)[:3]
    size, bits = (height, width), -(-height * width // 8)
    check_arrays(
        path,
        arrays,
        {
            "target": ("u", (count, *size, 3)),
            "rgb": ("u", (count, *shown, *size, 3)),
            "valid": ("u", (count * math.prod(shown), bits)),
            "scene": ("U", (count,)),
            "camera": ("U", (count,)),
            "frame": ("i", (count,)),
        },
    )

    def unpacked(rows: np.ndarray) -> np.ndarray:
        return unpack_masks(rows.reshape(-1, bits), *size).reshape(-1, *shown, *size)

    stored = (math.prod(shown) * bits,)
    valid = arrays["valid"].decoded(stored, unpacked, (*shown, *size), bool)
    return {name: arrays[name] for name in ("rgb", "target", *LABELS)} | {"valid": valid}


def check_arrays(
    path: Path, arrays: Mapping[str, Stack], expected: Mapping[str, tuple[str, tuple[int, ...]]]
) -> None:
    """Check what a file's arrays hold and how large they are.

    Args:
        path: the file.
        arrays: some of its arrays.
        expected: for some of them, the kinds that it may have (letters of `numpy.dtype.kind`), and
            the shape.

    Raises:
        GeoEvsError: one is missing or another one.
    """
    for name, (kind, shape) in expected.items():
        if name not in arrays:
            raise GeoEvsError(f"{path} has no array '{name}'; delete it and make it again")
        found = arrays[name]
        if found.dtype.kind not in kind or found.shape != shape:
            raise GeoEvsError(
                f"{path}: the array '{name}' is {found.dtype} of shape {found.shape}, not of shape "
                f"{shape}; delete it and make it again"
            )


def join_parts(parts: Sequence[Part], paths: Sequence[Path], what: str) -> dict[str, Any]:
    """Join the arrays of each name: names and numbers in memory, images where they lie.

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
    return {
        name: np.concatenate([np.asarray(part[name]) for part in parts])
        if name in LABELS
        else Stack.join([part[name] for part in parts])
        for name in parts[0]
    }
