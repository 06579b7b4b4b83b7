"""Score rows and cost rows of one method on one scene."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.errors import GeoEvsError
from geoevs.io import read_image, to_float
from geoevs.protocol.entries import EMPTY_MASK, FAILED, OK, MethodEntry, read_outcomes
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.reference import References, SparseReference
from geoevs.protocol.rows import COST_TYPES
from geoevs.protocol.targets import Target, read_targets
from geoevs.protocol.truth import dense_truth
from geoevs.scenes.store import Scene

THINNING = "reference-thinning"
THINNED_METRICS = ("sparse_psnr", "sparse_ssim", "sparse_ssim_zero_fill", "sparse_mae")


@dataclass(frozen=True)
class Evidence:
    """Where the answers of one scene lie: store, target list, references and truth."""

    scene: Path
    targets: Path
    references: Path
    truth: Path


@dataclass(frozen=True)
class Answer:
    """What one region of a target should look like, and which of its pixels count."""

    target: np.ndarray  # [H, W, 3]
    mask: np.ndarray  # [H, W] bool
    support_ratio: float


def regions(
    reference: SparseReference | None, dense: np.ndarray | None, keep: float
) -> dict[str, Answer]:
    """The regions that metrics name (see METRICS), as far as this target has them.

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
    elif dense is not None:
        found["dense"] = Answer(dense, everywhere, 1.0)
    return found


def score_method(
    entry: MethodEntry, evidence: Evidence, renders: Path, keeps: list[float], common: dict
) -> list[dict[str, Any]]:
    """Score every target of a scene; a failed render gives rows that say so.

    Args:
        entry: who rendered.
        evidence: the answers.
        renders: the folder that `render_method` left.
        keeps: shares of the reference to keep; the first gives the main rows, the others the
            sparsity split's.
        common: columns that all rows share: dataset, scene, fingerprint.
    """
    scene = Scene(evidence.scene)
    references = References(evidence.references)
    outcomes = read_outcomes(renders / "render.json")
    rows = []
    for target in read_targets(evidence.targets):
        if target.sources not in outcomes:
            raise GeoEvsError(
                f"{renders / 'render.json'} has no outcome for {target.sources}; delete its "
                "folder and rerun"
            )
        outcome = outcomes[target.sources]
        failed = outcome["status"] == FAILED
        preds = None if failed else to_float(read_image(renders / f"{target.key}.png"))
        reference = None if target.recorded else references[target.key]
        dense = dense_truth(scene, evidence.truth, target)
        described = {
            **common,
            **_describe(entry, target),
            **{name: outcome[name] for name in ("stage", "reason", "log")},
        }
        main, *thinned = keeps
        answers = regions(reference, dense, main)
        names = [name for name, spec in METRICS.items() if spec.region in answers]
        plain = {**described, "stressor": "", "level": math.nan}
        rows += [{**plain, **score} for score in _scores(names, preds, answers)]
        if target.split == "extrapolation":
            for keep in thinned:
                answers = regions(reference, dense, keep)
                stressed = {**described, "stressor": THINNING, "level": keep}
                rows += [
                    {**stressed, **score} for score in _scores(THINNED_METRICS, preds, answers)
                ]
    return rows


def _scores(
    names: Sequence[str], preds: np.ndarray | None, answers: dict[str, Answer]
) -> list[dict[str, Any]]:
    return [_score(name, preds, answers[METRICS[name].region]) for name in names]


def _describe(entry: MethodEntry, target: Target) -> dict[str, Any]:
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
    metric = METRICS[name].kind()
    metric.update(preds, answer.target, answer.mask)
    value = metric.compute()
    return {**row, "value": value, "status": EMPTY_MASK if math.isnan(value) else OK}


def cost_rows(entry: MethodEntry, renders: Path, common: dict) -> list[dict[str, Any]]:
    """What the method cost on this scene, one row for every set of sources."""
    blank = dict.fromkeys(COST_TYPES, 0) | {
        "fit_seconds": math.nan,
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
