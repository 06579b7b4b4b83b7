"""The LiDAR-projected sparse reference of a target, and the masks that score it (section 3.5)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoevs.core.files import encode_arrays, write_files
from geoevs.core.randomness import Rng
from geoevs.core.stamps import NOTHING, Stamp
from geoevs.projection import zbuffer
from geoevs.protocol.condition_masks import RawReprojection, make_condition_masks
from geoevs.protocol.records import Records, check_array, record_arrays
from geoevs.protocol.targets import ALL_CAMERAS, Target, virtual_targets
from geoevs.scenes.checks import check_sensors
from geoevs.scenes.scene import PointCloud
from geoevs.scenes.store import Scene


@dataclass(frozen=True)
class SparseReference:
    """The valid pixels of one target, with what may be asked of them.

    Args:
        pixels: flat pixel indices (row * W + column), ascending.
        rgb: reference colours in [0, 1].
        footprint: whether the pixel's point also passes the footprint visibility test.
        rank: each pixel's place in a random order, in [0, 1); keeping ranks below k keeps a
            nested random share k of the pixels.
        reprojected: which pixels of the whole target raw reprojection supports.
    """

    pixels: np.ndarray  # [N] int64
    rgb: np.ndarray  # [N, 3] float32
    footprint: np.ndarray  # [N] bool
    rank: np.ndarray  # [N] float32
    reprojected: np.ndarray  # [H, W] bool

    def check(self) -> None:
        """Check what was read of a file.

        Raises:
            ValueError: an array is of another type, shape or range.
        """
        check_array(self.reprojected, "reprojected", "b", (None, None))
        check_array(self.pixels, "pixels", "iu", (None,))
        count = len(self.pixels)
        check_array(self.rgb, "rgb", "f", (count, 3))
        check_array(self.footprint, "footprint", "b", (count,))
        check_array(self.rank, "rank", "f", (count,))
        if count and not (
            self.pixels[0] >= 0
            and (np.diff(self.pixels.astype(np.int64)) > 0).all()
            and self.pixels[-1] < self.reprojected.size
            and min(self.rgb.min(), self.rank.min()) >= 0
            and max(self.rgb.max(), self.rank.max()) <= 1
        ):
            raise ValueError("its pixels, colours or ranks are out of range")

    def image(self) -> np.ndarray:
        """(H, W, 3) float32: R of the paper, zero where invalid."""
        return self._scatter(self.rgb)

    def mask(self, keep: float = 1.0) -> np.ndarray:
        """(H, W) bool: M of the paper, thinned to a share `keep` of its pixels."""
        return self._scatter(self.rank < keep)

    def footprint_mask(self, keep: float = 1.0) -> np.ndarray:
        """(H, W) bool: the valid pixels that pass the footprint test."""
        return self._scatter(self.footprint & (self.rank < keep))

    def _scatter(self, values: np.ndarray) -> np.ndarray:
        height, width = self.reprojected.shape
        flat = np.zeros((height * width, *values.shape[1:]), values.dtype)
        flat[self.pixels] = values
        return flat.reshape(height, width, *values.shape[1:])


def sparse_reference(
    points: PointCloud,
    target: Target,
    reprojected: np.ndarray,  # [H, W] bool
    rng: np.random.Generator,
) -> SparseReference:
    """Project the scoring points of a frame into a target.

    Points that no camera coloured still hide what lies behind them; they score nothing.
    """
    index = zbuffer(points.xyz, target.camera).index.ravel()
    valid = index >= 0
    valid[valid] = points.camera[index[valid]] >= 0
    pixels = np.flatnonzero(valid)
    robust = zbuffer(points.xyz, target.camera, visibility="footprint").index.ravel()
    return SparseReference(
        pixels=pixels,
        rgb=points.rgb[index[pixels]],
        footprint=robust[pixels] >= 0,
        rank=(rng.permutation(len(pixels)) / max(len(pixels), 1)).astype(np.float32),
        reprojected=reprojected,
    )


def write_references(
    references: Path,
    masks: Path,
    scene: Scene,
    targets: list[Target],
    seed: int,
    made_with: Stamp = NOTHING,
) -> None:
    """Write a scene's sparse references, and the masks that degrade conditions of masked targets.

    Both stand on one raw reprojection, which takes longest; the masks have a file of their own
    because methods are handed those alone.

    Args:
        references: what to write of the references.
        masks: what to write of the masks.
        scene: the clean scene.
        targets: all of the scene's.
        seed: decides which pixels a thinned reference keeps.
        made_with: what both files say that they were made with.
    """
    reprojection = RawReprojection(scene)
    records = {
        references: make_references(scene, targets, reprojection, seed),
        masks: make_condition_masks(targets, reprojection),
    }
    write_files(
        {path: encode_arrays(record_arrays(some, made_with)) for path, some in records.items()}
    )


def make_references(
    scene: Scene, targets: list[Target], reprojection: RawReprojection, seed: int
) -> dict[str, SparseReference]:
    """The references of every virtual target, by target key.

    Raises:
        GeoEvsError: a frame's LiDAR cannot score methods or condition them.
    """
    references = {}
    virtual = virtual_targets(targets)
    for frame in scene.frames:
        points = scene.points(frame)
        check_sensors(scene.info.rig, points, f"{scene.folder}: frame {frame}")
        scoring = points.select(scene.info.rig.scores(points))
        for target in (target for target in virtual if target.frame == frame):
            if target.sources != ALL_CAMERAS:
                raise ValueError(f"no sparse reference is defined for sources {target.sources}")
            reprojected = reprojection.validity(target.camera, frame)
            rng = Rng(seed, "reference", scene.info.name, target.key).numpy
            references[target.key] = sparse_reference(scoring, target, reprojected, rng)
    return references


class References(Records[SparseReference]):
    """A file of sparse references; masked targets have that of `target.unmasked`."""

    kind = SparseReference
