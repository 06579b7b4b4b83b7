"""What failed in a run, and under stress: who, at which stage, why, and where the log is."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from geoevs import layout
from geoevs.core.text import printable
from geoevs.protocol.entries import FAILED
from geoevs.results.rows import read_rows

_ENDING = ["method", "variant", "stage", "reason", "log"]
_PLACE = ["dataset", "scene", "status"]
_OF_FIT, _OF_STRESS = ["sources"], ["stressor", "level", "seed"]


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

    def __str__(self) -> str:
        """One sentence, and where to look for the cause."""
        return printable(
            f"{self.method} ({self.variant}) could not {self.stage} {self.place}: {self.reason}; "
            f"log: {self.log}"
        )


def run_failures(run: Path) -> list[Failure]:
    """All failures of a run: of its fits and renders, then of the stability suite if it was run.

    Raises:
        GeoEvsError: cost rows are missing, or a file is damaged.
    """
    return [
        *fit_failures(_failed(run / layout.COSTS, layout.COSTS, _OF_FIT)),
        *known_failures(stability=run / layout.STABILITY_SCORES),
    ]


def known_failures(costs: Path | None = None, stability: Path | None = None) -> list[Failure]:
    """Failures of a run as far as it has come: a file of rows that is not there has none.

    Args:
        costs: the run's cost rows.
        stability: the stability suite's score rows.

    Raises:
        GeoEvsError: a file is damaged.
    """
    failures: list[Failure] = []
    if costs is not None and costs.exists():
        failures += fit_failures(_failed(costs, layout.COSTS, _OF_FIT))
    if stability is not None and stability.exists():
        failures += stress_failures(_failed(stability, layout.STABILITY_SCORES, _OF_STRESS))
    return failures


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
            f"{stressor} {', '.join(f'{level:g}' for level in stressed['level'].unique())}"
            for stressor, stressed in rows.groupby("stressor", sort=False)
        )
        place = f"{dataset}/{scene}, stressed by {levels} (draws {draws})"
        yield Failure(**dict(zip(_ENDING, ending, strict=True)), place=place, stressed=True)


def _failed(path: Path, name: str, more: list[str]) -> pd.DataFrame:
    """The failed rows of a file of rows, by what is said of them."""
    return read_rows(path, name, [*_PLACE, *_ENDING, *more], where={"status": [FAILED]})
