"""Means of score rows, and paired differences, with bootstrap intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from geoevs.protocol.entries import FAILED


def bootstrap_mean(
    values: np.ndarray,  # [F] one per frame
    scenes: np.ndarray,  # [F] which scene each frame belongs to
    resamples: int,
    confidence: float,
) -> tuple[float, float, float]:
    """The mean over frames, and the ends of its percentile interval.

    Frames are redrawn with replacement within each scene; the scenes stay, so the interval says
    how sure the mean is for these scenes, not for others. One frame alone gives no interval.

    Returns:
        Mean, lower end, upper end (NaN ends where every scene has one frame).
    """
    mean = float(np.mean(values))
    groups = [np.flatnonzero(scenes == scene) for scene in pd.unique(scenes)]
    if all(len(group) == 1 for group in groups):
        return mean, np.nan, np.nan
    rng = np.random.default_rng(0)
    total = np.zeros(resamples)
    for group in groups:
        drawn = rng.integers(len(group), size=(resamples, len(group)))
        total += values[group][drawn].sum(axis=1)
    tail = (1 - confidence) / 2
    # No interpolation: exact copies score infinity, and infinities have no midpoint.
    low, high = np.quantile(total / len(values), [tail, 1 - tail], method="inverted_cdf")
    return mean, float(low), float(high)


def summarise(
    rows: pd.DataFrame, by: Sequence[str], resamples: int, confidence: float
) -> pd.DataFrame:
    """Mean, interval, number of views and of failed views of every group of score rows.

    A frame counts once: its targets and seeds are averaged first. Rows without a value (a failed
    render, an empty mask) are counted, not averaged.

    Args:
        rows: score rows of one split.
        by: the columns that make a group, `metric` among them.
        resamples: of the bootstrap.
        confidence: of the interval, such as 0.95.
    """
    summaries = []
    for key, group in rows.groupby(list(by), sort=False, dropna=False, observed=True):
        valid = group[group["value"].notna()]
        if len(valid):
            frames = valid.groupby(["scene", "frame"], sort=False)["value"].mean().reset_index()
            scenes = frames["scene"].to_numpy(object)
            values = frames["value"].to_numpy(np.float64)
            mean, low, high = bootstrap_mean(values, scenes, resamples, confidence)
        else:
            mean = low = high = np.nan
        failed = int((group["status"] == FAILED).sum())
        summary = {"mean": mean, "low": low, "high": high, "n": len(valid), "failed": failed}
        summaries.append({**dict(zip(by, key, strict=True)), **summary})
    return pd.DataFrame(summaries, columns=[*by, "mean", "low", "high", "n", "failed"])


PAIR = ["scene", "frame", "target", "seed"]
"""What two score rows must share to be a pair."""


@dataclass(frozen=True)
class PairedDifference:
    """What two entrants have over the pairs that they make.

    Args:
        mean: the mean difference.
        low, high: the ends of its interval.
        pairs: how many there are.
        left_out: views that either delivered, once for every seed, that give none: the other one
            failed there or did not take part, or one of them is an exact copy.
        first, second: the entrants' own means over the pairs.
    """

    mean: float = np.nan
    low: float = np.nan
    high: float = np.nan
    pairs: int = 0
    left_out: int = 0
    first: float = np.nan
    second: float = np.nan


def paired_difference(
    rows: pd.DataFrame, others: pd.DataFrame, resamples: int, confidence: float
) -> PairedDifference:
    """Mean of one entrant's values minus another's, over pairs (see PAIR).

    The percentile interval redraws frames within scenes and, independently, training seeds: a seed
    is one trained model, so it is redrawn for all frames at once. Targets of a frame are averaged
    first. Pairs without a finite difference do not count.

    Args:
        rows: score rows of one entrant, of one data set, split and metric.
        others: the same of the other entrant.
        resamples: of the bootstrap.
        confidence: of the interval, such as 0.95.

    Returns:
        NaN where there is no pair, and NaN ends where nothing can be redrawn: one seed, and one
        frame in every scene.
    """
    both = pd.concat([rows, others])
    asked = both[both["value"].notna()].drop_duplicates(PAIR)
    pairs = rows.merge(others, on=PAIR, suffixes=("", "_other"))
    pairs = pairs.assign(difference=pairs["value"] - pairs["value_other"])
    pairs = pairs[np.isfinite(pairs["difference"])]
    counts = {"pairs": len(pairs), "left_out": len(asked) - len(pairs)}
    if pairs.empty:
        return PairedDifference(**counts)
    cells = pairs.pivot_table("difference", "seed", ["scene", "frame"])
    scenes = cells.columns.get_level_values("scene").to_numpy(object)
    table, present = cells.fillna(0.0).to_numpy(), cells.notna().to_numpy(np.float64)
    mean = float(table.sum() / present.sum())
    by_seed = pairs.groupby(
        ["seed", "scene", "frame"]
    )  # each weighs the same, as in the difference
    own = {"first": by_seed["value"].mean().mean(), "second": by_seed["value_other"].mean().mean()}
    if len(table) == 1 and len(set(scenes)) == len(scenes):
        return PairedDifference(mean, **counts, **own)
    rng = np.random.default_rng(0)
    seeds = redraw(np.zeros(len(table)), resamples, rng)
    frames = redraw(scenes, resamples, rng)
    # Where seeds lack frames, a resample may hold no pair at all: 0 / 0, which does not count.
    with np.errstate(invalid="ignore"):
        means = (seeds @ table * frames).sum(axis=1) / (seeds @ present * frames).sum(axis=1)
    tail = (1 - confidence) / 2
    low, high = np.nanquantile(means, [tail, 1 - tail], method="inverted_cdf")
    return PairedDifference(mean, float(low), float(high), **counts, **own)


def redraw(
    groups: np.ndarray,  # [N] which group each item belongs to
    resamples: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """(resamples, N) how often each item is drawn, with replacement within its group."""
    counts = np.zeros((resamples, len(groups)))
    for group in pd.unique(groups):
        members = np.flatnonzero(groups == group)
        chances = np.full(len(members), 1 / len(members))
        counts[:, members] = rng.multinomial(len(members), chances, size=resamples)
    return counts
