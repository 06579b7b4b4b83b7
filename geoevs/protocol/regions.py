"""Regions of a target: what they should look like, and which of its pixels count (see METRICS)."""

from dataclasses import dataclass, replace

import numpy as np

from geoevs.protocol.condition_masks import ConditionMask
from geoevs.protocol.reference import SparseReference


@dataclass(frozen=True)
class Answer:
    """The true pixels of one region of a target, and the mask of those that count."""

    target: np.ndarray  # [H, W, 3]
    mask: np.ndarray  # [H, W] bool
    support_ratio: float

    def without(
        self,
        hidden: np.ndarray,  # [H, W] bool
    ) -> "Answer":
        """The answer without the pixels that show the car which carries the camera."""
        return replace(self, mask=self.mask & ~hidden)


def regions(
    reference: SparseReference | None, dense: np.ndarray | None, keep: float
) -> dict[str, Answer]:
    """The regions that metrics name (see METRICS), as far as this unmasked target has them.

    Args:
        reference: the sparse reference, of virtual targets.
        dense: (H, W, 3) truth, where known.
        keep: the share of reference pixels to keep.
    """
    answers = {}
    everywhere = None if dense is None else np.ones(dense.shape[:2], bool)
    if reference is not None:
        image, mask = reference.image(), reference.mask(keep)
        masks = {
            "reference": mask,
            "reference-new": mask & ~reference.reprojected,
            "reference-footprint": reference.footprint_mask(keep),
        }
        ratio = float(mask.mean())
        answers |= {name: Answer(image, region, ratio) for name, region in masks.items()}
        if dense is not None:
            answers["dense"] = Answer(dense, everywhere, ratio)
            answers["dense-new"] = Answer(dense, ~reference.reprojected, ratio)
            answers["dense-supported"] = Answer(dense, reference.reprojected, ratio)
    elif dense is not None:
        answers["dense"] = Answer(dense, everywhere, 1.0)
    return answers


def masked_regions(
    mask: ConditionMask, reference: SparseReference | None, dense: np.ndarray | None, keep: float
) -> dict[str, Answer]:
    """The regions of a masked target (see METRICS); support ratios are the degraded condition's.

    Args:
        mask: how its condition was degraded.
        reference: the sparse reference, of extrapolated targets.
        dense: (H, W, 3) truth, where known.
        keep: the share of reference pixels to keep.
    """
    answers = {}
    ratio = float(mask.supported.mean())
    if dense is not None:
        pixels = {
            "dense": np.ones(dense.shape[:2], bool),
            "dense-supported": mask.supported,
            "dense-removed": mask.removed,
            "dense-never": ~mask.reprojected,
            "dense-unsupported": ~mask.supported,
        }
        answers |= {name: Answer(dense, region, ratio) for name, region in pixels.items()}
    if reference is not None:
        hidden = reference.mask(keep) & mask.removed
        answers["reference-removed"] = Answer(reference.image(), hidden, ratio)
    return answers
