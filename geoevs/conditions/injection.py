"""Artifact injection: which pixels of a batch's condition maps are hidden (paper section 3.4)."""

from dataclasses import dataclass

import numpy as np

from geoevs.conditions.artifact_masks import MaskLibrary, check_size
from geoevs.conditions.boxes import random_boxes, random_erasing
from geoevs.core.errors import GeoEvsError, did_you_mean

INJECTIONS = ("none", "boxes", "boxes-unmatched", "reprojected")


@dataclass(frozen=True, eq=False)
class ArtifactInjection:
    """Two-stage sampling: a Bernoulli gate for every sample, then a mask drawn uniformly.

    Args:
        kind: `none`; `reprojected`, masks of the library; `boxes`, random boxes that hide as much
            as one of its masks; `boxes-unmatched`, random boxes of any area.
        probability: of the gate, the paper's p.
        height, width: of the condition maps, in pixels.
        library: the artifact masks; `none` and `boxes-unmatched` need none.

    Raises:
        GeoEvsError: there is no such kind, the probability is none, or the library is missing or
            of another resolution.
    """

    kind: str
    probability: float
    height: int
    width: int
    library: MaskLibrary | None = None

    def __post_init__(self) -> None:
        if self.kind not in INJECTIONS:
            raise GeoEvsError(
                f"there is no artifact injection '{self.kind}'; "
                f"{did_you_mean(self.kind, INJECTIONS)}"
            )
        if not 0 <= self.probability <= 1:
            raise GeoEvsError(
                f"artifact masks have the probability {self.probability}; choose one from 0 to 1"
            )
        if self.kind in ("boxes", "reprojected") and self.library is None:
            raise GeoEvsError(
                f"artifact injection '{self.kind}' draws from a mask library; make one with "
                "`geoevs combine`"
            )
        if self.library is not None:
            check_size(self.library, self.height, self.width, "the training pairs")

    def inject(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, H, W) bool: the pixels that each sample's condition map keeps."""
        keep = np.ones((count, self.height, self.width), bool)
        if self.kind != "none":
            for sample in np.flatnonzero(rng.random(count) < self.probability):
                keep[sample] = self._draw(rng)
        return keep

    def _draw(self, rng: np.random.Generator) -> np.ndarray:
        """(H, W) bool: one mask."""
        if self.kind == "reprojected":
            return self.library.draw(rng, 1)[0]
        if self.kind == "boxes":
            hidden = 1 - rng.choice(self.library.support)
            return random_boxes(rng, self.height, self.width, hidden)
        return random_erasing(rng, self.height, self.width)
