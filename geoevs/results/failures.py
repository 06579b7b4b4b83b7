"""What failed in a run, and under stress: who, at which stage, why, and where the log is."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from geoevs import layout
from geoevs.core.files import whole_file
from geoevs.protocol.entries import FAILED

_ENDING = ["method", "variant", "stage", "reason", "log"]


@dataclass(frozen=True)
class Failure:
    """An entrant's failure on a scene.

    Args:
        method, variant: the entrant.
        place: data set and scene, and what the entrant was given.
        stage: fit, render, or both where the process died.
        reason: one sentence.
        log: the path of its log; empty where there is none.
        stressed: whether it failed in the stability suite.
    """

    method: str
    variant: str
    place: str
    stage: str
    reason: str
    log: str
    stressed: bool = False


def run_failures(run: Path) -> list[Failure]:
    """All failures of a run: of its fits and renders, then of the stability suite if it was run.

    Raises:
        GeoEvsError: cost rows are missing, or a file is damaged.
    """
    stressed = run / layout.STABILITY_SCORES
    return [
        *fit_failures(_failed(run / layout.COSTS)),
        *(stress_failures(_failed(stressed)) if stressed.exists() else []),
    ]


def fit_failures(costs: pd.DataFrame) -> Iterator[Failure]:
    """Those of cost rows, in their order."""
    for row in costs[costs["status"] == FAILED].itertuples():
        place = f"{row.dataset}/{row.scene}, from {row.sources}"
        yield Failure(**{name: getattr(row, name) for name in _ENDING}, place=place)


def stress_failures(scores: pd.DataFrame) -> Iterator[Failure]:
    """Those of the stability suite's score rows: one for all stresses that ended the same way."""
    failed = scores[scores["status"] == FAILED]
    for key, rows in failed.groupby(["dataset", "scene", *_ENDING], sort=False):
        dataset, scene, *ending = key
        draws = ", ".join(str(draw) for draw in sorted(rows["seed"].unique()))
        levels = "; ".join(
            f"{stressor} {', '.join(f'{level:g}' for level in some['level'].unique())}"
            for stressor, some in rows.groupby("stressor", sort=False)
        )
        place = f"{dataset}/{scene}, stressed by {levels} (draws {draws})"
        yield Failure(**dict(zip(_ENDING, ending, strict=True)), place=place, stressed=True)


def _failed(path: Path) -> pd.DataFrame:
    """The failed rows of a Parquet file; others are not kept in memory."""
    with whole_file(path):
        return pd.read_parquet(path, filters=[("status", "==", FAILED)])
