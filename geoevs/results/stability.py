"""Where methods break: curves over graded stress, breaking points and seed spread, from rows."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import pandas as pd

from geoevs.protocol.entries import FAILED, FLOOR
from geoevs.protocol.rows import check_fingerprints
from geoevs.protocol.stability import CLEAN
from geoevs.protocol.stability_scoring import SPREADS
from geoevs.protocol.stressors import STRESSORS
from geoevs.results.bootstrap import redraw, summarise
from geoevs.results.entrants import ENTRANT, INFO, Entrants
from geoevs.results.settings import TableSettings
from geoevs.results.views import lacking, with_lacking

VIEW = ["dataset", "scene", "world", "frame", "target", "metric"]
COLUMNS = [
    *ENTRANT,
    "name",
    "control",
    "stressor",
    "level",
    "metric",
    "mean",
    "low",
    "high",
    "change",
    "change_low",
    "change_high",
    "relative_degradation",
    "worst_decile",
    "failure_rate",
    "n",
    "lacking",
]
BREAKING_COLUMNS = [
    *ENTRANT,
    "stressor",
    "metric",
    "level",
    "low",
    "high",
    "control",
    "lead",
    "lacking",
    *INFO,
]
JUDGED_BY = ("psnr", "sparse_psnr", "psnr_moving")
"""Metrics that have breaking points."""

ROUNDING = 1e-9
"""By so much the floor's own mean may differ from its values."""


@dataclass(frozen=True)
class Curve:
    """One entrant's mean under each level, mildest first, and the same under every resample.

    `lacking` are views and draws that it has no value of and others do: there its mean is of the
    others, and says nothing beside another entrant's or another level's.
    """

    levels: list[float]
    means: np.ndarray  # [L]
    samples: np.ndarray  # [R, L]
    lacking: np.ndarray  # [L]

    def judged(self) -> Self:
        """The curve with nothing where views are lacking."""
        whole = self.lacking == 0
        means, samples = (np.where(whole, some, np.nan) for some in (self.means, self.samples))
        return replace(self, means=means, samples=samples)


