"""The metric on trial, as commands."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs import layout
from geoevs.cli.arguments import (
    Dataset,
    EntrantsFile,
    Out,
    Run,
    SceneInRun,
    TablesSection,
    parse_json,
    read_rows,
    table_settings,
)


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (audit_scene, audit_page):
        app.command()(command)


def audit_scene(
    run: Run,
    dataset: Dataset,
    scene: SceneInRun,
    entrants: Annotated[str, typer.Option(help="[method, variant, seed] of each, as JSON.")],
    out: Out,
    seed: Annotated[int, typer.Option(min=0, help="The run's seed.")] = 0,
) -> None:
    """Set every sparse metric beside its dense twin, and every reference pixel beside the truth."""
    from geoevs.core.parquet import write_parquet
    from geoevs.protocol.audit import audit_rows
    from geoevs.protocol.entries import MethodEntry
    from geoevs.run import Answers

    entries = [
        MethodEntry(method, variant, {}, number)
        for method, variant, number in parse_json("--entrants", entrants, list)
    ]
    write_parquet(out, audit_rows(Answers(run, dataset, scene), entries, seed))


def audit_page(
    rows: Annotated[Path, typer.Option(help="The audit's rows.")],
    settings: TablesSection,
    entrants: EntrantsFile,
    out: Annotated[Path, typer.Option(help="The folder for its page, tables and charts.")],
) -> None:
    """Say in words, tables and charts how far the sparse metric can be trusted."""
    from geoevs.results.audit_page import write_audit
    from geoevs.results.entrants import Entrants

    write_audit(
        out, read_rows(rows, layout.AUDIT_ROWS), table_settings(settings), Entrants.read(entrants)
    )
