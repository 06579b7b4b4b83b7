"""The paper's tables, measured and printed side by side, from score rows alone."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import pandas as pd
import yaml

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.methods.finding import find_methods
from geoevs.protocol.entries import ORACLES
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.rows import check_fingerprints
from geoevs.protocol.scoring import THINNING
from geoevs.protocol.weights import UNAVAILABLE
from geoevs.results.bootstrap import summarise

ENTRANT = ["dataset", "method", "variant"]
"""Columns that tell who was scored on what."""

FLOOR = "mean-colour"
"""The control that every method should beat; those that do not are flagged."""


@dataclass(frozen=True)
class TableSpec:
    """A table of the paper: which rows it averages, which columns it shows.

    Args:
        title: its heading.
        splits: the splits whose rows it averages.
        metrics: measured columns, the paper's first.
        set_metrics: columns of distances between sets of images, each with its floor.
        bins: the row column that divides it, or none.
        edges: the config key, under `tables`, of the bins' edges; none where each split is a bin.
    """

    title: str
    splits: tuple[str, ...]
    metrics: tuple[str, ...]
    set_metrics: tuple[str, ...] = ()
    bins: str = ""
    edges: str = ""


TABLES = {
    "extrapolation": TableSpec(
        "Extrapolation: half-way yaw, shifted sideways (paper table 2, top)",
        ("extrapolation",),
        (
            "sparse_psnr",
            "sparse_ssim",
            "sparse_psnr_new",
            "sparse_psnr_footprint",
            "psnr",
            "psnr_new",
            "psnr_supported",
            "ssim",
            "gms",
            "lpips",
        ),
        set_metrics=("fid", "kid", "texture_energy"),
    ),
    "interpolation": TableSpec(
        "Interpolation: the front camera from the front-side ones (paper table 5)",
        ("interpolation",),
        ("ssim", "psnr", "lpips", "mae", "gms"),
        set_metrics=("texture_energy",),
    ),
    "observed": TableSpec(
        "Observed views, themselves among the sources (paper table 1)",
        ("observed",),
        ("psnr", "ssim", "mae", "gms", "lpips"),
        set_metrics=("fid", "kid", "texture_energy"),
    ),
    "pose_offset": TableSpec(
        "By angle to the front camera, in degrees (paper table 2, bottom left)",
        ("pose-sweep",),
        ("sparse_psnr", "sparse_ssim", "psnr", "gms"),
        bins="pose_offset",
        edges="pose_bins",
    ),
    "sparsity": TableSpec(
        "By support ratio of the sparse reference (paper table 2, bottom right)",
        ("extrapolation",),
        ("sparse_psnr", "sparse_ssim", "sparse_ssim_zero_fill"),
        bins="support_ratio",
        edges="support_bins",
    ),
    "masked": TableSpec(
        "Masked views: conditions degraded by validity masks of other poses (paper section 3.4)",
        ("masked-observed", "masked-extrapolation"),
        (
            "psnr_supported",
            "psnr_removed",
            "psnr_never",
            "psnr_unsupported",
            "psnr",
            "sparse_psnr_removed",
        ),
        bins="split",
    ),
}


def make_table(
    name: str, scores: pd.DataFrame, settings: dict[str, Any], sets: pd.DataFrame | None = None
) -> pd.DataFrame:
    """One table: a row for every data set, method and bin, paper and measured columns.

    Args:
        name: one of TABLES.
        scores: score rows.
        settings: the config's `tables` section.
        sets: rows of distances between sets of images; none are shown without.

    Returns:
        Columns `dataset`, `group` (paper, method or control), `method`, `variant`, `bin` for
        breakdowns, `<metric>_paper` where the paper has it, `<metric>`, `<metric>_low` and
        `<metric>_high` for every metric, `<metric>_floor` for distances of sets, `n` and `failed`
        (views with a value of the first metric that is defined there, and views without a render),
        `below_floor` (metrics that the floor beats), `note`, and `unmeasured` (metrics that this
        machine lacks the weights for, and why).

    Raises:
        GeoEvsError: there is no such table, or the rows come from different protocols.
    """
    spec = table_spec(name)
    check_fingerprints(scores)
    rows = table_rows(spec, scores, settings)
    by = [*ENTRANT, "bin", "metric"]
    summary = summarise(rows, by, settings["resamples"], settings["confidence"])
    distances = _set_means(spec, sets)
    unmeasured = "; ".join(f"{metric}: {why}" for metric, why in _unavailable(rows, spec, sets))
    bins = bin_names(spec, settings)
    ran = set(scores[ENTRANT].itertuples(index=False, name=None))
    table = pd.DataFrame(
        [
            _table_row(name, spec, summary, dataset, method, variant, label)
            | distances.get((dataset, method, variant), {})
            | {"unmeasured": unmeasured}
            | ({} if (dataset, method, variant) in ran else {"note": "not run", "unmeasured": ""})
            for dataset in scores["dataset"].unique()
            for method, variant in _entrants(name, scores)
            for label in bins
        ]
    )
    return table if spec.bins else table.drop(columns="bin")


def _set_means(spec: TableSpec, sets: pd.DataFrame | None) -> dict[tuple, dict[str, float]]:
    """The columns of distances of sets for every data set and entrant, means over seeds."""
    if sets is None:
        return {}
    rows = sets[sets["split"].isin(spec.splits) & sets["metric"].isin(spec.set_metrics)]
    found: dict[tuple, dict[str, float]] = {}
    by = [*ENTRANT, "metric"]
    for (*entrant, metric), group in rows.groupby(by, sort=False):
        mean = group[["value", "low", "high", "floor"]].mean()
        columns = dict(zip(("", "_low", "_high", "_floor"), mean, strict=True))
        cells = {metric + suffix: value for suffix, value in columns.items()}
        found.setdefault(tuple(entrant), {}).update(cells)
    return found


def _unavailable(
    rows: pd.DataFrame, spec: TableSpec, sets: pd.DataFrame | None
) -> list[tuple[str, str]]:
    """Metrics without weights here, and why."""
    found = []
    for frame, metrics in ((rows, spec.metrics), (sets, spec.set_metrics)):
        if frame is not None:
            lacking = frame[(frame["status"] == UNAVAILABLE) & frame["metric"].isin(metrics)]
            pairs = lacking[["metric", "reason"]].drop_duplicates("metric")
            found += list(pairs.itertuples(index=False, name=None))
    return found


def table_spec(name: str) -> TableSpec:
    """The table called `name`.

    Raises:
        GeoEvsError: there is none; the sentence names the nearest one.
    """
    if name not in TABLES:
        raise GeoEvsError(f"there is no table '{name}'; {did_you_mean(name, TABLES)}")
    return TABLES[name]


def bin_labels(edges: Sequence[float]) -> list[str]:
    """Names of the bins between edges, as the paper writes them.

    >>> bin_labels([0, 0.02, 0.05])
    ['0-0.02', '0.02-0.05']
    """
    return [f"{low:g}-{high:g}" for low, high in itertools.pairwise(edges)]


def bin_names(spec: TableSpec, settings: dict[str, Any]) -> Sequence[str]:
    """The bins of a table in order; one without a name where it has none."""
    if not spec.bins:
        return [""]
    return bin_labels(settings[spec.edges]) if spec.edges else spec.splits


def display_name(method: str, variant: str) -> str:
    """How tables write an entrant."""
    name = _paper()["names"].get(method, method)
    return name if variant == "default" else f"{name} ({variant})"


def paper_values(table: str) -> dict[str, Any]:
    """What the paper prints in a table, by its rows."""
    return _paper()["tables"][table]


@cache
def _paper() -> dict[str, Any]:
    return yaml.safe_load(
        resources.files("geoevs.results").joinpath("paper_values.yaml").read_text()
    )


def table_rows(spec: TableSpec, scores: pd.DataFrame, settings: dict[str, Any]) -> pd.DataFrame:
    """The score rows that a table averages, with the column `bin`."""
    rows = scores[scores["split"].isin(spec.splits) & scores["metric"].isin(spec.metrics)]
    wanted = (rows["stressor"] == "") | (
        (rows["stressor"] == THINNING) & (spec.edges == "support_bins")
    )
    rows = rows[wanted]
    if not spec.edges:
        return rows.assign(bin=rows[spec.bins] if spec.bins else "")
    edges = settings[spec.edges]
    closed = [*edges[:-1], math.nextafter(edges[-1], math.inf)]  # the last bin holds its end
    cut = pd.cut(rows[spec.bins], closed, right=False, labels=bin_labels(edges))
    return rows.assign(bin=cut.astype("string")).dropna(subset="bin")


def _entrants(name: str, scores: pd.DataFrame) -> list[tuple[str, str]]:
    """Methods of the paper's table first, then ours, then controls; each in the rows' order."""
    run = list(scores[["method", "variant"]].drop_duplicates().itertuples(index=False, name=None))
    paper = [(method, "default") for method in paper_values(name)]
    listed = paper + [entrant for entrant in run if entrant not in paper]
    order = {"paper": 0, "method": 1, "control": 2}
    return sorted(listed, key=lambda entrant: order[_group(name, entrant[0])])


@cache
def is_control(method: str) -> bool:
    """Whether a method only marks a floor, a ceiling or a simple baseline."""
    return method in ORACLES or ".controls." in find_methods().get(method, "")


def _group(name: str, method: str) -> str:
    if is_control(method):
        return "control"
    return "paper" if method in paper_values(name) else "method"


def _table_row(
    name: str,
    spec: TableSpec,
    summary: pd.DataFrame,
    dataset: str,
    method: str,
    variant: str,
    label: str,
) -> dict[str, Any]:
    here = summary[(summary["dataset"] == dataset) & (summary["bin"] == label)]
    mine = here[(here["method"] == method) & (here["variant"] == variant)].set_index("metric")
    is_floor = (here["method"] == FLOOR) & (here["variant"] == "default")
    floor = here[is_floor].set_index("metric")["mean"]
    printed = paper_values(name).get(method, {}) if variant == "default" else {}
    printed = printed.get(label, {}) if spec.bins else printed
    row: dict[str, Any] = {
        "dataset": dataset,
        "group": _group(name, method),
        "method": method,
        "variant": variant,
        "bin": label,
    }
    in_paper = {metric for values in _flat_paper(name, spec) for metric in values}
    for metric in (*spec.metrics, *spec.set_metrics):
        if metric in in_paper:
            row[f"{metric}_paper"] = printed.get(metric, math.nan)
        for column, suffix in (("mean", ""), ("low", "_low"), ("high", "_high")):
            row[metric + suffix] = mine[column].get(metric, math.nan)
        if metric in spec.set_metrics:
            row[f"{metric}_floor"] = math.nan
    defined = [metric for metric in spec.metrics if metric in mine.index]
    for count in ("n", "failed"):
        row[count] = int(mine[count][defined[0]]) if defined else 0
    row["below_floor"] = " ".join(_worse(mine["mean"], floor)) if method != FLOOR else ""
    row["note"] = _note(row)
    return row


def _flat_paper(name: str, spec: TableSpec) -> list[dict[str, float]]:
    values = paper_values(name).values()
    return [cell for bins in values for cell in bins.values()] if spec.bins else list(values)


def _worse(means: pd.Series, floor: pd.Series) -> list[str]:
    return [
        metric
        for metric, mean in means.items()
        if metric in floor.index
        and (mean < floor[metric] if METRICS[metric].higher_is_better else mean > floor[metric])
    ]


def _note(row: dict[str, Any]) -> str:
    if row["failed"]:
        return f"failed on {row['failed']} of {row['failed'] + row['n']} views"
    return "" if row["n"] else "no view here"
