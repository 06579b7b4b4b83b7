"""The LiDAR-projected sparse reference of a target, and the masks that score it (section 3.5)."""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from geoevs.adapter import Rng, Views
from geoevs.geometry.lift import lidar_depths, lift_frame
from geoevs.io import whole_file, write_arrays
from geoevs.projection import zbuffer
from geoevs.protocol.targets import ALL_CAMERAS, Target
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


def make_references(scene: Scene, targets: list[Target], seed: int) -> dict[str, SparseReference]:
    """The references of every target that no camera recorded, by target key.

    The mask of raw reprojection comes from the points that methods may use, one for all methods.
    """
    references = {}
    views = Views(scene, scene.cameras, needs=("lidar",))
    for frame in scene.frames:
        virtual = [t for t in targets if t.frame == frame and not t.recorded]
        if not virtual:
            continue
        points = scene.points(frame)
        scoring = points.select(scene.info.rig.scores(points))
        # All of them have the front camera's lens, so one cloud is fine enough for each.
        cloud, _ = lift_frame(views, frame, lidar_depths(views, frame), virtual[0].camera)
        for target in virtual:
            if target.sources != ALL_CAMERAS:
                raise ValueError(f"no sparse reference is defined for sources {target.sources}")
            reprojected = zbuffer(cloud, target.camera).index >= 0
            rng = Rng(seed, "reference", scene.info.name, target.key).numpy
            references[target.key] = sparse_reference(scoring, target, reprojected, rng)
    return references


def write_references(path: Path, references: dict[str, SparseReference]) -> None:
    """Write references as one .npz, whole or not at all."""
    arrays = {}
    for key, reference in references.items():
        for name in (field.name for field in fields(SparseReference)):
            arrays[f"{key}/{name}"] = getattr(reference, name)
    write_arrays(path, arrays)


class References:
    """A file of references, read one target at a time.

    Raises:
        GeoEvsError: the file is missing or not whole.
    """

    def __init__(self, path: Path) -> None:
        self._path = Path(path)
        with whole_file(path):
            self._file = np.load(path, allow_pickle=False)

    def __getitem__(self, key: str) -> SparseReference:
        """The reference of the target with this key."""
        names = (field.name for field in fields(SparseReference))
        with whole_file(self._path):
            return SparseReference(**{name: self._file[f"{key}/{name}"] for name in names})
