"""Rows of distances between sets of images: one a data set, split, entrant and metric.

Beside them come score rows of the metrics that look at the same learned features of each view.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoevs import layout
from geoevs.protocol.entries import (
    EMPTY_MASK,
    FAILED,
    OK,
    MethodEntry,
    read_outcomes,
    takes_part,
)
from geoevs.protocol.learned_features import kept_features, write_features
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.pictures import read_view
from geoevs.protocol.rows import protocol_fingerprint
from geoevs.protocol.scoring import plain_columns, score_regions
from geoevs.protocol.set_metrics import SET_METRICS, real_floor, standardise
from geoevs.protocol.weights import UNAVAILABLE, missing_efficientnet
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
Describe = Callable[[np.ndarray], np.ndarray]
"""From an image, (H, W, 3) in [0, 1], to its features, (D,)."""


@dataclass
class DescribedViews:
    """A split's views, of which features are kept and no image is.

    Args:
        describers: what describes them.
        frames: the frame of each view that was rendered.
        features: by describer, the features (2, D) of what was rendered and of what is true.
        failures: the reason of each view that was not rendered.
    """

    describers: Sequence[Describe]
    frames: list[str] = field(default_factory=list)
    features: dict[Describe, list[np.ndarray]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    def add(self, frame: str, rendered: np.ndarray, true: np.ndarray) -> None:
        """Describe a view by its two images, (H, W, 3) in [0, 1] each."""
        self.frames.append(frame)
        for describe in self.describers:
            both = np.array([describe(rendered), describe(true)])
            self.features.setdefault(describe, []).append(both)


def set_frame(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Rows of set distances as a typed table."""
    return pd.DataFrame(rows, columns=list(SET_TYPES)).astype(SET_TYPES)


def write_truth_features(folder: Path, answers: Answers) -> None:
    """Keep the learned features of a scene's true pictures, which all entrants are compared with.

    The folder holds none where this machine has not the network's weights.

    Args:
        folder: what to write, whole or not at all.
        answers: the scene's.
    """
    targets = (target for target in answers.targets if target.split in SET_SPLITS)
    true = (answers.truth(target) for target in targets)
    known = () if missing_efficientnet() else (image for image in true if image is not None)
    write_features(folder, known)


def score_sets(
    entry: MethodEntry,
    run: Path,
    dataset: str,
    scenes: Sequence[str],
    confidence: float,
    protocol: dict[str, Any],
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Distances of an entrant's views of a data set from the truth, for every split that has it.

    Args:
        entry: who rendered.
        run: the run's folder.
        dataset: its name in the config.
        scenes: the test scenes of it.
        confidence: of the intervals, such as 0.95.
        protocol: the config's section of that name.

    Returns:
        The rows of distances, and score rows of each view by the metrics that share their features
        (`with_sets` in METRICS).
    """
    metrics = SET_METRICS.values()
    measured = dict.fromkeys(metric.features for metric in metrics if not metric.missing())
    views = {split: DescribedViews(list(measured)) for split in SET_SPLITS}
    scores: list[dict[str, Any]] = []
    for scene in scenes:
        answers = Answers(run, dataset, scene)
        with kept_features(answers.path(layout.TRUTH_FEATURES)):
            scores += _scored_views(entry, answers, protocol, views)
    identity = {"method": entry.method, "variant": entry.variant, "seed": entry.seed}
    sets = [
        {"dataset": dataset, "split": split, **identity, **row}
        for split, seen in views.items()
        if seen.frames or seen.failures
        for row in _rows(seen, confidence)
    ]
    return sets, scores


def _scored_views(
    entry: MethodEntry, answers: Answers, protocol: dict[str, Any], views: dict[str, DescribedViews]
) -> Iterator[dict[str, Any]]:
    """Describe a scene's views, and give the score rows that come with them."""
    fingerprint = protocol_fingerprint(answers.scene, protocol)
    renders = answers.renders(entry.label)
    outcomes = read_outcomes(renders / "render.json")
    names = [name for name, spec in METRICS.items() if spec.with_sets]
    for target in answers.targets:
        if target.split not in SET_SPLITS or not takes_part(outcomes[target.sources], target):
            continue
        regions = answers.regions(target, protocol["reference_keep"][0])
        if "dense" not in regions:
            continue
        rendered, outcome = read_view(renders, target, outcomes[target.sources])
        plain = plain_columns(entry, answers, target, outcome, fingerprint)
        for score in score_regions(names, rendered, regions):
            yield {**plain, **score}
        if rendered is None:
            views[target.split].failures.append(outcome["reason"])
            continue
        dense = regions["dense"]
        if not dense.mask.all():  # alike in both where the car is, whose pixels count nowhere
            rendered = np.where(dense.mask[..., None], rendered, dense.target)
        views[target.split].add(f"{answers.name}/{target.frame:06d}", rendered, dense.target)


def _rows(views: DescribedViews, confidence: float) -> list[dict[str, Any]]:
    """One row a metric."""
    blank = {
        **dict.fromkeys(("value", "low", "high", "floor"), math.nan),
        "views": len(views.frames),
        "failed": len(views.failures),
        "reason": "",
    }
    frames = np.array(views.frames)
    rows = []
    for name, metric in SET_METRICS.items():
        row = {**blank, "metric": name}
        if missing := metric.missing():
            rows.append({**row, "status": UNAVAILABLE, "reason": missing})
            continue
        if not views.frames:
            rows.append({**row, "status": FAILED, "reason": views.failures[0]})
            continue
        rendered, true = np.array(views.features[metric.features]).transpose(1, 0, 2)
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
