"""The one way to open what a run has of a scene: its views, and the answers that judge them."""

from functools import cached_property
from pathlib import Path

import numpy as np

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_arrays
from geoevs.core.images import read_image, to_float
from geoevs.protocol.condition_masks import ConditionMask, ConditionMasks
from geoevs.protocol.reference import References, SparseReference
from geoevs.protocol.regions import Answer, masked_regions, regions
from geoevs.protocol.targets import Target, read_targets
from geoevs.scenes.checks import check_depth
from geoevs.scenes.store import Scene


class Answers:
    """A scene's store, targets, references, truth and masks, each opened when first asked for.

    No method may see one. Whatever is missing or damaged is a GeoEvsError where it is asked for.

    Args:
        run: the run's folder.
        dataset: the scene's data set in the config.
        scene: its name there, or that of another world of it.
    """

    def __init__(self, run: Path, dataset: str, scene: str) -> None:
        self.run, self.dataset, self.name = Path(run), dataset, scene

    @property
    def place(self) -> dict[str, str]:
        """Data set and scene, as the layout's patterns and all rows have them."""
        return {"dataset": self.dataset, "scene": self.name}

    def path(self, pattern: str, **names: str) -> Path:
        """The path of something of the scene: a pattern of the layout, filled with `names`."""
        return self.run / pattern.format(**self.place, **names)

    def renders(self, label: str) -> Path:
        """The folder of what an entrant rendered."""
        return self.path(layout.RENDERS, label=label)

    @cached_property
    def scene(self) -> Scene:
        """The scene store: recorded images, LiDAR and boxes."""
        return Scene(self.path(layout.SCENE))

    @cached_property
    def targets(self) -> list[Target]:
        """The scene's views to synthesise, masked ones among them."""
        return read_targets(self.path(layout.TARGETS))

    @cached_property
    def _references(self) -> References:
        return References(self.path(layout.REFERENCES))

    @cached_property
    def _masks(self) -> ConditionMasks:
        return ConditionMasks(self.path(layout.MASKS))

    def reference(self, target: Target) -> SparseReference | None:
        """The sparse reference of a target, masked or not; None where a camera recorded it."""
        if target.recorded:
            return None
        reference = self._references[target.unmasked.key]
        self._check_size(reference.reprojected, target, layout.REFERENCES)
        return reference

    def mask(self, target: Target) -> ConditionMask:
        """The degradation of a masked target's condition map."""
        mask = self._masks[target.key]
        self._check_size(mask.keep, target, layout.MASKS)
        return mask

    def _check_size(self, image: np.ndarray, target: Target, pattern: str) -> None:
        if image.shape[:2] != (target.camera.height, target.camera.width):
            raise GeoEvsError(
                f"{self.path(pattern)} is of another size than target {target.key}; delete it and "
                "make it again"
            )

    def truth(self, target: Target) -> np.ndarray | None:
        """(H, W, 3) float32 in [0, 1]: true pixels of a target; None where nobody knows them."""
        camera = self.recorded_by(target)
        if camera is not None:
            return self.scene.image(camera, target.frame)
        path = self._truth_file(target.unmasked, "png")
        return to_float(read_image(path)) if path.exists() else None

    def depth(self, target: Target) -> np.ndarray | None:
        """(H, W) float32 metres, 0 = none: true depth of a target that no camera recorded.

        None where nobody knows it.
        """
        path = self._truth_file(target.unmasked, "npz")
        if not path.exists():
            return None
        arrays = read_arrays(path)
        if "depth" not in arrays:
            raise GeoEvsError(f"{path} has no array 'depth'; delete it and make it again")
        check_depth(arrays["depth"], path)
        return arrays["depth"]

    def _truth_file(self, target: Target, suffix: str) -> Path:
        return self.path(layout.TRUTH) / f"{target.key}.{suffix}"

    def regions(self, target: Target, keep: float = 1.0) -> dict[str, Answer]:
        """The true pixels of a target's regions, as far as anybody knows them (see METRICS).

        Args:
            target: the view.
            keep: the share of the reference's pixels that is kept.
        """
        reference, truth = self.reference(target), self.truth(target)
        if target.masked:
            found = masked_regions(self.mask(target), reference, truth, keep)
        else:
            found = regions(reference, truth, keep)
        ego = self.ego_mask(target)
        return found if ego is None else {name: one.without(ego) for name, one in found.items()}

    def ego_mask(self, target: Target) -> np.ndarray | None:
        """(H, W) bool: pixels where a recorded target shows the car that carries its camera."""
        camera = self.recorded_by(target)
        return None if camera is None else self.scene.ego_masks.get(camera)

    def recorded_by(self, target: Target) -> str | None:
        """The camera that recorded a target; None of a virtual one."""
        split = target.unmasked.split
        if split == "interpolation":
            return self.scene.info.rig.front
        return target.unmasked.camera.name if split == "observed" else None
