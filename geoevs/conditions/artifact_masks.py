"""The artifact-mask library: support that reprojection leaves at virtual poses (section 3.4)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from geoevs.conditions.bits import pack_masks, unpack_masks
from geoevs.conditions.parts import check_arrays
from geoevs.core.errors import GeoEvsError
from geoevs.core.mapped import Stack, read_mapped
from geoevs.geometry.lift import lift_frame
from geoevs.geometry.point_maps import PointMaps
from geoevs.methods.contract import Views
from geoevs.projection import zbuffer
from geoevs.scenes.camera import Camera
from geoevs.scenes.store import Scene
from geoevs.scenes.virtual import virtual_camera, yaw_gap

LABELS = ("scene", "frame", "yaw", "lateral", "support")
PREFIX = "masks/"
"""Prefix of the library's arrays in a file, which may hold other things."""

NO_MASKS = "holds no masks; name training scenes under partitions.train of a data set"


@dataclass(frozen=True, eq=False)
class MaskLibrary:
    """Validity masks at virtual poses, the paper's A.

    Args:
        height, width: of every mask, in pixels.
        packed: the masks' bits (see `pack_masks`); of a library that was read they lie on disk.
        scene, frame: whose cloud a mask is of.
        yaw: degrees from the front camera, left positive.
        lateral: metres to the left.
        support: support ratio, valid pixels / all pixels.
        origin: what sentences about it call it.

    Raises:
        GeoEvsError: it holds no masks.
    """

    height: int
    width: int
    packed: np.ndarray | Stack  # [N, ceil(H W / 8)] uint8
    scene: np.ndarray  # [N] str
    frame: np.ndarray  # [N] int64
    yaw: np.ndarray  # [N] float64
    lateral: np.ndarray  # [N] float64
    support: np.ndarray  # [N] float64
    origin: str = "the mask library"

    def __post_init__(self) -> None:
        if not len(self):
            raise GeoEvsError(f"{self.origin} {NO_MASKS}")

    def __len__(self) -> int:
        return len(self.packed)

    def masks(self, index: np.ndarray) -> np.ndarray:  # [M] int
        """(M, H, W) bool: the masks of these numbers."""
        return unpack_masks(self.packed[index], self.height, self.width)

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, H, W) bool: masks drawn uniformly, with replacement."""
        return self.masks(rng.integers(len(self), size=count))


class VirtualPose(NamedTuple):
    """A virtual camera, and where it stands relative to the front one."""

    camera: Camera
    yaw: float  # degrees, left positive
    lateral: float  # metres, left positive


def virtual_poses(
    scene: Scene, frame: int, poses: Mapping[str, Sequence[float]]
) -> Iterator[VirtualPose]:
    """The poses of one frame at which masks are taken, to both sides (see `virtual_camera`).

    Args:
        scene: the store.
        frame: the instant.
        poses: the config's `conditions.masks`: `yaw` as fractions of the gap between the front
            camera and a front-side one, `lateral` in metres.
    """
    rig = scene.info.rig
    front = scene.camera(rig.front, frame)
    for side in (scene.camera(name, frame) for name in (rig.front_left, rig.front_right)):
        gap = yaw_gap(front, side)
        for fraction in poses["yaw"]:
            if fraction == 0 and side.name == rig.front_right:
                continue  # the same as towards the left
            for lateral in poses["lateral"]:
                name = f"mask-{fraction * gap:+g}deg{lateral:+g}m"
                camera = virtual_camera(front, side, fraction * abs(gap), lateral, name)
                yield VirtualPose(camera, fraction * gap, lateral)


def make_artifact_masks(
    scene: Scene,
    point_maps: PointMaps,
    poses: Mapping[str, Sequence[float]],
    advance: Callable[[], None],
) -> MaskLibrary:
    """One scene's part of the library: every frame's cloud, of all its views, at every pose.

    Args:
        scene: the store of a training scene.
        point_maps: depth of its views.
        poses: see `virtual_poses`.
        advance: called after each frame.
    """
    views = Views(scene, scene.cameras, needs=())
    front = scene.camera(scene.info.rig.front, scene.frames[0])
    packed, labels = [], []
    for frame in scene.frames:
        depths = {name: point_maps.depth(name, frame) for name in scene.cameras}
        # All poses have the front camera's lens, so one cloud is fine enough for each.
        cloud, _ = lift_frame(views, frame, depths, front)
        for camera, yaw, lateral in virtual_poses(scene, frame, poses):
            mask = zbuffer(cloud, camera).mask
            packed.append(pack_masks(mask[None]))
            labels.append((scene.info.name, frame, yaw, lateral, mask.mean()))
        advance()
    columns = map(np.array, zip(*labels, strict=True))
    return MaskLibrary(
        front.height, front.width, np.concatenate(packed), **dict(zip(LABELS, columns, strict=True))
    )


def mask_arrays(library: MaskLibrary) -> dict[str, np.ndarray | Stack]:
    """A library, or one scene's part of it, as arrays of `write_mapped`."""
    arrays: dict[str, np.ndarray | Stack] = {name: getattr(library, name) for name in LABELS}
    arrays |= {"size": np.array([library.height, library.width]), "masks": library.packed}
    return {PREFIX + name: array for name, array in arrays.items()}


def read_artifact_masks(path: Path) -> MaskLibrary:
    """Read the library among a file's arrays (see `mask_arrays`).

    Raises:
        GeoEvsError: the file is missing or damaged, an array is missing or another one, or there
            are no masks.
    """
    arrays = read_mapped(path, PREFIX)
    check_arrays(path, arrays, {"size": ("i", (2,))})
    height, width = map(int, arrays["size"])
    count = len(arrays["masks"]) if "masks" in arrays else 0
    check_arrays(path, arrays, {"masks": ("u", (count, -(-height * width // 8)))})
    kinds = zip(LABELS, ("U", "i", "if", "if", "f"), strict=True)
    check_arrays(path, arrays, {name: (kind, (count,)) for name, kind in kinds})
    labels = {name: np.asarray(arrays[name]) for name in LABELS}
    return MaskLibrary(height, width, arrays["masks"], **labels, origin=str(path))


def join_artifact_masks(parts: Sequence[MaskLibrary]) -> MaskLibrary:
    """The parts of many scenes as one library, in the order given.

    Raises:
        GeoEvsError: there is no part, or their resolutions differ.
    """
    if not parts:
        raise GeoEvsError(f"the mask library {NO_MASKS}")
    first = parts[0]
    for part in parts:
        check_size(part, first.height, first.width, f"those of {first.origin}")
    labels = {name: np.concatenate([getattr(part, name) for part in parts]) for name in LABELS}
    stacks = [Stack([part.packed]) for part in parts]
    return MaskLibrary(first.height, first.width, Stack.join(stacks), **labels)


def check_size(library: MaskLibrary, height: int, width: int, others: str) -> None:
    """Check that masks are as large as what they go with.

    Raises:
        GeoEvsError: they are not.
    """
    if (library.height, library.width) != (height, width):
        raise GeoEvsError(
            f"the masks of {library.origin} are {library.height} x {library.width} but {others} "
            f"are {height} x {width}; make them at one resolution"
        )
