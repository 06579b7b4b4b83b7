"""Score rows and cost rows of one method on one scene."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_image, to_float
from geoevs.protocol.condition_masks import ConditionMask, ConditionMasks
from geoevs.protocol.entries import EMPTY_MASK, FAILED, OK, MethodEntry, cause, read_outcomes
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.reference import References, SparseReference
from geoevs.protocol.rows import COST_TYPES
from geoevs.protocol.targets import Target, read_targets
from geoevs.protocol.truth import dense_truth
from geoevs.protocol.weights import UNAVAILABLE
from geoevs.scenes.store import Scene

THINNING = "reference-thinning"
THINNED_METRICS = ("sparse_psnr", "sparse_ssim", "sparse_ssim_zero_fill", "sparse_mae")


@dataclass(frozen=True)
class Evidence:
    """Where the answers of one scene lie: store, target list, references, truth and masks."""

    scene: Path
    targets: Path
    references: Path
    truth: Path
    masks: Path


@dataclass(frozen=True)
class Answer:
    """What one region of a target should look like, and which of its pixels count."""

    target: np.ndarray  # [H, W, 3]
    mask: np.ndarray  # [H, W] bool
    support_ratio: float


def regions(
    reference: SparseReference | None, dense: np.ndarray | None, keep: float
) -> dict[str, Answer]:
    """The regions that metrics name (see METRICS), as far as this unmasked target has them.

    Args:
        reference: the sparse reference, of virtual targets.
        dense: (H, W, 3) truth, where known.
        keep: the share of reference pixels to keep.
    """
    found = {}
    everywhere = None if dense is None else np.ones(dense.shape[:2], bool)
    if reference is not None:
        image, mask = reference.image(), reference.mask(keep)
        masks = {
            "reference": mask,
            "reference-new": mask & ~reference.reprojected,
            "reference-footprint": reference.footprint_mask(keep),
        }
        ratio = float(mask.mean())
        found |= {name: Answer(image, region, ratio) for name, region in masks.items()}
        if dense is not None:
            found["dense"] = Answer(dense, everywhere, ratio)
            found["dense-new"] = Answer(dense, ~reference.reprojected, ratio)
            found["dense-supported"] = Answer(dense, reference.reprojected, ratio)
    elif dense is not None:
        found["dense"] = Answer(dense, everywhere, 1.0)
    return found


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
    found = {}
    ratio = float(mask.supported.mean())
    if dense is not None:
        pixels = {
            "dense": np.ones(dense.shape[:2], bool),
            "dense-supported": mask.supported,
            "dense-removed": mask.removed,
            "dense-never": ~mask.reprojected,
            "dense-unsupported": ~mask.supported,
        }
        found |= {name: Answer(dense, region, ratio) for name, region in pixels.items()}
    if reference is not None:
        hidden = reference.mask(keep) & mask.removed
        found["reference-removed"] = Answer(reference.image(), hidden, ratio)
    return found


def score_method(
    entry: MethodEntry, evidence: Evidence, renders: Path, keeps: list[float], common: dict
) -> list[dict[str, Any]]:
    """Score every target of a scene; a failed render gives rows that say so.

    Methods without a condition map have no rows of masked targets, unless their fit failed: then
    nobody could ask them.

    Args:
        entry: who rendered.
        evidence: the answers.
        renders: the folder that `render_method` left.
        keeps: shares of the reference to keep; the first gives the main rows, the others the
            sparsity split's.
        common: columns that all rows share: dataset, scene, fingerprint.
    """
    scene = Scene(evidence.scene)
    references, masks = References(evidence.references), ConditionMasks(evidence.masks)
    outcomes = read_outcomes(renders / "render.json")
    rows = []
    for target in read_targets(evidence.targets):
        if target.sources not in outcomes:
            raise GeoEvsError(
                f"{renders / 'render.json'} has no outcome for {target.sources}; delete its "
                "folder and rerun"
            )
        outcome = outcomes[target.sources]
        if target.masked and not outcome.get("masked", True):
            continue
        failed = outcome["status"] == FAILED
        preds = None if failed else to_float(read_image(renders / f"{target.key}.png"))
        reference = None if target.recorded else references[target.unmasked.key]
        dense = dense_truth(scene, evidence.truth, target)
        described = {
            **common,
            **describe(entry, target),
            **cause(outcome),
        }
        main, *thinned = keeps
        if target.masked:
            answers = masked_regions(masks[target.key], reference, dense, main)
        else:
            answers = regions(reference, dense, main)
        names = [name for name, spec in METRICS.items() if spec.region in answers]
        plain = {**described, "stressor": "", "level": math.nan}
        rows += [{**plain, **score} for score in score_regions(names, preds, answers)]
        if target.split == "extrapolation":
            for keep in thinned:
                answers = regions(reference, dense, keep)
                stressed = {**described, "stressor": THINNING, "level": keep}
                scores = score_regions(THINNED_METRICS, preds, answers)
                rows += [{**stressed, **score} for score in scores]
    return rows


def score_regions(
    names: Sequence[str], preds: np.ndarray | None, answers: dict[str, Answer]
) -> list[dict[str, Any]]:
    """What metrics say of one picture, or of none: parts of rows.

    Args:
        names: of METRICS, whose regions `answers` has.
        preds: (H, W, 3) in [0, 1]; None is a failed render.
        answers: by region.
    """
    return [_score(name, preds, answers[METRICS[name].region]) for name in names]


def describe(entry: MethodEntry, target: Target) -> dict[str, Any]:
    """Who rendered what: parts of rows."""
    return {
        "method": entry.method,
        "variant": entry.variant,
        "seed": entry.seed,
        "frame": target.frame,
        "target": target.camera.name,
        "split": target.split,
        "pose_offset": target.pose_offset,
        "lateral_shift": target.lateral_shift,
    }


def _score(name: str, preds: np.ndarray | None, answer: Answer) -> dict[str, Any]:
    row = {
        "metric": name,
        "support_ratio": answer.support_ratio,
        "valid_pixels": int(answer.mask.sum()),
    }
    if preds is None:
        return {**row, "value": math.nan, "status": FAILED}
    kind = METRICS[name].kind
    if missing := kind.missing():
        return {**row, "value": math.nan, "status": UNAVAILABLE, "reason": missing}
    metric = kind()
    metric.update(preds, answer.target, answer.mask)
    value = metric.compute()
    return {**row, "value": value, "status": EMPTY_MASK if math.isnan(value) else OK}


def cost_rows(entry: MethodEntry, renders: Path, common: dict) -> list[dict[str, Any]]:
    """What the method cost on this scene, one row for every set of sources."""
    blank = dict.fromkeys(COST_TYPES, 0) | {
        "fit_seconds": math.nan,
        "training_seconds": math.nan,
        "render_seconds": math.nan,
        "note": "",
    }
    identity = {"method": entry.method, "variant": entry.variant, "seed": entry.seed}
    return [
        {
            **blank,
            **common,
            **identity,
            **outcome,
            "sources": sources,
            "device": "cuda" if outcome["gpu_memory"] else "cpu",
        }
        for sources, outcome in read_outcomes(renders / "render.json").items()
    ]
