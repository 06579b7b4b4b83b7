"""The paper's tables, measured and printed side by side, from score rows alone."""

import math
from dataclasses import replace
from typing import Any

import pandas as pd

from geoevs.methods.contract import DEFAULT
from geoevs.protocol.entries import FLOOR
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.rows import check_fingerprints
from geoevs.protocol.weights import UNAVAILABLE
from geoevs.results.bootstrap import summarise
from geoevs.results.entrants import ENTRANT, Entrants
from geoevs.results.paper import paper_values
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import (
    TableSpec,
    bin_names,
    table_rows,
    table_spec,
    views_in_no_bin,
)
from geoevs.results.views import lacking, lacking_of_sets, paired_of, rows_of


def make_table(
    name: str,
    scores: pd.DataFrame,
    settings: TableSettings,
    entrants: Entrants,
    sets: pd.DataFrame | None = None,
) -> pd.DataFrame:
    """One table: a row for every data set, method and bin, paper and measured columns.

    Args:
        name: one of TABLES.
        scores: score rows.
        settings: the config's `tables` section.
        entrants: who plays.
        sets: rows of distances between sets of images; none are shown without.

    Returns:
        Columns `dataset`, `group` (paper, method or control), `method`, `variant`, `bin` for
        breakdowns, `<metric>_paper` where the paper has it, `<metric>`, `<metric>_low` and
        `<metric>_high` for every metric, `<metric>_floor` for distances of sets, `n` and `failed`
        (views with a value of the first metric that is defined there, and views without a render),
        `below_floor` (metrics that the floor beats, on the views that both delivered), `partial`
        (metrics whose mean lacks views that others have), `note`, `unmeasured` (metrics that this
        machine lacks the weights for, and why), `outside` (what is said of views in no bin), and
        the entrant's `name`, `paradigm`, `extra_prior`, `needs` and `sees`.

    Raises:
        GeoEvsError: there is no such table, or the rows come from different protocols.
    """
    spec = table_spec(name)
    check_fingerprints(scores)
    rows = table_rows(spec, scores, settings)
    by = [*ENTRANT, "bin", "metric"]
    summary = summarise(rows, by, *settings.bootstrap).merge(lacking(rows, by), on=by)
    summary["worse"] = _worse(summary, rows, settings)
    distances = _set_means(spec, sets)
    unmeasured = "; ".join(f"{metric}: {why}" for metric, why in _unavailable(rows, spec, sets))
    bins = bin_names(spec, settings)
    outside = views_in_no_bin(spec, scores, settings)
    ran = set(scores[ENTRANT].drop_duplicates().itertuples(index=False, name=None))
    table = pd.DataFrame(
        [
            {"dataset": dataset, "group": _group(name, method, variant, entrants)}
            | _table_row(name, spec, summary, distances, dataset, method, variant, label)
            | {"unmeasured": unmeasured, "outside": outside.get(dataset, "")}
            | ({} if (dataset, method, variant) in ran else {"note": "not run", "unmeasured": ""})
            for dataset in scores["dataset"].unique()
            for method, variant in _listed(name, scores, entrants)
            for label in bins
        ]
    )
    table = entrants.describe(table)
    table = table if spec.bins else table.drop(columns="bin")
    return table if spec.edges else table.drop(columns="outside")


def _set_means(spec: TableSpec, sets: pd.DataFrame | None) -> dict[tuple, dict[str, Any]]:
    """The columns of distances of sets for every data set and entrant, means over seeds.

    `partial` among them has the distances over fewer views than others.
    """
    if sets is None:
        return {}
    rows = sets.assign(lacking=lacking_of_sets(sets))
    rows = rows[rows["split"].isin(spec.splits) & rows["metric"].isin(spec.set_metrics)]
    found: dict[tuple, dict[str, Any]] = {}
    by = [*ENTRANT, "metric"]
    for (*entrant, metric), group in rows.groupby(by, sort=False):
        mean = group[["value", "low", "high", "floor"]].mean()
        columns = dict(zip(("", "_low", "_high", "_floor"), mean, strict=True))
        cells = {metric + suffix: value for suffix, value in columns.items()}
        mine = found.setdefault(tuple(entrant), {"partial": []})
        mine.update(cells)
        if group["lacking"].any() and not math.isnan(mean["value"]):
            mine["partial"].append(metric)
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


