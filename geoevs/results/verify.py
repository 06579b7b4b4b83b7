"""Whether a run's folder that somebody sent is whole and says what its pictures and rows give.

Nothing in it is run, and nothing is written.
"""

import csv
import io
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import pandas as pd

from geoevs import PROTOCOL, layout
from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.names import NAME
from geoevs.protocol.entries import OK
from geoevs.results import ablation, complexity, costs, geometry_table, rank_agreement
from geoevs.results.escaping import csv_text
from geoevs.results.rows import ROW_FILES
from geoevs.results.run_folder import entries, leads_out
from geoevs.results.table_specs import TABLES
from geoevs.results.tables import make_table
from geoevs.results.verify_files import what_is_wrong
from geoevs.results.verify_scenes import check_pictures, check_scenes, check_scores
from geoevs.results.why_lookup import Record

CLOSE = 1e-6
"""Relative difference up to which two machines' tables have the same number."""


@dataclass
class Check:
    """One thing that was looked at.

    Args:
        name: what.
        looked: how much of it, in words.
        problems: what is wrong with it, a sentence each.
    """

    name: str
    looked: str = ""
    problems: list[str] = field(default_factory=list)


def verify_run(run: Path, rescore: int) -> list[Check]:
    """Look at everything in a run's folder that can be looked at without running anything.

    Args:
        run: the run's folder.
        rescore: how many renders, the same ones every time, are scored again.

    Raises:
        GeoEvsError: there is no such folder.
    """
    if not run.is_dir():
        raise GeoEvsError(f"there is no folder {run}; name a run under results, or its folder")
    checks = [_looked("files", partial(check_files, run))]
    try:
        record = Record(run)
    except GeoEvsError as error:  # without which nothing else can be looked at
        return [*checks, Check("manifest", problems=[reason_of(error)])]
    last = partial(check_scores, count=rescore)
    looks = {name: partial(look, record) for name, look in {**CHECKS, "scores": last}.items()}
    return [*checks, *(_looked(name, look) for name, look in looks.items())]


def _looked(name: str, look: Callable[[list[str]], str]) -> Check:
    """What a look at a run finds; what it raises is a problem, as broken files raise anything."""
    check = Check(name)
    try:
        check.looked = look(check.problems)
    except Exception as error:
        check.problems.append(reason_of(error))
    return check


def check_files(run: Path, problems: list[str]) -> str:
    """Nothing but files of the kinds that runs have, each what its name says, none elsewhere."""
    count = 0
    for entry in entries(run):
        if leads_out(entry, run):
            problems.append(f"{entry.path} is a link that leads out of the run")
        elif not entry.is_dir():
            count += 1
            if wrong := what_is_wrong(Path(entry.path)):
                problems.append(f"{entry.path} {wrong}")
    return f"{count} files"


def check_manifest(record: Record, problems: list[str]) -> str:
    """The manifest says all that manifests say, and the protocol is this version's."""
    manifest, run = record.manifest, record.run
    problems += [
        f"{run / layout.MANIFEST} says no '{name}'"
        for name in ("inputs", "versions", "machine")
        if not manifest[name]
    ]
    if manifest["protocol"] != PROTOCOL:
        problems.append(
            f"{run / layout.MANIFEST} is of protocol {manifest['protocol']}, not {PROTOCOL}; its "
            "numbers mean something else"
        )
    return f"commit {manifest['commit']}, protocol {manifest['protocol']}"


def check_rows(record: Record, problems: list[str]) -> str:
    """Every file of rows can be read, is of this run's entrants, and its values are values."""
    run, counts = record.run, []
    needed = (layout.SCORES, layout.COSTS, layout.SET_SCORES)
    for name in ROW_FILES:
        if name not in needed and not (run / name).exists():
            continue
        rows = record.scores if name == layout.SCORES else record.read(name)
        counts.append(f"{len(rows)} in {name}")
        if name == layout.SCORES:
            lost = int((rows["value"].isna() & (rows["status"] == OK)).sum())
            if lost:
                problems.append(f"{run / name}: {lost} rows are ok and have no value")
        if name != layout.SCORES and "method" in rows:
            known = set(record.scores["method"].unique()) | {""}
            problems += [
                f"{run / name}: '{method}' has no rows in {layout.SCORES}"
                for method in rows["method"].unique()
                if method not in known and NAME.fullmatch(method)
            ]
    record.entrants.name("")  # which reads them
    return ", ".join(counts)


def check_tables(record: Record, problems: list[str]) -> str:
    """Every table is what the rows give."""
    files = sorted((record.run / "tables").glob("*.csv"))
    if not files:
        problems.append(
            f"{record.run / 'tables'} holds no tables; make them with `snakemake tables`"
        )
    for path in files:
        if path.stem not in MAKERS:
            problems.append(f"{path} is no table that rows give")
            continue
        made = csv_text(MAKERS[path.stem](record))
        found = path.read_text(encoding="utf-8")
        if found != made:
            problems += [f"{path}: {text}" for text in _differences(found, made)]
    return f"{len(files)} tables"


def _differences(found: str, made: str) -> Iterator[str]:
    """The first cell of a table that is not what the rows give, if any is."""
    lines, expected = (list(csv.reader(io.StringIO(text))) for text in (found, made))
    header = expected[0]
    if lines[:1] != [header] or len(lines) != len(expected):
        yield "other columns, or another number of lines, than the rows give; make it again"
        return
    for number, (line, right) in enumerate(zip(lines[1:], expected[1:], strict=True), 2):
        for name, cell, value in zip(header, line, right, strict=False):
            if not _same(cell, value):
                yield f"line {number} says {name} = {cell or 'nothing'}, the rows give {value}"
                return


def _same(cell: str, value: str) -> bool:
    if cell == value:
        return True
    try:
        return math.isclose(float(cell), float(value), rel_tol=CLOSE, abs_tol=CLOSE)
    except ValueError:
        return False


def _table(name: str, record: Record) -> pd.DataFrame:
    sets = record.read(layout.SET_SCORES)
    return make_table(name, record.scores, record.settings, record.entrants, sets)


MAKERS: dict[str, Callable[[Record], pd.DataFrame]] = {
    **{name: partial(_table, name) for name in TABLES},
    "ablation": lambda of: ablation.make_ablation_table(of.scores, of.settings, of.entrants),
    "costs": lambda of: costs.make_cost_table(of.costs, of.entrants),
    "complexity": lambda of: complexity.make_complexity_table(of.scores, of.costs, of.entrants),
    "geometry": lambda of: geometry_table.make_geometry_table(
        of.read(layout.DEPTH_SCORES), of.settings
    ),
    "rank_agreement": lambda of: rank_agreement.make_rank_agreement(of.scores, of.settings),
}
"""What makes each of a run's tables from its rows."""

CHECKS: dict[str, Callable[[Record, list[str]], str]] = {
    "manifest": check_manifest,
    "rows": check_rows,
    "scenes": check_scenes,
    "pictures": check_pictures,
    "tables": check_tables,
}
"""What is looked at: each adds to a list of problems, and says how much it has looked at."""

SHOWN = 3
"""Problems that are named of a check."""


def verification_text(checks: list[Check]) -> list[str]:
    """The checks as lines of a table, the first problems of each below it."""
    lines = []
    for check in checks:
        result = "FAILED" if check.problems else "ok"
        lines.append(f"{check.name:10} {result:7} {check.looked}".rstrip())
        lines += [f"           - {problem}" for problem in check.problems[:SHOWN]]
        if len(check.problems) > SHOWN:
            lines.append(f"           ... and {len(check.problems) - SHOWN} more")
    return lines
