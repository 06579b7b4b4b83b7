"""Score rows and cost rows of one method on one scene."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.protocol.entries import (
    EMPTY_MASK,
    FAILED,
    OK,
    MethodEntry,
    cause,
    read_outcomes,
    takes_part,
)
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.pictures import read_view
from geoevs.protocol.regions import Answer
from geoevs.protocol.rows import COST_TYPES
from geoevs.protocol.targets import Target
from geoevs.protocol.weights import UNAVAILABLE
from geoevs.run import Answers

THINNING = "reference-thinning"
THINNED_METRICS = ("sparse_psnr", "sparse_ssim", "sparse_ssim_zero_fill", "sparse_mae")


def score_method(
    entry: MethodEntry, answers: Answers, keeps: list[float], fingerprint: str
) -> list[dict[str, Any]]:
    """Score every target of a scene; a render or a view that failed gives rows that say so.

    Metrics that share features with distances of sets are left out: `score_sets` has their rows.
    Methods have no rows of splits that they take no part in. Those without a condition map have
    none of masked targets, unless their fit failed: then nobody could ask them.

    Args:
        entry: who rendered.
        answers: the scene's.
        keeps: shares of the reference to keep; the first gives the main rows, the others the
            sparsity split's.
        fingerprint: of the protocol (see `protocol_fingerprint`).
    """
    renders = answers.renders(entry.label)
    outcomes = read_outcomes(renders / "render.json")
    main, *thinned = keeps
    rows = []
    for target in answers.targets:
        if target.sources not in outcomes:
            raise GeoEvsError(
                f"{renders / 'render.json'} has no outcome for {target.sources}; delete its "
                "folder and rerun"
            )
        outcome = outcomes[target.sources]
        if not takes_part(outcome, target):
            continue
        preds, outcome = read_view(renders, target, outcome)
        plain = plain_columns(entry, answers, target, outcome, fingerprint)
        regions = answers.regions(target, main)
        names = [
            name for name, spec in METRICS.items() if spec.region in regions and not spec.with_sets
        ]
        rows += [{**plain, **score} for score in score_regions(names, preds, regions)]
        if target.split == "extrapolation":
            for keep in thinned:
                stressed = {**plain, "stressor": THINNING, "level": keep}
                scores = score_regions(THINNED_METRICS, preds, answers.regions(target, keep))
                rows += [{**stressed, **score} for score in scores]
    return rows


def score_regions(
    names: Sequence[str], preds: np.ndarray | None, regions: dict[str, Answer]
) -> list[dict[str, Any]]:
    """Score one picture by each metric: rows without the columns that say who rendered what.

    Args:
        names: of METRICS, each of one of the regions.
        preds: (H, W, 3) in [0, 1]; None is a failed render.
        regions: what they should look like.
    """
    return [_score(name, preds, regions[METRICS[name].region]) for name in names]


def plain_columns(
    entry: MethodEntry,
    answers: Answers,
    target: Target,
    outcome: dict[str, Any],
    fingerprint: str,
) -> dict[str, Any]:
    """The columns of a row under no stress that do not depend on the metric.

    Args:
        entry: who rendered.
        answers: the scene's.
        target: the view.
        outcome: how it ended (see `read_view`).
        fingerprint: of the protocol.
    """
    return {
        **answers.place,
        "fingerprint": fingerprint,
        **describe(entry, target),
        **cause(outcome),
        "stressor": "",
        "level": math.nan,
    }


def describe(entry: MethodEntry, target: Target) -> dict[str, Any]:
    """The columns that say who rendered what: the entrant, its seed, the target and its pose."""
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


def cost_rows(entry: MethodEntry, answers: Answers) -> list[dict[str, Any]]:
    """Rows of the method's costs on this scene, one for every set of sources it took part in."""
    blank = dict.fromkeys(COST_TYPES, 0) | {
        "fit_seconds": math.nan,
        "training_seconds": math.nan,
        "load_seconds": math.nan,
        "warm_up_seconds": math.nan,
        "render_seconds": math.nan,
        **dict.fromkeys(("note", "host", "cpu"), ""),
    }
    identity = {"method": entry.method, "variant": entry.variant, "seed": entry.seed}
    outcomes = read_outcomes(answers.renders(entry.label) / "render.json")
    return [
        {
            **blank,
            **outcome,
            **answers.place,
            **identity,
            "sources": sources,
            "device": "cuda" if outcome["gpu_memory"] else "cpu",
        }
        for sources, outcome in outcomes.items()
        # A set of sources without a split that the method takes part in was not fitted.
        if outcome["status"] == FAILED or "fit_seconds" in outcome
    ]
