"""The metric on trial, as commands."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import (
    EntrantsFile,
    Out,
    Run,
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
    dataset: Annotated[str, typer.Option(help="The data set's name in the config.")],
    scene: Annotated[str, typer.Option(help="The scene's name in the config.")],
    entrants: Annotated[str, typer.Option(help="[method, variant, seed] of each, as JSON.")],
    out: Out,
    seed: Annotated[int, typer.Option(min=0, help="The run's seed.")] = 0,
) -> None:
    """Set every sparse metric beside its dense twin, and every reference pixel beside the truth."""
    import pandas as pd

    from geoevs.core.files import write_bytes
    from geoevs.protocol.audit import AUDIT_TYPES, audit_rows
    from geoevs.protocol.entries import MethodEntry

    entries = [
        MethodEntry(method, variant, {}, number)
        for method, variant, number in parse_json("--entrants", entrants, list)
    ]
    rows = audit_rows(run, dataset, scene, entries, seed)
    table = pd.DataFrame(rows, columns=list(AUDIT_TYPES)).astype(AUDIT_TYPES)
    write_bytes(out, table.to_parquet(index=False))


def audit_page(
    rows: Annotated[Path, typer.Option(help="The audit's rows.")],
    settings: TablesSection,
    entrants: EntrantsFile,
    out: Annotated[Path, typer.Option(help="The folder for its page, tables and charts.")],
) -> None:
    """Say in words, tables and charts how far the sparse metric can be trusted."""
    from geoevs.core.files import write_text
    from geoevs.results.audit import audit_tables
    from geoevs.results.audit_chart import agreement_chart, support_chart
    from geoevs.results.audit_page import audit_markdown
    from geoevs.results.chart_pages import write_page
    from geoevs.results.entrants import Entrants

    who = Entrants.read(entrants)
    tables = audit_tables(read_rows(rows), table_settings(settings), who)
    for name, table in tables.items():
        write_text(out / f"{name}.csv", table.to_csv(index=False))
    charts = {"agreement": agreement_chart, "support_bias": support_chart}
    for name, draw in charts.items():
        write_page(out / name, draw(tables[name]))
    write_text(out / "audit.md", audit_markdown(tables))