def make_stability_table(
    scores: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> pd.DataFrame:
    """A row for every entrant, stressor, level and metric.

    Args:
        scores: the suite's score rows.
        settings: the config's `tables` section.
        entrants: who plays.

    Returns:
        COLUMNS. `mean` and its interval are over frames and draws; `change` is the mean minus the
        mildest level's, in the metric's unit; `relative_degradation` is the share of the mildest
        level's mean that is lost; `worst_decile` is the mean of the worst
        tenth of views; `failure_rate` is the share of views that were not delivered, or that are
        below what the floor control scores on them, in their world, without stress. `lacking`
        counts views that others have a value of: of such a level the mean is shown, and neither
        changes nor the worst tenth.

    Raises:
        GeoEvsError: the rows come from different protocols.
    """
    check_fingerprints(scores)
    scores = scores.assign(world=_world(scores))
    bar = scores.merge(_floor(scores), on=VIEW, how="left")["floor"].to_numpy()
    below = (scores["value"] < bar - ROUNDING) | (scores["status"] == FAILED)
    table = []
    for key, rows in _curves(scores.assign(below=below)):
        curve = fit_curve(rows, key["stressor"], settings)
        judged = curve.judged()
        for number, level in enumerate(curve.levels):
            here = _at(rows, level)
            values = here["value"].dropna()
            low, high = _ends(curve.samples[:, number], settings)
            changes = judged.samples[:, number] - judged.samples[:, 0]
            change_low, change_high = _ends(changes, settings)
            tenth = values.nsmallest(max(1, round(len(values) / 10)))
            table.append(
                {
                    **key,
                    "name": entrants.name(key["method"], key["variant"]),
                    "control": entrants.is_control(key["method"], key["variant"]),
                    "level": level,
                    "mean": curve.means[number],
                    "low": low,
                    "high": high,
                    "change": judged.means[number] - judged.means[0],
                    "change_low": change_low,
                    "change_high": change_high,
                    "relative_degradation": 1 - judged.means[number] / judged.means[0],
                    "worst_decile": np.nan if curve.lacking[number] else tenth.mean(),
                    "failure_rate": here["below"].mean(),
                    "n": len(values),
                    "lacking": curve.lacking[number],
                }
            )
    return pd.DataFrame(table, columns=COLUMNS)


def _at(rows: pd.DataFrame, level: float) -> pd.DataFrame:
    """The rows of a level; NaN is without stress."""
    return rows[rows["level"].isna() if np.isnan(level) else rows["level"] == level]


def _ends(samples: np.ndarray, settings: TableSettings) -> tuple[float, float]:
    if np.isnan(samples).all() or np.ptp(samples) == 0:
        return np.nan, np.nan
    low, high = np.nanquantile(samples, settings.tails, method="inverted_cdf")
    return float(low), float(high)


def _floor(scores: pd.DataFrame) -> pd.DataFrame:
    """What the floor control scores on every view without stress: `floor` beside VIEW.

    Views of another world have the names of the clean ones, and another truth.
    """
    rows = scores[scores["method"] == FLOOR]
    unstressed = rows["stressor"].isin([CLEAN, *_own_mildest()])
    views = rows[unstressed].groupby(VIEW, as_index=False, dropna=False)["value"].mean()
    return views.rename(columns={"value": "floor"})


def _world(scores: pd.DataFrame) -> pd.Series:
    """The stressor and level that made a row's world; empty is the clean one."""
    worlds = [name for name, stressor in STRESSORS.items() if stressor.kind == "world"]
    names = scores["stressor"].astype(str) + " " + scores["level"].astype(str)
    return names.where(scores["stressor"].isin(worlds), "")


def _own_mildest() -> list[str]:
    """Stressors whose mildest level takes the place of CLEAN, because the truth differs."""
    return [name for name, stressor in STRESSORS.items() if stressor.kind in ("world", "targets")]


def _curves(scores: pd.DataFrame) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """The rows of every curve, those of CLEAN added where stress starts from there.

    Each says what its entrant lacks at its level. Draws are shared, so a draw is another view.
    """
    scores = scores[~scores["metric"].isin(SPREADS)]
    by = [*ENTRANT, "stressor", "level", "metric"]
    scores = with_lacking(scores, by, ["scene", "frame", "target", "seed"])
    clean = scores[scores["stressor"] == CLEAN].assign(level=np.nan)
    mildest = dict(iter(clean.groupby([*ENTRANT, "metric"], sort=False, dropna=False)))
    by = [*ENTRANT, "stressor", "metric"]
    for key, rows in scores[scores["stressor"] != CLEAN].groupby(by, sort=False, dropna=False):
        *entrant, stressor, metric = key
        if stressor not in _own_mildest() and (*entrant, metric) in mildest:
            rows = pd.concat([mildest[*entrant, metric], rows])
        yield dict(zip(by, key, strict=True)), rows


def fit_curve(rows: pd.DataFrame, stressor: str, settings: TableSettings) -> Curve:
    """Means by level, with resamples that redraw frames within scenes and, apart, draws.

    Targets of a frame are averaged first. A frame and draw counts the same at every level.

    Args:
        rows: score rows of one entrant, stressor and metric, with the column `lacking` (see
            `with_lacking`); the level NaN is without stress.
        stressor: says which way levels get harder.
        settings: the config's `tables` section.
    """
    given = sorted(rows["level"].dropna().unique(), reverse=STRESSORS[stressor].falling)
    levels = [*([np.nan] if rows["level"].isna().any() else []), *given]
    draws = sorted(rows["seed"].unique())
    frames = rows[["scene", "frame"]].drop_duplicates().sort_values(["scene", "frame"])
    frames = pd.MultiIndex.from_frame(frames)
    rng = np.random.default_rng(0)
    by_draw = redraw(np.zeros(len(draws)), settings.resamples, rng)
    by_frame = redraw(frames.get_level_values("scene").to_numpy(object), settings.resamples, rng)
    # Without stress, NaN, is the first of the levels where there is such a one.
    numbers = rows["level"].map({level: number for number, level in enumerate(levels)}).fillna(0)
    rows = rows.assign(number=numbers.astype(int))
    cells = rows.pivot_table("value", ["number", "seed"], ["scene", "frame"])
    every = pd.MultiIndex.from_product([range(len(levels)), draws])
    values = cells.reindex(index=every, columns=frames).to_numpy()
    values = values.reshape(len(levels), len(draws), len(frames))
    present = np.isfinite(values).astype(np.float64)
    values = np.where(present > 0, values, 0.0)
    with np.errstate(invalid="ignore"):  # nothing at all: 0 / 0
        means = values.sum(axis=(1, 2)) / present.sum(axis=(1, 2))
        totals = (by_draw @ values * by_frame).sum(axis=2)
        samples = totals / (by_draw @ present * by_frame).sum(axis=2)
    missing = rows.groupby("number")["lacking"].max().reindex(range(len(levels)), fill_value=0)
    return Curve(levels, means, samples.T, missing.to_numpy())


def breaking_points(
    scores: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> pd.DataFrame:
    """The level at which each method fails, or falls below the best control under the same stress.

    Args:
        scores: the suite's score rows.
        settings: the config's `tables` section.
        entrants: who plays.

    Returns:
        A row for every method (controls excepted), stressor and metric of JUDGED_BY: `level`, the
        first at which its mean is below the best control's or it lacks a view that others have,
        with the interval `low` (milder) and `high` (harder) over resamples; `clean` is before any
        stress and `none` beyond the hardest level. `lacking` is how many views it lacks at that
        level. `control` is the best one there that lacks none, `lead` by how much the method is
        above it without stress, in the metric's unit. Levels at which no control has a value of
        every view judge nobody; where that is all of them, the row is empty. The method's `name`,
        `paradigm`, `extra_prior`, `needs` and `sees` come last.
    """
    curves: dict[tuple, dict[tuple[str, str], Curve]] = {}
    for key, rows in _curves(scores[scores["metric"].isin(JUDGED_BY)]):
        group = (key["dataset"], key["stressor"], key["metric"])
        entrant = (key["method"], key["variant"])
        curves.setdefault(group, {})[entrant] = fit_curve(rows, key["stressor"], settings)
    table = []
    for (dataset, stressor, metric), here in curves.items():
        controls = {
            entrants.name(*who): curve for who, curve in here.items() if entrants.is_control(*who)
        }
        for who, curve in here.items():
            if entrants.is_control(*who) or not controls:
                continue
            method, variant = who
            table.append(
                {
                    "dataset": dataset,
                    "method": method,
                    "variant": variant,
                    "stressor": stressor,
                    "metric": metric,
                    **_breaking_point(curve, controls, settings),
                    **entrants.columns(method, variant),
                }
            )
    return pd.DataFrame(table, columns=BREAKING_COLUMNS)


def _breaking_point(
    curve: Curve, controls: dict[str, Curve], settings: TableSettings
) -> dict[str, Any]:
    missing = np.append(curve.lacking, 0)
    curve, controls = curve.judged(), {name: some.judged() for name, some in controls.items()}
    names = list(controls)
    means = np.stack([controls[name].means for name in names])
    best = np.where(np.isnan(means), -np.inf, means).argmax(axis=0)
    bar = np.take_along_axis(means, best[None], axis=0)  # [1, L], NaN where no control has a value
    defined = np.flatnonzero(~np.isnan(bar[0]))
    if not len(defined):
        blank = dict.fromkeys(("level", "low", "high", "control"), "")
        return {**blank, "lead": np.nan, "lacking": 0}
    rivals = np.stack(
        [controls[names[who]].samples[:, number] for number, who in enumerate(best)], axis=1
    )
    labels = ["clean" if np.isnan(level) else f"{level:g}" for level in curve.levels] + ["none"]
    first = _first_broken(curve.means[None], bar)[0]
    broken = _first_broken(curve.samples, rivals)
    ends = np.quantile(broken, settings.tails, method="inverted_cdf")
    return {
        "level": labels[first],
        "low": labels[int(ends[0])],
        "high": labels[int(ends[1])],
        "control": names[best[min(first, defined[-1])]],
        "lead": curve.means[0] - bar[0, 0],
        "lacking": missing[first],
    }


def _first_broken(
    values: np.ndarray,  # [R, L]
    rivals: np.ndarray,  # [R, L]
) -> np.ndarray:
    """(R,) index of the first level below its rival; L where there is none.

    No value is below, but nothing is below a rival without one: there the level says nothing.
    """
    broken = ~(values >= rivals) & ~np.isnan(rivals)
    return np.where(broken.any(axis=1), broken.argmax(axis=1), values.shape[1])


def seed_spread(scores: pd.DataFrame, settings: TableSettings, entrants: Entrants) -> pd.DataFrame:
    """How far a method's draws lie apart without stress, in 8-bit levels (see SPREADS).

    `lacking` counts views that others have: those where a draw failed.
    """
    rows = scores[scores["metric"].isin(SPREADS)]
    rows = rows.assign(value=255 * rows["value"])
    by = [*ENTRANT, "metric"]
    spread = summarise(rows, by, *settings.bootstrap).merge(lacking(rows, by), on=by)
    return entrants.describe(spread)
