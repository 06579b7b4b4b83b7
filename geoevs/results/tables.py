"""The paper's tables, measured and printed side by side, from score rows alone."""

import math
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
from geoevs.results.table_specs import TableSpec, bin_names, table_rows, table_spec


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
        `below_floor` (metrics that the floor beats), `note`, `unmeasured` (metrics that this
        machine lacks the weights for, and why), and the entrant's `name`, `paradigm`,
        `extra_prior` and `needs`.

    Raises:
        GeoEvsError: there is no such table, or the rows come from different protocols.
    """
    spec = table_spec(name)
    check_fingerprints(scores)
    rows = table_rows(spec, scores, settings)
    by = [*ENTRANT, "bin", "metric"]
    summary = summarise(rows, by, *settings.bootstrap)
    distances = _set_means(spec, sets)
    unmeasured = "; ".join(f"{metric}: {why}" for metric, why in _unavailable(rows, spec, sets))
    bins = bin_names(spec, settings)
    ran = set(scores[ENTRANT].itertuples(index=False, name=None))
    table = pd.DataFrame(
        [
            {"dataset": dataset, "group": _group(name, method, variant, entrants)}
            | _table_row(name, spec, summary, dataset, method, variant, label)
            | distances.get((dataset, method, variant), {})
            | {"unmeasured": unmeasured}
            | ({} if (dataset, method, variant) in ran else {"note": "not run", "unmeasured": ""})
            for dataset in scores["dataset"].unique()
            for method, variant in _listed(name, scores, entrants)
            for label in bins
        ]
    )
    table = entrants.describe(table)
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
    dataset: str,
    method: str,
    variant: str,
    label: str,
) -> dict[str, Any]:
    here = summary[(summary["dataset"] == dataset) & (summary["bin"] == label)]
    mine = here[(here["method"] == method) & (here["variant"] == variant)].set_index("metric")
    is_floor = (here["method"] == FLOOR) & (here["variant"] == DEFAULT)
    floor = here[is_floor].set_index("metric")["mean"]
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
