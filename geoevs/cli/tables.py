"""From score rows to tables, for people, spreadsheets and papers; and the chart of sizes."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs import layout
from geoevs.cli.arguments import (
    Costs,
    EntrantsFile,
    Scores,
    SetScores,
    TablesSection,
    read_rows,
    table_settings,
)

TableOut = Annotated[Path, typer.Option(help="Path without suffix; .csv, .md ... are added.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (
        table,
        ablation_table,
        cost_table,
        geometry_table,
        complexity_table,
        complexity_chart,
        rank_agreement,
    ):
        app.command()(command)


def table(
    name: Annotated[str, typer.Argument(help="extrapolation, interpolation, observed, ...")],
    scores: Scores,
    settings: TablesSection,
    entrants: EntrantsFile,
    out: TableOut,
    sets: SetScores = None,
) -> None:
    """Make one table as CSV, Markdown and LaTeX."""
    from geoevs.results.entrants import Entrants
    from geoevs.results.formats import write_table
    from geoevs.results.rows import read_scores
    from geoevs.results.table_specs import rows_needed, table_spec

    needed = rows_needed(table_spec(name))  # a mistake in the name is said before one in the files
    parsed, who = table_settings(settings), Entrants.read(entrants)
    distances = None if sets is None else read_rows(sets, layout.SET_SCORES)
    write_table(out, name, read_scores(scores, needed), parsed, who, distances)


def ablation_table(
    scores: Scores, settings: TablesSection, entrants: EntrantsFile, out: TableOut
) -> None:
    """Compare a method's variants with the full model, as CSV, Markdown and LaTeX."""
    from geoevs.results.ablation import rows_needed, write_ablation_table
    from geoevs.results.entrants import Entrants
    from geoevs.results.rows import read_scores

    who = Entrants.read(entrants)
    parsed = table_settings(settings)
    write_ablation_table(out, read_scores(scores, rows_needed(parsed)), parsed, who)


def cost_table(costs: Costs, entrants: EntrantsFile, out: TableOut) -> None:
    """Make the table of times, memory and sizes as CSV and Markdown."""
    from geoevs.results.costs import write_cost_table
    from geoevs.results.entrants import Entrants

    write_cost_table(out, read_rows(costs, layout.COSTS), Entrants.read(entrants))


def geometry_table(
    scores: Annotated[Path, typer.Option(help="The run's depth-scores.parquet.")],
    settings: TablesSection,
    out: TableOut,
) -> None:
    """Make the table of depth before and after fine-tuning as CSV, Markdown and LaTeX."""
    from geoevs.results.geometry_table import write_geometry_table

    parsed = table_settings(settings)
    write_geometry_table(out, read_rows(scores, layout.DEPTH_SCORES), parsed)


def complexity_table(scores: Scores, costs: Costs, entrants: EntrantsFile, out: TableOut) -> None:
    """Compare the sizes that methods chose with fixed ones, as CSV and Markdown."""
    from geoevs.results.complexity import ROWS_NEEDED, write_complexity_table
    from geoevs.results.entrants import Entrants
    from geoevs.results.rows import read_scores

    who = Entrants.read(entrants)
    write_complexity_table(
        out, read_scores(scores, ROWS_NEEDED), read_rows(costs, layout.COSTS), who
    )


def complexity_chart(
    scores: Scores,
    costs: Costs,
    settings: TablesSection,
    entrants: EntrantsFile,
    out: Annotated[Path, typer.Option(help="Path without suffix; .csv, .png and .html are added.")],
) -> None:
    """Draw accuracy over size with the chosen one, as CSV, PNG and a page without network."""
    from geoevs.results.complexity import ROWS_NEEDED
    from geoevs.results.complexity_chart import write_size_chart
    from geoevs.results.entrants import Entrants
    from geoevs.results.rows import read_scores

    parsed, who = table_settings(settings), Entrants.read(entrants)
    write_size_chart(
        out, read_scores(scores, ROWS_NEEDED), read_rows(costs, layout.COSTS), parsed, who
    )


def rank_agreement(scores: Scores, settings: TablesSection, out: TableOut) -> None:
    """Compare the order of methods with the paper's, as CSV and Markdown."""
    from geoevs.results.rank_agreement import ROWS_NEEDED, write_rank_agreement
    from geoevs.results.rows import read_scores

    parsed = table_settings(settings)
    write_rank_agreement(out, read_scores(scores, ROWS_NEEDED), parsed)
