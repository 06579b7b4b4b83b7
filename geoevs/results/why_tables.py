"""Where the numbers of tables come from that are no means of one entrant's score rows."""

from collections.abc import Callable, Collection, Mapping

import pandas as pd

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.methods.contract import DEFAULT
from geoevs.protocol.depth_scoring import CONTROL, FINE_TUNED, PRETRAINED
from geoevs.protocol.entries import FAILED, MethodEntry, name_of
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.results import ablation, complexity, costs, geometry_table, rank_agreement
from geoevs.results.paper import paper_values
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import TABLES, rows_needed, table_spec
from geoevs.results.why_lookup import (
    Cell,
    Found,
    Record,
    Rows,
    Term,
    known,
    ranked,
    terms_of,
    value_line,
)
from geoevs.scenes.camera import view_key

COST_COLUMNS = {"peak_memory_mb": "peak_memory", "gpu_memory_mb": "gpu_memory", "size_mb": "bytes"}
"""Columns of the cost table that are millions of bytes of a cost row's column."""


IN_CONFIG = "to `methods` in the config"


def why_ablation(cell: Cell, record: Record) -> Found:
    """A cell of the ablation table; the entrant is the variant, METHOD alone the full model."""
    dataset = record.dataset(cell.dataset)
    method = record.settings.ablation
    here = _of(record.scores, dataset)
    table = ablation.make_ablation_table(here, record.settings, record.entrants)
    names = [name_of(method, variant) for variant in table["variant"] if variant]
    name = _entrant(cell, names, dataset, f"a variant of {method} {IN_CONFIG}")
    measures = {
        ablation.column_name(*measure) + end: (*measure, end)
        for measure in ablation.MEASURES
        for end in ("", "_diff", "_seed_sd")
    }
    split, metric, end = measures[known("column", cell.metric, measures)]
    variant = MethodEntry.parse(name, {}, 0).variant
    variants = list(dict.fromkeys([variant, ablation.FULL] if end == "_diff" else [variant]))
    who = {"dataset": dataset, "method": method, "variant": variants}
    terms = terms_of(**who, split=split, metric=metric, stressor=[""])
    rows = Rows.of(layout.SCORES, record.scores, terms)
    mine = rows.rows[rows.rows["variant"] == variant]
    entries = record.entries(dataset, method, variants)
    notes = {
        "_diff": "the full model minus the variant, by scene, frame, target and seed",
        "_seed_sd": "the standard deviation of the seeds' means",
    }
    scenes = record.scenes(dataset)
    return Found(
        [
            value_line(cell, table[table["variant"] == variant].iloc[0], dataset),
            *([f"note      {notes[end]}"] if end else []),
            record.entrant_line(method, variant),
        ],
        [rows],
        [*record.extremes(mine), *record.pictures(dataset, entries[0].label)],
        record.config_of(entry.name for entry in entries),
        record.parts(dataset, scenes, entries),
        logs=record.logs(row for _, row in ranked(mine)),
    )


def why_geometry(cell: Cell, record: Record) -> Found:
    """A cell of the geometry table; the entrant is the depth model, the bin STAGE/SCALE."""
    dataset = record.dataset(cell.dataset)
    scores = record.read(layout.DEPTH_SCORES)
    here = _of(scores, dataset)
    table = geometry_table.make_geometry_table(here, record.settings)
    model = known("depth model", cell.entrant, table["model"])
    mine = table[table["model"] == model]
    places = mine["stage"] + "/" + mine["scale"]
    place = known("bin", cell.bin, places)
    columns = [name + end for end in ("", "_change") for name in geometry_table.METRICS]
    column = known("column", cell.metric, [*columns, "seconds", "parameters"])
    stage, scale = place.split("/")
    metric = column.removesuffix("_change")
    changed = metric != column
    if metric not in geometry_table.METRICS:  # the same in the rows of every metric
        metric = next(iter(geometry_table.METRICS))
    stages = [PRETRAINED, FINE_TUNED] if changed else [stage]
    terms = terms_of(dataset=dataset, model=model, stage=stages, scale=scale, metric=metric)
    rows = Rows.of(layout.DEPTH_SCORES, scores, terms)
    shown = list(ranked(rows.rows[rows.rows["stage"] == stage]))
    views = [
        f"{title:9} {row.value:.4g}: {record.path(layout.SCENE, dataset, row.scene)}/images/"
        f"{view_key(row.camera, row.frame)}.png"
        for title, row in shown
    ]
    seen = dict.fromkeys(row.scene for _, row in shown)
    learnt = [] if stage == CONTROL else [f"geometry: {record.config.get('geometry')}"]
    scenes = here["scene"].unique()
    return Found(
        [value_line(cell, mine[places == place].iloc[0], dataset)],
        [rows],
        [*views, "pictures  no depth is kept: these are the photos that it was predicted from"],
        [*learnt, f"tables: {record.config['tables']}"],
        [record.path(layout.DEPTH_SCORE_PART, dataset, scene) for scene in scenes],
        rules=("depth_scores_of_scene",),
        logs=[record.path(layout.DEPTH_SCORE_LOG, dataset, scene) for scene in seen],
    )


