"""From a cell of a table back to its rows, pictures, config, commit, and how to make it again."""

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.protocol.scoring import THINNING
from geoevs.protocol.set_metrics import SET_METRICS
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import DIGITS, TABLES, TableSpec, bin_names, table_spec
from geoevs.results.tables import make_table
from geoevs.results.why_lookup import (
    Cell,
    Found,
    Record,
    Rows,
    Term,
    chosen,
    known,
    ranked,
    terms_of,
    value_line,
)
from geoevs.results.why_tables import OTHERS, needed_for

SUITES = {"stability": layout.STABILITY_SCORES, "audit": layout.AUDIT_ROWS}
"""What is no table, with the rows that its numbers are made from."""


def explain(cell: Cell, run: Path) -> list[str]:
    """Lines that say where a cell's number comes from.

    Raises:
        GeoEvsError: there is no such cell; the sentence names what there is.
    """
    record = Record(run)
    _refuse_suites(cell.table, run)
    known("table", cell.table, [*TABLES, *OTHERS])
    record.needed = needed_for(cell.table, record.settings)
    answer = OTHERS.get(cell.table, _of_table)(cell, record)
    scores = record.scores.loc[record.scores["dataset"] == record.dataset(cell.dataset)]
    lines = list(answer.value)
    for rows in answer.rows:
        where = run / rows.file
        lines.append(
            f"rows      {len(rows.rows)} in {where}, as pandas.DataFrame.query takes them:"
        )
        lines.append(f"          {rows.query}")
    lines += answer.pictures
    lines += [f"{'' if number else 'config':9} {line}" for number, line in enumerate(answer.config)]
    lines.append(
        f"commit    {record.manifest['commit']}, seed {record.manifest['seed']}, "
        f"protocol {record.manifest.get('protocol', 'not recorded')} "
        f"(fingerprint {scores['fingerprint'].iloc[0]})"
    )
    lines += [f"log       {path}" for path in answer.logs if Path(path).exists()]
    return [*lines, "rerun     " + record.command(answer, cell.table)]


def _of_table(cell: Cell, record: Record) -> Found:
    """A cell of one of TABLES."""
    spec = table_spec(cell.table)
    dataset = record.dataset(cell.dataset)
    known("metric", cell.metric, (*spec.metrics, *spec.set_metrics))
    label = known("bin", cell.bin.replace(" to ", "-"), bin_names(spec, record.settings))
    method = record.entrant(cell.entrant, dataset)
    scores, sets = record.scores, record.read(layout.SET_SCORES)
    here = scores[scores["dataset"] == dataset]
    distances = sets[sets["dataset"] == dataset]
    table = make_table(cell.table, here, record.settings, record.entrants, distances)
    mine = (table["method"] == method.method) & (table["variant"] == method.variant)
    row = table[mine & (table["bin"] == label if spec.bins else True)].iloc[0]
    of_sets = cell.metric in SET_METRICS
    who = {"dataset": dataset, "method": method.method, "variant": method.variant}
    terms = terms_of(**who, metric=cell.metric)
    terms += terms_of(split=list(spec.splits)) if of_sets else _of_bin(spec, label, record.settings)
    file, frame = (layout.SET_SCORES, sets) if of_sets else (layout.SCORES, scores)
    rows = Rows.of(file, frame, terms)
    entries = record.entries(dataset, method.method, [method.variant])
    scenes = record.scenes(dataset)
    views = (row for _, row in ranked(rows.rows))
    if of_sets:  # which have no worst view: all of them made the number
        views = chosen(here, terms_of(**who, split=list(spec.splits))).itertuples()
    return Found(
        [*_value(cell, row, dataset), record.entrant_line(method.method, method.variant)],
        [rows],
        [
            *([] if of_sets else record.extremes(rows.rows)),
            *record.pictures(dataset, entries[0].label),
        ],
        record.config_of([method.label]),
        record.parts(dataset, scenes, entries),
        logs=record.logs(views),
    )


def _refuse_suites(table: str, run: Path) -> None:
    """Refuse the names of suites whose numbers are of no table, and of their files.

    Raises:
        GeoEvsError: it is such a name; the sentence says where those numbers come from.
    """
    for suite, rows in SUITES.items():
        if table == suite or (run / suite / f"{table}.csv").exists():
            raise GeoEvsError(
                f"`geoevs why` answers for {run}/tables only; the numbers of {suite} are made from "
                f"{run / rows} and lie in {run / suite}/*.csv, which docs/{suite}.md describes"
            )


def _value(cell: Cell, row: pd.Series, dataset: str) -> Iterator[str]:
    paper = row.get(f"{cell.metric}_paper")
    printed = "" if paper is None or pd.isna(paper) else f"; the paper prints {paper:g}"
    yield value_line(cell, row, dataset, printed)
    reasons = [why for why in row["unmeasured"].split("; ") if why.startswith(f"{cell.metric}:")]
    for text in filter(None, (row["note"], *reasons)):
        yield f"note      {text}"


def _of_bin(spec: TableSpec, label: str, settings: TableSettings) -> list[Term]:
    """What is asked of the rows that a table averages in one bin."""
    stressors = ["", THINNING] if spec.edges == "support_bins" else [""]
    plain = terms_of(stressor=stressors)
    if not spec.edges:
        return [*terms_of(split=[label] if spec.bins else list(spec.splits)), *plain]
    number = list(bin_names(spec, settings)).index(label)
    edges = getattr(settings, spec.edges)
    low, high = edges[number : number + 2]
    half = 0.5 * 10.0**-DIGITS  # tables round before they cut
    top = high + half if high == edges[-1] else high - half
    place = [Term(spec.bins, ">=", low - half), Term(spec.bins, "<", top)]
    return [*terms_of(split=list(spec.splits)), *place, *plain]
