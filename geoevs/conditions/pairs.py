"""Condition-target pairs of recorded views, the generator's training set (paper section 3.2)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from geoevs.conditions.bits import pack_masks
from geoevs.conditions.parts import join_parts, read_part
from geoevs.core.errors import GeoEvsError
from geoevs.core.images import to_uint8
from geoevs.core.mapped import Stack
from geoevs.geometry.lift import lift_view
from geoevs.geometry.point_maps import PointMaps
from geoevs.projection import Raster, rasterize_points
from geoevs.scenes.camera import Camera
from geoevs.scenes.store import Scene

PREFIX = "pairs/"
"""Prefix of the pairs' arrays in a file, which may hold other things."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of one or more scenes, 8-bit images: a pair takes 7 bytes a pixel.

    Those that were read lie on disk, and what is asked for of them comes into memory.

    Args:
        rgb: condition maps X, zero where invalid.
        valid: which pixels of X hold a point; black points are valid too.
        target: supervision Y, recorded by the same camera in the same frame.
        scene, camera, frame: which view a pair is of.
    """

    rgb: np.ndarray | Stack  # [N, H, W, 3] uint8
    valid: np.ndarray | Stack  # [N, H, W] bool
    target: np.ndarray | Stack  # [N, H, W, 3] uint8
    scene: np.ndarray  # [N] str
    camera: np.ndarray  # [N] str
    frame: np.ndarray  # [N] int64

    def __len__(self) -> int:
        return len(self.frame)


def condition_map(
    image: np.ndarray,  # [H, W, 3] float
    depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
) -> Raster:
    """X of a recorded view: its own cloud alone, projected back to where it came from (u = v)."""
    xyz, rgb = lift_view(image, depth, camera, camera)
    return rasterize_points(xyz, rgb, camera)


def make_pairs(scene: Scene, point_maps: PointMaps, advance: Callable[[], None]) -> Pairs:
    """The pairs of every frame and camera of a scene; both halves are read by that key.

    Args:
        scene: the store.
        point_maps: depth of its views.
        advance: called after each frame.
    """
    rows = []
    for frame in scene.frames:
        for name in scene.cameras:
            image = scene.image(name, frame)
            depth = point_maps.depth(name, frame)
            x = condition_map(image, depth, scene.camera(name, frame))
            rgb, target = to_uint8(x.image), to_uint8(image)
            rows.append((rgb, x.mask, target, scene.info.name, name, frame))
        advance()
    return Pairs(*map(np.array, zip(*rows, strict=True)))


def pair_arrays(pairs: Pairs) -> dict[str, np.ndarray]:
    """Pairs as arrays of `write_mapped`, `valid` as packed bits; `read_pairs` reads them."""
    arrays = {field.name: getattr(pairs, field.name) for field in fields(Pairs)}
    arrays["valid"] = pack_masks(np.asarray(pairs.valid))
    return {PREFIX + name: array for name, array in arrays.items()}


def read_pairs(paths: Sequence[Path]) -> Pairs:
    """Read the pairs of many scenes, in the order given.

    Raises:
        GeoEvsError: there is no file, one is missing or damaged (see `read_part`), or
            their resolutions differ.
    """
    if not paths:
        raise GeoEvsError(
            "there are no training pairs; name training scenes under partitions.train of a data set"
        )
    return Pairs(**join_parts([read_part(path, PREFIX) for path in paths], paths, "pairs"))