def why_complexity(cell: Cell, record: Record) -> Found:
    """A cell of the complexity table; the entrant is the method, the bin a scene or `mean`."""
    dataset = record.dataset(cell.dataset)
    scores, spent = _of(record.scores, dataset), _of(record.costs, dataset)
    table = complexity.make_complexity_table(scores, spent, record.entrants)
    remedy = f"fixed sizes with `{complexity.ADDS_SIZES}`"
    method = _entrant(cell, table["method"].dropna(), dataset, remedy)
    mine = table[table["method"] == method]
    scene = known("bin", cell.bin or complexity.MEAN, mine["scene"])
    known("column", cell.metric, mine.select_dtypes("number").columns)
    ran = scores.loc[scores["method"] == method, "variant"].unique()
    sizes = [name for name in ran if complexity.FIXED.fullmatch(name)]
    variants = [name for name in (complexity.CHOSEN, *sizes) if name in ran]
    scenes = record.scenes(dataset) if scene == complexity.MEAN else [scene]
    who = {"dataset": dataset, "method": method, "variant": variants, "scene": scenes}
    judged = {"split": complexity.SPLIT, "metric": complexity.METRIC, "stressor": [""]}
    rows = Rows.of(layout.SCORES, record.scores, terms_of(**who, **judged))
    fits = terms_of(**who, sources=ALL_CAMERAS)
    entries = record.entries(dataset, method, variants)
    return Found(
        [
            value_line(cell, mine[mine["scene"] == scene].iloc[0], dataset),
            f"note      {complexity.CHOSEN} chose its size; the best of the others was found after",
            record.entrant_line(method, complexity.CHOSEN),
        ],
        [rows, Rows.of(layout.COSTS, record.costs, fits)],
        [*record.extremes(rows.rows), *record.pictures(dataset, entries[0].label)],
        record.config_of(entry.name for entry in entries),
        record.parts(dataset, scenes, entries),
        logs=record.logs(row for _, row in ranked(rows.rows)),
    )


def why_costs(cell: Cell, record: Record) -> Found:
    """A cell of the cost table."""
    dataset = record.dataset(cell.dataset)
    table = costs.make_cost_table(_of(record.costs, dataset), record.entrants)
    names = [name_of(row.method, row.variant) for row in table.itertuples()]
    name = known("entrant", cell.entrant, names)
    column = known("column", cell.metric, costs.COLUMNS)
    entry = MethodEntry.parse(name, {}, 0)
    who = terms_of(dataset=dataset, method=entry.method, variant=entry.variant)
    terms = [*who, *terms_of(sources=ALL_CAMERAS), Term("status", "!=", FAILED)]
    rows = Rows.of(layout.COSTS, record.costs, terms)
    source = COST_COLUMNS.get(column, column)
    unit = ", in millions of bytes" if source != column else ""
    entries = record.entries(dataset, entry.method, [entry.variant])
    scenes = record.scenes(dataset)
    return Found(
        [
            value_line(cell, table.iloc[names.index(name)], dataset),
            f"note      the mean of the rows' column {source}{unit}; a cost has no pictures",
            record.entrant_line(entry.method, entry.variant),
        ],
        [rows],
        [
            f"{'fit':9} {getattr(row, source):.4g}: {row.scene}, seed {row.seed}"
            for row in rows.rows.itertuples()
        ],
        record.config_of([name]),
        record.parts(dataset, scenes, entries),
        logs=record.logs(rows.rows.itertuples()),
    )


def why_rank_agreement(cell: Cell, record: Record) -> Found:
    """A tau of the rank agreement; the entrant is the paper's table, the metric what ranks."""
    dataset = record.dataset(cell.dataset)
    scores = _of(record.scores, dataset)
    name = known("table of the paper", cell.entrant, rank_agreement.RANKED_TABLES)
    printed = paper_values(name)
    spec = table_spec(name)
    metric = known("metric", cell.metric, rank_agreement.RANKED[name])
    table = rank_agreement.make_rank_agreement(scores, record.settings)
    row = table[(table["table"] == name) & (table["metric"] == metric)].iloc[0]
    ranked_here = [method for method, cells in printed.items() if metric in cells]
    who = {"dataset": dataset, "method": ranked_here, "variant": DEFAULT}
    terms = terms_of(**who, split=list(spec.splits), metric=metric, stressor=[""])
    rows = Rows.of(layout.SCORES, record.scores, terms)
    entries = [e for method in ranked_here for e in record.entries(dataset, method, [DEFAULT])]
    value = {metric + end: row[f"tau{end}"] for end in ("", "_low", "_high")}
    return Found(
        [
            value_line(cell, value, dataset),
            f"note      Kendall's tau of the means of {row['methods']} methods that lack no view; "
            "no one picture gives it",
            f"paper     {row['paper']}",
            f"here      {row['here']}",
        ],
        [rows],
        [],
        record.config_of(entry.name for entry in entries),
        record.parts(dataset, record.scenes(dataset), entries),
    )


OTHERS: dict[str, Callable[[Cell, Record], Found]] = {
    "ablation": why_ablation,
    "geometry": why_geometry,
    "complexity": why_complexity,
    "costs": why_costs,
    "rank_agreement": why_rank_agreement,
}


def needed_for(table: str, settings: TableSettings) -> Mapping[str, Collection[str]]:
    """What the score rows of a table, one of TABLES or OTHERS, have (see `read_scores`)."""
    if table in TABLES:
        return rows_needed(table_spec(table))
    needed: dict[str, Mapping[str, Collection[str]]] = {
        "ablation": ablation.rows_needed(settings),
        "complexity": complexity.ROWS_NEEDED,
        "rank_agreement": rank_agreement.ROWS_NEEDED,
    }
    return needed.get(table, {"metric": ()})


def _of(rows: pd.DataFrame, dataset: str) -> pd.DataFrame:
    return rows[rows["dataset"] == dataset]


def _entrant(cell: Cell, names: list[str] | pd.Series, dataset: str, lacking: str) -> str:
    """The cell's entrant; `lacking` is what to add where the table has none.

    Raises:
        GeoEvsError: the table has no such entrant, or none at all.
    """
    if not len(names):
        raise GeoEvsError(f"the table {cell.table} is empty for {dataset}; add {lacking}")
    return known("entrant", cell.entrant, names)
