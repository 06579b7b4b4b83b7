"""What FreeVS trains on: recorded views in clips, with their pseudo-images."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from baselines.freevs.pseudo_images import Sweeps
from geoevs.conditions.bits import pack_masks
from geoevs.conditions.parts import join_parts, read_part
from geoevs.core.errors import GeoEvsError
from geoevs.core.images import to_uint8
from geoevs.core.mapped import Stack, write_mapped
from geoevs.methods.contract import Views
from geoevs.scenes.store import Scene

SHIFTS = (0, -4, 4)
"""Shifts in frames of the points that a view is shown by: its own, and those that simulate a
transformation."""


@dataclass(frozen=True, eq=False)
class Clips:
    """Views of one or more scenes, every camera's frames in their order.

    Those that were read lie on disk, and what is asked for of them comes into memory.

    Args:
        rgb: pseudo-images, one for each of SHIFTS; zero where no point is.
        valid: which pixels of them hold a point.
        target: what was recorded.
        scene, camera, frame: which view it is.
    """

    rgb: np.ndarray | Stack  # [N, 3, H, W, 3] uint8
    valid: np.ndarray | Stack  # [N, 3, H, W] bool
    target: np.ndarray | Stack  # [N, H, W, 3] uint8
    scene: np.ndarray  # [N] str
    camera: np.ndarray  # [N] str
    frame: np.ndarray  # [N] int64

    def __len__(self) -> int:
        return len(self.frame)

    def starts(self, length: int) -> np.ndarray:
        """(K,) the views that `length` views of the same camera begin with.

        Raises:
            GeoEvsError: no scene is that long.
        """
        first = np.arange(max(len(self) - length + 1, 0))
        same = np.ones(len(first), bool)
        for column in (self.scene, self.camera):
            same &= column[first] == column[first + length - 1]
        if not same.any():
            raise GeoEvsError(
                f"no scene under partitions.clips has {length} frames; lower "
                "trainings.freevs.frames or name longer scenes there"
            )
        return first[same]


def make_clips(scene: Scene, advance: Callable[[], None]) -> Clips:
    """The views of a scene and their pseudo-images, as a method would make them.

    Args:
        scene: the store.
        advance: called after each camera.
    """
    views = Views(scene, scene.cameras, needs=("lidar", "tracks"))
    sweeps = Sweeps.read(views)
    rows = []
    for name in views.cameras:
        for frame in views.frames:
            camera = views.camera(name, frame)
            rasters = [sweeps.pseudo_image(camera, frame, shift) for shift in SHIFTS]
            rgb = np.stack([to_uint8(raster.image) for raster in rasters])
            valid = np.stack([raster.mask for raster in rasters])
            target = to_uint8(views.image(name, frame))
            rows.append((rgb, valid, target, scene.info.name, name, frame))
        advance()
    return Clips(*map(np.array, zip(*rows, strict=True)))


def write_clips(path: Path, clips: Clips) -> None:
    """Write clips (see `write_mapped`), `valid` as packed bits, whole or not at all."""
    arrays = {field.name: getattr(clips, field.name) for field in fields(Clips)}
    masks = np.asarray(clips.valid).reshape(-1, *clips.valid.shape[2:])
    write_mapped(path, {**arrays, "valid": pack_masks(masks)})


def read_clips(paths: Sequence[Path]) -> Clips:
    """Read the clips of many scenes, in the order given.

    Raises:
        GeoEvsError: there is no file, one is missing or damaged (see `read_part`), or
            their resolutions differ.
    """
    if not paths:
        raise GeoEvsError("there are no clips; name scenes under partitions.clips of a data set")
    parts = [read_part(path, shown=(len(SHIFTS),)) for path in paths]
    return Clips(**join_parts(parts, paths, "clips"))
