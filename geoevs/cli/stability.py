"""The stability suite as commands: stressed scenes, what methods make of them, and the curves."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs import layout
from geoevs.cli.arguments import (
    Attempt,
    Dataset,
    EntrantsFile,
    FitLimit,
    MethodName,
    MethodOptions,
    Out,
    RenderLimit,
    Run,
    SceneFolder,
    SceneInRun,
    TablesSection,
    parse_json,
    read_rows,
    table_settings,
)

Settings = Annotated[str, typer.Option(help="The config's stability section, as JSON.")]
Group = Annotated[str, typer.Option(help="The stressor, or clean.")]
Seed = Annotated[int, typer.Option(min=0, help="The run's seed.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (
        stress,
        stability_targets,
        stability_render,
        stability_score,
        stability_table,
        stability_chart,
    ):
        app.command()(command)


def stress(
    scene: Annotated[Path, typer.Argument(help="The clean scene store.")],
    stressor: Annotated[str, typer.Option(help="support, beams, rotation, translation, ...")],
    level: Annotated[float, typer.Option(help="How hard, in the stressor's unit.")],
    out: Out,
    seed: Annotated[int, typer.Option(min=0, help="What is lost, which way errors go.")] = 0,
) -> None:
    """Write the scene store that worse sensors or a worse calibration would have given."""
    from geoevs.protocol.stressors import write_stressed
    from geoevs.scenes.store import Scene

    write_stressed(out, Scene(scene), stressor, level, seed)


def stability_targets(scene: SceneFolder, settings: Settings, out: Out) -> None:
    """List the views that stability is tested on."""
    from geoevs.protocol.provenance import targets_stamp
    from geoevs.protocol.stability import stability_targets as make_targets
    from geoevs.protocol.targets import write_targets
    from geoevs.scenes.store import Scene

    asked, store = parse_json("--settings", settings), Scene(scene)
    write_targets(out, make_targets(store, asked), targets_stamp(store, asked, 0))


def stability_render(
    scenes: Annotated[list[Path], typer.Argument(help="What methods are given, by stress.")],
    method: MethodName,
    group: Group,
    settings: Settings,
    targets: Annotated[Path, typer.Option(help="The clean scene's target list.")],
    masks: Annotated[Path, typer.Option(help="The masks that `geoevs references` wrote.")],
    out: Out,
    method_log: Annotated[Path, typer.Option(help="Where the method's own output goes.")],
    options: MethodOptions = "{}",
    variant: str = "default",
    seed: Seed = 0,
    fit_limit: FitLimit = None,
    render_limit: RenderLimit = None,
    attempt: Attempt = 0,
) -> None:
    """Fit and render a method under all stresses of a group; failures are written down."""
    from geoevs.protocol.entries import MethodEntry
    from geoevs.protocol.stability import render_stresses, stresses

    entry = MethodEntry(method, variant, parse_json("--options", options), seed)
    given = zip(stresses(group, parse_json("--settings", settings)), scenes, strict=True)
    limits = {"fit": fit_limit, "render": render_limit}
    render_stresses(entry, list(given), targets, masks, out, method_log, limits, attempt)


def stability_score(
    run: Run,
    dataset: Dataset,
    scene: SceneInRun,
    method: MethodName,
    group: Group,
    settings: Settings,
    out: Out,
    variant: str = "default",
    seed: Seed = 0,
    run_seed: Annotated[int, typer.Option(min=0, help="The config's seed.")] = 0,
) -> None:
    """Score what a method rendered under all stresses of a group."""
    from geoevs.core.parquet import write_parquet
    from geoevs.protocol.entries import MethodEntry
    from geoevs.protocol.provenance import check_answers
    from geoevs.protocol.stability_scoring import score_stresses
    from geoevs.run import Answers

    entry, clean = MethodEntry(method, variant, {}, seed), Answers(run, dataset, scene)
    check_answers(clean, run_seed)
    write_parquet(out, score_stresses(entry, group, clean, parse_json("--settings", settings)))


def stability_table(
    scores: Annotated[Path, typer.Option(help="The stability suite's score rows.")],
    settings: TablesSection,
    entrants: EntrantsFile,
    out: Annotated[Path, typer.Option(help="The folder for its tables.")],
) -> None:
    """Make the curves, the breaking points and the seed spread as CSV, and a page of the latter."""
    from geoevs.results.entrants import Entrants
    from geoevs.results.stability_page import write_stability

    who = Entrants.read(entrants)
    write_stability(out, read_rows(scores, layout.STABILITY_SCORES), table_settings(settings), who)


def stability_chart(
    stressor: Annotated[str, typer.Argument(help="Whose curves to draw.")],
    table: Annotated[Path, typer.Option(help="stability.csv.")],
    out: Annotated[Path, typer.Option(help="Path without suffix; .csv, .png and .html are added.")],
) -> None:
    """Draw every method's curve over the levels of a stressor."""
    import pandas as pd

    from geoevs.core.files import whole_file
    from geoevs.results.stability_chart import write_stability_chart

    with whole_file(table):  # a variant may be called null
        rows = pd.read_csv(table, keep_default_na=False, na_values=[""])
    write_stability_chart(out, rows, stressor)
