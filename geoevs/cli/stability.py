"""The stability suite as commands: stressed scenes, what methods make of them, and the curves."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import (
    EntrantsFile,
    Out,
    Run,
    SceneFolder,
    TablesSection,
    parse_json,
    read_rows,
    table_settings,
)

Settings = Annotated[str, typer.Option(help="The config's stability section, as JSON.")]
Group = Annotated[str, typer.Option(help="The stressor, or clean.")]
Method = Annotated[str, typer.Option(help="The method's name.")]
Seed = Annotated[int, typer.Option(min=0, help="The run's seed.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (
        *(stress, stability_targets, stability_render, stability_score),
        *(stability_table, stability_chart),
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
    from geoevs.protocol.stability import stability_targets as make_targets
    from geoevs.protocol.targets import write_targets
    from geoevs.scenes.store import Scene

    write_targets(out, make_targets(Scene(scene), parse_json("--settings", settings)))


def stability_render(
    scenes: Annotated[list[Path], typer.Argument(help="What methods are given, by condition.")],
    method: Method,
    group: Group,
    settings: Settings,
    targets: Annotated[Path, typer.Option(help="The clean scene's target list.")],
    masks: Annotated[Path, typer.Option(help="The masks that `geoevs references` wrote.")],
    out: Out,
    method_log: Annotated[Path, typer.Option(help="Where the method's own output goes.")],
    options: Annotated[str, typer.Option(help="The method's own, as a JSON object.")] = "{}",
    variant: str = "default",
    seed: Seed = 0,
) -> None:
    """Fit and render a method under all conditions of a stressor; failures are written down."""
    from geoevs.protocol.entries import MethodEntry
    from geoevs.protocol.stability import conditions, render_conditions

    entry = MethodEntry(method, variant, parse_json("--options", options), seed)
    wanted = conditions(group, parse_json("--settings", settings))
    pairs = list(zip(wanted, scenes, strict=True))
    render_conditions(entry, pairs, targets, masks, out, method_log)


def stability_score(
    run: Run,
    dataset: Annotated[str, typer.Option(help="The data set's name in the config.")],
    scene: Annotated[str, typer.Option(help="The scene's name in the config.")],
    method: Method,
    group: Group,
    settings: Settings,
    out: Out,
    variant: str = "default",
    seed: Seed = 0,
) -> None:
    """Score what a method rendered under all conditions of a stressor."""
    from geoevs import layout
    from geoevs.core.files import write_bytes
    from geoevs.protocol.entries import MethodEntry
    from geoevs.protocol.rows import protocol_fingerprint, score_frame
    from geoevs.protocol.stability_scoring import score_conditions
    from geoevs.scenes.store import Scene

    section = parse_json("--settings", settings)
    place = {"dataset": dataset, "scene": scene}
    store = Scene(run / layout.SCENE.format(**place))
    # Levels and draws are columns; poses are all that scores of two scenes must share.
    poses = {"lateral": section["lateral"]}
    common = {**place, "fingerprint": protocol_fingerprint(store, poses)}
    entry = MethodEntry(method, variant, {}, seed)
    rows = score_conditions(entry, group, run, scene, section, common)
    write_bytes(out, score_frame(rows).to_parquet(index=False))


def stability_table(
    scores: Annotated[Path, typer.Option(help="The stability suite's score rows.")],
    settings: TablesSection,
    entrants: EntrantsFile,
    out: Annotated[Path, typer.Option(help="The folder for its tables.")],
) -> None:
    """Make the curves, the breaking points and the seed spread as CSV, and a page of the latter."""
    from geoevs.core.files import write_text
    from geoevs.results.entrants import Entrants
    from geoevs.results.stability import breaking_points, make_stability_table, seed_spread
    from geoevs.results.stability_page import stability_markdown

    given = read_rows(scores), table_settings(settings), Entrants.read(entrants)
    made, broken, spread = (
        make(*given) for make in (make_stability_table, breaking_points, seed_spread)
    )
    for name, table in (("stability", made), ("breaking_points", broken), ("seed_spread", spread)):
        write_text(out / f"{name}.csv", table.to_csv(index=False))
    write_text(out / "breaking_points.md", stability_markdown(made, broken, spread))


def stability_chart(
    stressor: Annotated[str, typer.Argument(help="Whose curves to draw.")],
    table: Annotated[Path, typer.Option(help="stability.csv.")],
    out: Annotated[Path, typer.Option(help="Path without suffix; .csv, .png and .html are added.")],
) -> None:
    """Draw every method's curve over the levels of a stressor."""
    import pandas as pd

    from geoevs.core.files import write_text
    from geoevs.results.chart_pages import write_page
    from geoevs.results.stability_chart import curves, stability_curves

    shown = curves(pd.read_csv(table), stressor)
    drawn = stability_curves(shown, stressor)
    write_text(out.with_suffix(".csv"), shown.to_csv(index=False))
    write_page(out, drawn)
