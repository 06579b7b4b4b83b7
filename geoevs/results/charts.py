"""Speed against accuracy of every entrant: what pictures cost, and which entrants are worth it."""

import math

import numpy as np
import pandas as pd

from geoevs.methods.contract import ORACLES
from geoevs.protocol.entries import FAILED
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.set_metrics import SET_METRICS
from geoevs.protocol.targets import ALL_CAMERAS, FRONT_SIDE
from geoevs.results.bootstrap import bootstrap_mean, summarise
from geoevs.results.entrants import ENTRANT, Entrants
from geoevs.results.machines import timed_on
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import TableSpec, table_rows, table_spec, views_in_no_bin
from geoevs.results.views import lacking, lacking_of_sets

COSTS = {
    "fit_seconds": "fit, seconds",
    "render_seconds": "render, seconds a view",
    "memory_mb": "peak memory (main or GPU, the larger), MB",
    "size_mb": "model on disk, MB",
    "ready_seconds": "fit, load and first view, seconds",
}
"""What a picture costs, by its column and its axis. `ready_seconds` is the time until a method
shows views at the pace of `render_seconds`, whether it works in the fit or puts that off."""

SPEED = "render_seconds"
"""The cost that charts of bins show."""

ACCURACIES = ("sparse_psnr", "psnr", "psnr_removed", "lpips", "efficientnet_layers", "gms")
"""What charts of a table show of its metrics, where it has them."""

WEIGHTED = ("fid", "kid", "efficientnet_kd", "efficientnet_fd")
WEIGHT_FREE = ("texture_energy",)
"""Distances of sets of images; a table that has the first measured is charted with those alone."""

SMALLEST = {
    "fit_seconds": 1e-3,
    "ready_seconds": 1e-3,
    "render_seconds": 1e-5,
    "memory_mb": 1.0,
    "size_mb": 1e-4,
}
"""Where a logarithmic axis puts what costs nothing, or less than this."""


def speed_accuracy(
    name: str,
    scores: pd.DataFrame,
    costs: pd.DataFrame,
    settings: TableSettings,
    entrants: Entrants,
    sets: pd.DataFrame | None = None,
) -> pd.DataFrame:
    """What a view of every entrant costs, and how good it is.

    Args:
        name: the table whose views these are, one of TABLES.
        scores: score rows.
        costs: cost rows.
        settings: the config's `tables` section.
        entrants: who plays.
        sets: rows of distances between sets of images; none are charted without.

    Returns:
        A row for every data set, bin, entrant and metric of ACCURACIES, or distance of sets, with a
        value: `name`, `control`, `mean` (infinite where views are exact copies) with its interval
        `low` and `high` over frames (NaN where it has none), for every cost of COSTS its mean over
        fits with `_low` and `_high`, and `<cost>_frontier`: whether no entrant of the same data
        set, bin and metric is both cheaper and better. `lacking` and `lacking_fits` count views and
        fits that others have; who lacks any is on no frontier and pushes nobody off it. `outside`
        is what is said of views in no bin, `timed_on` of several machines. Oracles, which render
        nothing, are left out.
    """
    spec = table_spec(name)
    rows = table_rows(spec, scores, settings)
    rows = rows[rows["metric"].isin(_accuracies(spec)) & ~rows["method"].isin(ORACLES)]
    by = [*ENTRANT, "bin", "metric"]
    summary = summarise(rows, by, *settings.bootstrap).merge(lacking(rows, by), on=by)
    if sets is not None:
        summary = pd.concat([summary, _distances(spec, sets)], ignore_index=True)
    table = summary.merge(_costs(spec, costs, settings), on=ENTRANT)
    table = table[table["mean"].notna()]
    pairs = list(zip(table["method"], table["variant"], strict=True))
    table["name"] = [entrants.name(*pair) for pair in pairs]
    table["control"] = [entrants.is_control(*pair) for pair in pairs]
    for cost in COSTS:
        table[f"{cost}_frontier"] = False
    last = {name: table.pop(name) for name in ("lacking", "lacking_fits")}
    outside = views_in_no_bin(spec, scores, settings)
    said = [outside.get(dataset, "") for dataset in table["dataset"]]
    table = table.assign(**last, outside=pd.Series(said, table.index, dtype="str"))
    table["timed_on"] = table["dataset"].map(timed_on(costs)).fillna("").astype("str")
    for (_, _, metric), group in table[_whole(table)].groupby(["dataset", "bin", "metric"]):
        for cost in COSTS:
            table.loc[group.index, f"{cost}_frontier"] = _frontier(group, cost, metric)
    return table.reset_index(drop=True)


