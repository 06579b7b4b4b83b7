"""Rows of distances between sets of images: one a data set, split, entrant and metric."""

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoevs.protocol.entries import EMPTY_MASK, FAILED, OK, MethodEntry, read_outcomes
from geoevs.protocol.pictures import read_view
from geoevs.protocol.set_metrics import SET_METRICS, SetMetric, real_floor, standardise
from geoevs.protocol.weights import UNAVAILABLE
from geoevs.run import Answers

SET_SPLITS = ("observed", "interpolation", "extrapolation")
SET_TYPES = {
    **dict.fromkeys(("dataset", "split", "method", "variant"), "string"),
    "seed": "int64",
    "metric": "string",
    **dict.fromkeys(("value", "low", "high", "floor"), "float64"),
    **dict.fromkeys(("views", "failed"), "int64"),
    **dict.fromkeys(("status", "reason"), "string"),
}
Pair = tuple[str, np.ndarray, np.ndarray]
"""The frame of a view, what was rendered and what is true, both (H, W, 3) in [0, 1]."""


def set_frame(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Rows of set distances as a typed table."""
    return pd.DataFrame(rows, columns=list(SET_TYPES)).astype(SET_TYPES)


def score_sets(
    entry: MethodEntry, run: Path, dataset: str, scenes: Sequence[str], confidence: float
) -> list[dict[str, Any]]:
    """Distances of an entrant's views of a data set from the truth, for every split that has it.

    Args:
        entry: who rendered.
        run: the run's folder.
        dataset: its name in the config.
        scenes: the test scenes of it.
        confidence: of the intervals, such as 0.95.
    """
    pairs: dict[str, list[Pair]] = {split: [] for split in SET_SPLITS}
    failures: dict[str, list[str]] = {split: [] for split in SET_SPLITS}
    for scene in scenes:
        answers = Answers(run, dataset, scene)
        renders = answers.renders(entry.label)
        outcomes = read_outcomes(renders / "render.json")
        for target in answers.targets:
            if target.split not in SET_SPLITS:
                continue
            dense = answers.truth(target)
            if dense is None:
                continue
            rendered, outcome = read_view(renders, target, outcomes[target.sources])
            if rendered is None:
                failures[target.split].append(outcome["reason"])
                continue
            ego = answers.ego_mask(target)
            if ego is not None:  # alike in both, so that its pixels count in no distance
                rendered = np.where(ego[..., None], dense, rendered)
            pairs[target.split].append((f"{scene}/{target.frame:06d}", rendered, dense))
    identity = {"method": entry.method, "variant": entry.variant, "seed": entry.seed}
    return [
        {"dataset": dataset, "split": split, **identity, **row}
        for split in SET_SPLITS
        if pairs[split] or failures[split]
        for row in _rows(pairs[split], failures[split], confidence)
    ]


def _rows(pairs: list[Pair], failures: list[str], confidence: float) -> list[dict[str, Any]]:
    """One row a metric."""
    blank = {
        **dict.fromkeys(("value", "low", "high", "floor"), math.nan),
        "views": len(pairs),
        "failed": len(failures),
        "reason": "",
    }
    frames = np.array([frame for frame, _, _ in pairs])

    @cache
    def described(metric: SetMetric) -> tuple[np.ndarray, np.ndarray]:
        features = [[metric.features(image) for image in pair[1:]] for pair in pairs]
        return tuple(np.array(features).transpose(1, 0, 2))

    rows = []
    for name, metric in SET_METRICS.items():
        row = {**blank, "metric": name}
        if missing := metric.missing():
            rows.append({**row, "status": UNAVAILABLE, "reason": missing})
            continue
        if not pairs:
            rows.append({**row, "status": FAILED, "reason": failures[0]})
            continue
        rendered, true = described(metric)
        if metric.standardised:
            rendered, true = standardise(rendered, true), standardise(true, true)
        estimate = metric.distance(rendered, true, frames, confidence)
        rows.append(
            {
                **row,
                "value": estimate.value,
                "low": estimate.low,
                "high": estimate.high,
                "floor": real_floor(metric, true, frames),
                "status": EMPTY_MASK if math.isnan(estimate.value) else OK,
            }
        )
    return rows