def _listed(name: str, scores: pd.DataFrame, entrants: Entrants) -> list[tuple[str, str]]:
    """Methods of the paper's table first, then ours, then controls; each in the rows' order."""
    run = list(scores[["method", "variant"]].drop_duplicates().itertuples(index=False, name=None))
    paper = [(method, DEFAULT) for method in paper_values(name)]
    listed = paper + [entrant for entrant in run if entrant not in paper]
    order = {"paper": 0, "method": 1, "control": 2}
    return sorted(listed, key=lambda entrant: order[_group(name, *entrant, entrants)])


def _group(name: str, method: str, variant: str, entrants: Entrants) -> str:
    if entrants.is_control(method, variant):
        return "control"
    return "paper" if method in paper_values(name) else "method"


def _table_row(
    name: str,
    spec: TableSpec,
    summary: pd.DataFrame,
    distances: dict[tuple, dict[str, Any]],
    dataset: str,
    method: str,
    variant: str,
    label: str,
) -> dict[str, Any]:
    here = summary[(summary["dataset"] == dataset) & (summary["bin"] == label)]
    mine = here[(here["method"] == method) & (here["variant"] == variant)].set_index("metric")
    printed = paper_values(name).get(method, {}) if variant == DEFAULT else {}
    printed = printed.get(label, {}) if spec.bins else printed
    row: dict[str, Any] = {"method": method, "variant": variant, "bin": label}
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
    row["below_floor"] = " ".join(mine.index[mine["worse"]]) if method != FLOOR else ""
    of_sets = distances.get((dataset, method, variant), {"partial": []})
    partial = mine.index[(mine["lacking"] > 0) & mine["mean"].notna()]
    row |= of_sets | {"partial": " ".join([*partial, *of_sets["partial"]])}
    row["note"] = _note(row, int(mine["lacking"][defined[0]]) if defined else 0)
    return row


def _flat_paper(name: str, spec: TableSpec) -> list[dict[str, float]]:
    values = paper_values(name).values()
    return [cell for bins in values for cell in bins.values()] if spec.bins else list(values)


def _worse(summary: pd.DataFrame, rows: pd.DataFrame, settings: TableSettings) -> list[bool]:
    """Whether the floor beats each mean; where either lacks views, on those that both delivered."""
    place = ["dataset", "bin", "metric"]
    floors = rows_of(summary, FLOOR, DEFAULT).set_index(place)
    whole = summary["lacking"].eq(0).all()
    groups = {} if whole else dict(list(rows.groupby(place, sort=False)))
    means_alone = replace(settings, resamples=1)  # no interval is looked at
    worse = []
    for row in summary.itertuples():
        at = (row.dataset, row.bin, row.metric)
        if at not in floors.index:
            worse.append(False)
            continue
        floor = floors.loc[at]
        mean, bar = row.mean, floor["mean"]
        if row.lacking or floor["lacking"]:
            both = (
                rows_of(groups[at], *who) for who in ((row.method, row.variant), (FLOOR, DEFAULT))
            )
            gap = paired_of(*both, means_alone)
            mean, bar = gap.first, gap.second
        worse.append(mean < bar if METRICS[row.metric].higher_is_better else mean > bar)
    return worse


def _note(row: dict[str, Any], missing: int) -> str:
    """What is said of views that are missing; `missing` are those of the first metric."""
    asked = missing + row["n"]
    if row["failed"]:
        note = f"failed on {row['failed']} of {row['failed'] + row['n']} views"
    elif missing and row["n"]:
        note = f"lacks {missing} of {asked} views that others have"
    else:
        return "" if row["n"] else "no view here"
    return f"{note}; mean of those delivered, not ranked" if row["n"] else note
