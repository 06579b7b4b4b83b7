"""From score rows to what people read: pictures, charts, the manifest, the failures."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from geoevs import layout
from geoevs.cli.arguments import (
    Costs,
    EntrantsFile,
    Out,
    Run,
    RunOrFolder,
    Scores,
    SetScores,
    TablesSection,
    parse_json,
    read_rows,
    run_folder,
    scene_pairs,
    table_settings,
)
from geoevs.core.text import printable

RunName = Annotated[str, typer.Option(help="The run's name, or its folder.")]
DatasetName = Annotated[str, typer.Option(help="The data set; left out, the first.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (
        collect,
        entrants,
        grid,
        chart,
        report,
        hash,
        manifest,
        install_weights,
        failures,
        why,
        compare,
        verify,
    ):
        app.command()(command)


def collect(
    out: Out,
    parts: Annotated[
        list[Path] | None, typer.Argument(help="Parquet files with the same columns.")
    ] = None,
    listed: Annotated[
        typer.FileText | None,
        typer.Option(
            "--list",
            help="A file that names more of them, one a line; -: the input.",
            encoding="utf-8",
            errors="surrogateescape",
        ),
    ] = None,
) -> None:
    """Put the rows of many jobs into one Parquet file, in the order given, one job at a time."""
    from geoevs.core.parquet import join_parquet

    more = [] if listed is None else map(Path, listed.read().splitlines())
    join_parquet(out, [*(parts or []), *more])


def entrants(
    options: Annotated[
        str, typer.Option(help="The options of every entrant, by its name in the config, as JSON.")
    ],
    out: Out,
) -> None:
    """Write down what each entrant says of itself: name, paradigm, prior, needs, citation."""
    from geoevs.core.files import write_json
    from geoevs.protocol.entrants import describe_entrants

    write_json(out, describe_entrants(parse_json("--options", options)))


def grid(
    name: Annotated[str, typer.Argument(help="The table whose targets to show.")],
    run: Run,
    scenes: Annotated[list[str], typer.Option(help="DATASET/SCENE; repeat for more rows.")],
    keeps: Annotated[str, typer.Option(help="protocol.reference_keep, as JSON.")],
    out: Out,
    labels: Annotated[
        list[str] | None,
        typer.Option(help="An entrant's label; repeat for columns. None: renders were dropped."),
    ] = None,
    count: Annotated[
        int | None, typer.Option(min=1, help="Random targets, in place of a few telling ones.")
    ] = None,
) -> None:
    """Draw a table's grid: truth, reference, validity and every method side by side."""
    from geoevs.core.files import write_bytes
    from geoevs.results.figures import table_grid

    pairs = scene_pairs(scenes)
    shares = parse_json("--keeps", keeps, list)
    write_bytes(out, table_grid(name, run, pairs, labels or [], shares, count))


def chart(
    name: Annotated[str, typer.Argument(help="The table whose views to chart.")],
    scores: Scores,
    costs: Costs,
    settings: TablesSection,
    entrants: EntrantsFile,
    out: Annotated[Path, typer.Option(help="Path without suffix; .csv, .png and .html are added.")],
    sets: SetScores = None,
) -> None:
    """Draw speed against accuracy, with the frontier, as CSV, PNG and a page without network."""
    from geoevs.results.chart_pages import write_chart
    from geoevs.results.entrants import Entrants
    from geoevs.results.rows import read_scores
    from geoevs.results.table_specs import rows_needed, table_spec

    needed = rows_needed(table_spec(name))
    parsed, who = table_settings(settings), Entrants.read(entrants)
    distances = None if sets is None else read_rows(sets, layout.SET_SCORES)
    write_chart(
        out,
        name,
        read_scores(scores, needed),
        read_rows(costs, layout.COSTS),
        parsed,
        who,
        distances,
    )


def report(
    run: Run, out: Out, threads: Annotated[int, typer.Option(min=1, help="At most so many.")] = 1
) -> None:
    """Put a run's tables, charts, pictures and failures on one page that needs no network."""
    from geoevs.core.files import write_text
    from geoevs.results.report.page import make_page

    write_text(out, make_page(run, threads))


