"""Means of score rows with bootstrap intervals over frames within scenes."""

from collections.abc import Sequence

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
