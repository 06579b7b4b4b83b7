"""From score rows to tables, for people, spreadsheets and papers; and the chart of sizes."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from geoevs.cli.arguments import (
    Costs,
    EntrantsFile,
    Scores,
    SetScores,
    TablesSection,
    read_rows,
    table_settings,
)

if TYPE_CHECKING:
    import pandas as pd

TableOut = Annotated[Path, typer.Option(help="Path without suffix; .csv, .md ... are added.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    commands = table, ablation_table, cost_table, geometry_table, complexity_table
    for command in (*commands, complexity_chart, rank_agreement):
        app.command()(command)


def _write(
    out: Path,
    made: "pd.DataFrame",
    markdown: "Callable[[pd.DataFrame], str]",
    latex: "Callable[[pd.DataFrame], str] | None" = None,
) -> None:
    from geoevs.core.files import write_text

    write_text(out.with_suffix(".csv"), made.to_csv(index=False))
    write_text(out.with_suffix(".md"), markdown(made))
    if latex is not None:
        write_text(out.with_suffix(".tex"), latex(made))


def table(
    name: Annotated[str, typer.Argument(help="extrapolation, interpolation, observed, ...")],
    scores: Scores,
    settings: TablesSection,
    entrants: EntrantsFile,
    out: TableOut,
    sets: SetScores = None,
) -> None:
    """Make one table as CSV, Markdown and LaTeX."""
    from functools import partial

    from geoevs.results.entrants import Entrants
    from geoevs.results.formats import to_latex, to_markdown
    from geoevs.results.table_specs import table_spec
    from geoevs.results.tables import make_table

    spec = table_spec(name)
    distances = None if sets is None else read_rows(sets)
    who = Entrants.read(entrants)
    made = make_table(name, read_rows(scores), table_settings(settings), who, distances)
    _write(out, made, partial(to_markdown, spec), partial(to_latex, spec))


def ablation_table(
    scores: Scores, settings: TablesSection, entrants: EntrantsFile, out: TableOut
) -> None:
    """Compare a method's variants with the full model, as CSV, Markdown and LaTeX."""
    from geoevs.results.ablation import ablation_latex, ablation_markdown, make_ablation_table
    from geoevs.results.entrants import Entrants

    who = Entrants.read(entrants)
    made = make_ablation_table(read_rows(scores), table_settings(settings), who)
    _write(out, made, ablation_markdown, ablation_latex)


def cost_table(costs: Costs, entrants: EntrantsFile, out: TableOut) -> None:
    """Make the table of times, memory and sizes as CSV and Markdown."""
    from geoevs.results.costs import cost_markdown, make_cost_table
    from geoevs.results.entrants import Entrants

    _write(out, make_cost_table(read_rows(costs), Entrants.read(entrants)), cost_markdown)


def geometry_table(
    scores: Annotated[Path, typer.Option(help="The run's depth-scores.parquet.")],
    settings: TablesSection,
    out: TableOut,
) -> None:
    """Make the table of depth before and after fine-tuning as CSV, Markdown and LaTeX."""
    from geoevs.results.geometry_table import (
        geometry_latex,
        geometry_markdown,
        make_geometry_table,
    )

    made = make_geometry_table(read_rows(scores), table_settings(settings))
    _write(out, made, geometry_markdown, geometry_latex)


def complexity_table(scores: Scores, costs: Costs, entrants: EntrantsFile, out: TableOut) -> None:
    """Compare the sizes that methods chose with fixed ones, as CSV and Markdown."""
    from geoevs.results.complexity import complexity_markdown, make_complexity_table
    from geoevs.results.entrants import Entrants

    who = Entrants.read(entrants)
    _write(
        out, make_complexity_table(read_rows(scores), read_rows(costs), who), complexity_markdown
    )


def complexity_chart(
    scores: Scores,
    costs: Costs,
    settings: TablesSection,
    entrants: EntrantsFile,
    out: Annotated[Path, typer.Option(help="Path without suffix; .csv, .png and .html are added.")],
) -> None:
    """Draw accuracy over size with the chosen one, as CSV, PNG and a page without network."""
    from geoevs.core.files import write_text
    from geoevs.results.chart_pages import write_page
    from geoevs.results.complexity import size_curves
    from geoevs.results.complexity_chart import size_chart
    from geoevs.results.entrants import Entrants

    who = Entrants.read(entrants)
    table = size_curves(read_rows(scores), read_rows(costs), table_settings(settings), who)
    page = size_chart(table)
    write_text(out.with_suffix(".csv"), table.to_csv(index=False))
    write_page(out, page)


def rank_agreement(scores: Scores, settings: TablesSection, out: TableOut) -> None:
    """Compare the order of methods with the paper's, as CSV and Markdown."""
    from geoevs.results.rank_agreement import make_rank_agreement, rank_agreement_markdown

    made = make_rank_agreement(read_rows(scores), table_settings(settings))
    _write(out, made, rank_agreement_markdown)