def manifest(
    inputs: Annotated[list[Path], typer.Argument(help="Weights, score files, folders.")],
    config: Annotated[str, typer.Option(help="The merged config, as JSON.")],
    out: Out,
    configfiles: Annotated[
        list[str] | None, typer.Option(help="The files that the config came from; repeat for more.")
    ] = None,
    hashed: Annotated[
        list[Path] | None, typer.Option(help="What `geoevs hash` wrote; repeat for more.")
    ] = None,
) -> None:
    """Write down the commit, config, input hashes, versions, machine and seed of a run."""
    from geoevs.core.files import write_json
    from geoevs.results.manifest import make_manifest

    settings = parse_json("--config", config)
    write_json(out, make_manifest(settings, inputs, configfiles or [], hashed or []))


def hash(path: Annotated[Path, typer.Argument(help="A file or folder.")], out: Out) -> None:
    """Write down the hash of a file or folder, for the manifest."""
    from geoevs.results.manifest import write_hash

    write_hash(path, out)


def install_weights(
    files: Annotated[list[Path], typer.Argument(help="The new weights.")],
    work: Annotated[list[str], typer.Option(help="TRAINING=FOLDER that it worked in; one each.")],
    config: Annotated[str, typer.Option(help="The merged config, as JSON.")],
    weights: Annotated[Path, typer.Option(help="The folder that trainings start from.")],
    out: Out,
) -> None:
    """Put pretrained weights where trainings start from, with what they were made of.

    Other weights in that folder, and what is written down of them, stay.
    """
    from geoevs.core.files import write_json
    from geoevs.results.manifest import install_weights as install

    folders = dict(pair.split("=", 1) for pair in work)
    trainings = {name: Path(folder) for name, folder in folders.items()}
    write_json(out, install(weights, files, trainings, parse_json("--config", config)))


def failures(
    costs: Annotated[Path, typer.Argument(help="The run's costs.parquet.")],
    stability: Annotated[
        Path | None, typer.Argument(help="The stability suite's scores.parquet.")
    ] = None,
) -> None:
    """Say in one line each which methods failed, why, and where their logs are."""
    from geoevs.results.failures import known_failures

    for failure in known_failures(costs, stability):
        print(f"FAILED: {failure}", file=sys.stderr)


def why(
    table: Annotated[str, typer.Argument(help="The table: any .csv in the run's tables folder.")],
    entrant: Annotated[
        str,
        typer.Argument(
            help="METHOD or METHOD.VARIANT, as in the config; for geometry the depth model, for "
            "rank_agreement the ranked table."
        ),
    ],
    metric: Annotated[str, typer.Argument(help="The column, such as sparse_psnr.")],
    run: RunName = "default",
    bin: Annotated[
        str,
        typer.Option(
            help="The row's bin, such as 5-10; for geometry STAGE/SCALE, for complexity the scene."
        ),
    ] = "",
    dataset: DatasetName = "",
) -> None:
    """Say where a table's number comes from: rows, pictures, config, commit, how to rerun it."""
    from geoevs.results.why import explain
    from geoevs.results.why_lookup import Cell

    for line in explain(Cell(table, entrant, metric, bin, dataset), run_folder(run)):
        print(printable(line))


def compare(
    table: Annotated[str, typer.Argument(help="extrapolation, interpolation, observed, ...")],
    first: Annotated[str, typer.Argument(help="METHOD or METHOD.VARIANT, as in the config.")],
    second: Annotated[str, typer.Argument(help="The one that is subtracted from it.")],
    run: RunName = "default",
    dataset: DatasetName = "",
) -> None:
    """Say by how much one entrant is better than another on the same views, and how surely.

    Differences are of pairs: the same view by both. Their intervals redraw frames within scenes,
    and training seeds where there are several, so that what makes a view hard for both does not
    widen them: two entrants may differ surely although their own intervals overlap.
    """
    from geoevs.results.compare import compare_entrants, comparison_text

    difference = compare_entrants(table, first, second, run_folder(run), dataset)
    for line in comparison_text(difference, first, second).splitlines():
        print(printable(line))


def verify(
    run: RunOrFolder,
    rescore: Annotated[int, typer.Option(min=0, help="Renders that are scored again.")] = 20,
) -> None:
    """Check a run's folder that somebody sent: files, rows, pictures, tables, and some scores.

    Nothing in it is run, and nothing is written. The exit code is 1 if anything is wrong.
    """
    from geoevs.results.verify import verification_text, verify_run

    checks = verify_run(run_folder(run), rescore)
    for line in verification_text(checks):
        print(printable(line))
    if any(check.problems for check in checks):
        raise typer.Exit(1)
