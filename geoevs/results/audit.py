"""How far the sparse metric can be trusted: tables from the audit's rows."""

import itertools
from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy.stats import kendalltau

from geoevs.methods.contract import ORACLES
from geoevs.protocol.entries import FLOOR
from geoevs.results.bootstrap import redraw, summarise
from geoevs.results.entrants import ENTRANT, Entrants
from geoevs.results.settings import TableSettings
from geoevs.results.views import lacking

FRAME = ["scene", "frame"]
AGREEMENT_COLUMNS = [
    "dataset",
    "metric",
    "share",
    "support",
    "bias",
    "bias_low",
    "bias_high",
    "tau",
    "tau_low",
    "tau_high",
    "gap",
    "entrants",
    "left_out",
]
AGREED = 0.95
"""The share of frames in which two methods' order must hold before a gap counts as trusted."""


def audit_tables(
    rows: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> dict[str, pd.DataFrame]:
    """Every table of the audit, by name; of data without dense truth most are empty.

    That of entrants has their `name`, `paradigm`, `extra_prior`, `needs` and `sees` too.
    """
    makers = (agreement, support_bias, reference_errors, ceiling, harm)
    tables = {make.__name__: make(rows, settings) for make in makers}
    gain = entrants.describe(conditioning_gain(rows, settings))
    return tables | {conditioning_gain.__name__: gain}


def agreement(rows: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """Bias and rank correlation of every sparse metric against its dense twin, by share kept.

    Args:
        rows: the audit's rows.
        settings: the config's `tables` section.

    Returns:
        A row for every data set, metric and share: mean `support`; `bias`, sparse minus dense over
        all entrants, and `tau`, Kendall's rank correlation of the entrants' means, both with the
        ends of their intervals over frames; `gap`, the least difference of two entrants in one
        frame from which on the dense metric gives the same order in AGREED of the cases (NaN where
        none does), and `entrants`. Oracles are left out, and `left_out` counts who else is, for
        want of a view that others have.
    """
    rows = rows[(rows["part"] == "agreement") & ~rows["method"].isin(ORACLES)]
    table = []
    by = ["dataset", "metric", "share"]
    for key, everyone in _with_lacking(rows, [*by, *ENTRANT[1:]]).groupby(by, sort=False):
        group = everyone[everyone["lacking"] == 0]
        partial = everyone.loc[everyone["lacking"] > 0, ENTRANT[1:]].drop_duplicates()
        sparse, dense, scenes = _frame_means(group)
        bias, tau = _resampled(sparse, dense, scenes, settings, _bias, _tau)
        table.append(
            {
                **dict(zip(by, key, strict=True)),
                "support": group["support_ratio"].mean(),
                **_named("bias", bias),
                **_named("tau", tau),
                "gap": _trusted_gap(sparse, dense),
                "entrants": sparse.shape[1],
                "left_out": len(partial),
            }
        )
    return pd.DataFrame(table, columns=AGREEMENT_COLUMNS)


def _with_lacking(rows: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Rows with what their entrant lacks (see `lacking`); what is not finite is no value.

    Seeds have no column in these rows, but a row each.
    """
    finite = np.isfinite(rows["value"]) & np.isfinite(rows["dense"])
    view = [*FRAME, "target"]
    rows = rows.assign(value=rows["value"].where(finite), status="")
    rows["seed"] = rows.groupby([*dict.fromkeys([*by, "share", "metric"]), *view]).cumcount()
    return rows.merge(lacking(rows, by, view=view), on=by, how="left")


def _frame_means(group: pd.DataFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sparse and dense means, (F, M) each by frame and entrant, and (F,) scenes."""
    finite = group[group["value"].notna()]
    if finite.empty:  # SSIM has no window with enough pixels at the lowest share
        return np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0, object)
    cells = finite.pivot_table(["value", "dense"], FRAME, ["method", "variant"]).dropna()
    scenes = cells.index.get_level_values("scene").to_numpy(object)
    return cells["value"].to_numpy(), cells["dense"].to_numpy(), scenes


def _bias(sparse: np.ndarray, dense: np.ndarray) -> float:
    """Mean over (M,) entrants."""
    return float((sparse - dense).mean())


def _tau(sparse: np.ndarray, dense: np.ndarray) -> float:
    """Kendall's tau-b of (M,) entrants."""
    return float(kendalltau(sparse, dense).statistic) if len(sparse) > 1 else np.nan


def _resampled(
    sparse: np.ndarray,  # [F, M]
    dense: np.ndarray,  # [F, M]
    scenes: np.ndarray,  # [F]
    settings: TableSettings,
    *statistics: Callable[[np.ndarray, np.ndarray], float],
) -> list[tuple[float, float, float]]:
    """Each statistic of the entrants' means over frames, and the ends of its interval."""
    if not len(sparse):
        return [(np.nan, np.nan, np.nan)] * len(statistics)
    weights = redraw(scenes, settings.resamples, np.random.default_rng(0)) / len(sparse)
    drawn = list(zip(weights @ sparse, weights @ dense, strict=True))
    estimates = []
    for statistic in statistics:
        samples = [statistic(*means) for means in drawn]
        low, high = np.nanquantile(samples, settings.tails, method="inverted_cdf")
        estimates.append((statistic(sparse.mean(axis=0), dense.mean(axis=0)), low, high))
    return estimates


def _named(name: str, values: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip((name, f"{name}_low", f"{name}_high"), values, strict=True))


def _trusted_gap(sparse: np.ndarray, dense: np.ndarray) -> float:
    """See `agreement`: over all pairs of entrants in all frames."""
    pairs = list(itertools.combinations(range(sparse.shape[1]), 2))
    if not pairs or not len(sparse):
        return np.nan
    one, other = np.array(pairs).T
    gaps = (sparse[:, one] - sparse[:, other]).ravel()
    same = gaps * (dense[:, one] - dense[:, other]).ravel() > 0
    order = np.argsort(-np.abs(gaps))
    share = np.cumsum(same[order]) / np.arange(1, len(order) + 1)
    sizes = np.abs(gaps)[order]
    whole = np.append(sizes[1:] != sizes[:-1], True)  # equal gaps are trusted together or not
    trusted = np.flatnonzero(whole & (share >= AGREED))
    return float(sizes[trusted[-1]]) if len(trusted) else np.nan


def support_bias(rows: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """Bias of metrics over random pixels of the truth: what support alone does to them.

    Args:
        rows: the audit's rows.
        settings: the config's `tables` section.

    Returns:
        A row for every data set, metric and share of pixels: `mean` bias over entrants and its
        interval `low` and `high`. Oracles are left out, and who lacks views that others have.
    """
    rows = rows[(rows["part"] == "random-support") & ~rows["method"].isin(ORACLES)]
    by = ["dataset", "metric", "share"]
    rows = _with_lacking(rows, [*by, *ENTRANT[1:]])
    rows = rows[rows["lacking"] == 0]
    rows = rows.assign(value=rows["value"] - rows["dense"])
    return _summary(rows, by, settings)


def reference_errors(rows: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """Shares of wrong reference pixels and what they cost, by visibility rule (see the audit)."""
    return _summary(rows[rows["part"] == "reference"], ["dataset", "metric"], settings)


def ceiling(rows: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """What the photos of recorded cameras themselves score, by camera (see the audit)."""
    rows = rows[(rows["part"] == "ceiling") & np.isfinite(rows["value"])]
    return _summary(rows, ["dataset", "metric", "target"], settings)


def harm(rows: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """What distances of pictures, and of sets of them, say of known harm (see the audit).

    Args:
        rows: the audit's rows.
        settings: the config's `tables` section, of which nothing is needed.

    Returns:
        A row for every data set, metric, `harm` and `grade`, from slight to strong: the mean
        `distance` over scenes, and the mean `floor`, the distance of one instant from another.
    """
    rows = rows[rows["part"] == "harm"].rename(
        columns={"target": "harm", "share": "grade", "value": "distance", "dense": "floor"}
    )
    by = ["dataset", "metric", "harm", "grade"]
    return rows.groupby(by, sort=False)[["distance", "floor"]].mean().reset_index()


def conditioning_gain(rows: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """What entrants gain when scored on the points that they may read.

    Returns:
        A row for every data set and entrant: mean `gain` in dB with its interval, beyond what the
        floor control gains, which reads no point: the two halves of the LiDAR hit other things.
        `lacking` counts views that others have.
    """
    rows = _with_lacking(rows[rows["part"] == "conditioning"], ENTRANT)
    missing = rows[[*ENTRANT, "lacking"]].drop_duplicates()
    rows = rows.assign(value=rows["value"] - rows["dense"])
    view = ["dataset", "scene", "frame", "target"]
    floor = rows[rows["method"] == FLOOR][[*view, "value"]]
    rows = rows.merge(floor, on=view, suffixes=("", "_floor"))
    rows = rows.assign(value=rows["value"] - rows["value_floor"])
    rows = rows[np.isfinite(rows["value"]) & (rows["method"] != FLOOR)]
    return _summary(rows, ENTRANT, settings).merge(missing, on=ENTRANT)


def _summary(rows: pd.DataFrame, by: list[str], settings: TableSettings) -> pd.DataFrame:
    table = summarise(rows.assign(status=""), by, *settings.bootstrap)
    return table.drop(columns="failed")