def _whole(table: pd.DataFrame) -> pd.Series:
    """Whose means are of the same views, and whose costs of the same fits, as those of others."""
    return (table["lacking"] == 0) & (table["lacking_fits"] == 0)


def _accuracies(spec: TableSpec) -> list[str]:
    return [metric for metric in ACCURACIES if metric in spec.metrics]


def _distances(spec: TableSpec, sets: pd.DataFrame) -> pd.DataFrame:
    """Distances of sets by entrant, in the columns of `summarise`; seeds are averaged."""
    rows = sets.assign(lacking=lacking_of_sets(sets))
    rows = rows[rows["split"].isin(spec.splits) & rows["metric"].isin(spec.set_metrics)]
    rows = rows[~rows["method"].isin(ORACLES)]
    weighted = rows["metric"].isin(WEIGHTED)
    measured = rows["dataset"].isin(rows.loc[weighted & rows["value"].notna(), "dataset"])
    rows = rows[weighted | (rows["metric"].isin(WEIGHT_FREE) & ~measured)]
    means = rows.groupby([*ENTRANT, "metric"], sort=False).agg(
        mean=("value", "mean"),
        low=("low", "mean"),
        high=("high", "mean"),
        n=("views", "sum"),
        failed=("failed", "sum"),
        lacking=("lacking", "sum"),
    )
    return means.reset_index().assign(bin="")


def higher_is_better(metric: str) -> bool:
    """Whether more of a metric, or of a distance of sets, is better."""
    return metric not in SET_METRICS and METRICS[metric].higher_is_better


def _costs(spec: TableSpec, costs: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """Means over fits and their intervals, for every entrant; NaN ends for one fit alone."""
    sources = FRONT_SIDE if spec.splits == ("interpolation",) else ALL_CAMERAS
    fits = costs[costs["sources"] == sources].assign(
        memory_mb=costs[["peak_memory", "gpu_memory"]].max(axis=1) / 1e6,
        size_mb=costs["bytes"] / 1e6,
        ready_seconds=costs[["fit_seconds", "load_seconds", "warm_up_seconds"]].sum(axis=1),
    )
    fits["value"] = np.where(fits["status"] == FAILED, np.nan, 1.0)
    missing = lacking(fits, ENTRANT, view=["scene"]).set_index(ENTRANT)["lacking"]
    rows = fits[fits["status"] != FAILED]
    found = []
    for entrant, group in rows.groupby(ENTRANT, sort=False):
        row = dict(zip(ENTRANT, entrant, strict=True)) | {"lacking_fits": missing[entrant]}
        for cost, smallest in SMALLEST.items():
            values = group[cost].clip(lower=smallest).to_numpy(np.float64)
            fits = np.zeros(len(values))  # all of one group, so that they are redrawn together
            interval = bootstrap_mean(values, fits, *settings.bootstrap)
            row[cost], row[f"{cost}_low"], row[f"{cost}_high"] = interval
        found.append(row)
    columns = [
        *ENTRANT,
        "lacking_fits",
        *(cost + end for cost in COSTS for end in ("", "_low", "_high")),
    ]
    return pd.DataFrame(found, columns=columns)


def _frontier(rows: pd.DataFrame, cost: str, metric: str) -> pd.Series:
    """Which rows no other beats in both cost and mean."""
    sign = 1 if higher_is_better(metric) else -1
    ordered = rows.assign(gain=sign * rows["mean"]).sort_values(
        [cost, "gain", "name"], ascending=[True, False, True], kind="stable"
    )
    best = ordered["gain"].cummax().shift(fill_value=-math.inf)
    return ((ordered["gain"] > best) & ordered[cost].notna()).reindex(rows.index)
