"""The stages of the protocol as commands; the workflow's rules call these."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import (
    Attempt,
    Dataset,
    FitLimit,
    MethodName,
    Out,
    RenderLimit,
    Run,
    SceneFolder,
    SceneInRun,
    TargetFile,
    parse_json,
)
from geoevs.core.progress import progress_bar

Source = Annotated[str, typer.Option(help="The scene's data source: street, pandaset, ...")]
SceneName = Annotated[str, typer.Option(help="The scene: NAME or NAME@FIRST-LAST.")]
Options = Annotated[str, typer.Option(help="Options as a JSON object.")]
MaskFile = Annotated[Path, typer.Option(help="The masks that `geoevs references` wrote.")]
OfOracles = Annotated[str, typer.Option(help="For the controls reference and truth alone.")]
Size = Annotated[int, typer.Option(min=1, help="Pixels.")]
Seed = Annotated[int, typer.Option(min=0, help="The run's seed.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (
        scene,
        targets,
        truth,
        truth_features,
        references,
        fit,
        render,
        score,
        score_sets,
        export,
        export_colmap,
    ):
        app.command()(command)


def scene(
    source: Source,
    name: SceneName,
    height: Size,
    width: Size,
    out: Out,
    depths: Annotated[Path, typer.Option(help="Where dense true depth goes, if known.")],
    options: Options = "{}",
    data: Annotated[str, typer.Option(help="Hash of the files that it is read from.")] = "none",
) -> None:
    """Read or render a scene into a scene store, its LiDAR coloured by its cameras."""
    from geoevs.projection.coloured_scenes import write_coloured_scene
    from geoevs.protocol.provenance import scene_stamp
    from geoevs.scenes.scene import SceneRef, load_source

    settings = parse_json("--options", options)
    record = load_source(source, height, width, settings).open(SceneRef.parse(name))
    made_with = scene_stamp(source, name, (height, width), settings, data)
    with progress_bar(f"scene {name}", record.frame_count) as advance:
        write_coloured_scene(out, depths, record, advance, made_with)


def targets(
    scene: SceneFolder,
    protocol: Annotated[str, typer.Option(help="The config's protocol section, as JSON.")],
    out: Out,
    seed: Seed = 0,
) -> None:
    """List the views to synthesise: observed, interpolation, extrapolation, sweep and masked."""
    from geoevs.protocol.provenance import targets_stamp
    from geoevs.protocol.targets import make_targets, write_targets
    from geoevs.scenes.store import Scene

    settings, store = parse_json("--protocol", protocol), Scene(scene)
    made_with = targets_stamp(store, settings, seed)
    write_targets(out, make_targets(store, settings, seed), made_with)


def truth(
    source: Source,
    name: SceneName,
    height: Size,
    width: Size,
    targets: TargetFile,
    out: Out,
    options: Options = "{}",
) -> None:
    """Render dense truth at virtual targets, for sources that can; no method may see it."""
    from geoevs.protocol.targets import read_targets, virtual_targets
    from geoevs.protocol.truth import write_truth
    from geoevs.scenes.scene import SceneRef, load_source

    views = read_targets(targets)
    data = load_source(source, height, width, parse_json("--options", options))
    with progress_bar(f"truth {name}", len(virtual_targets(views))) as advance:
        write_truth(out, data, SceneRef.parse(name), views, advance)


def truth_features(run: Run, dataset: Dataset, scene: SceneInRun, out: Out) -> None:
    """Keep what a network sees in a scene's true pictures, for `geoevs score-sets`."""
    from geoevs.protocol.set_scoring import write_truth_features
    from geoevs.run import Answers

    write_truth_features(out, Answers(run, dataset, scene))


def references(
    scene: SceneFolder,
    targets: TargetFile,
    out: Out,
    masks: Annotated[Path, typer.Option(help="Where the masks of masked targets go.")],
    seed: Seed = 0,
) -> None:
    """Project the scoring LiDAR points into every virtual target (the LPSR reference).

    The masks that degrade the conditions of masked targets come with it, in a file of their own.
    """
    from geoevs.protocol.provenance import references_stamp
    from geoevs.protocol.reference import write_references
    from geoevs.protocol.targets import read_targets
    from geoevs.scenes.store import Scene

    store = Scene(scene)
    made_with = references_stamp(store, targets, seed)
    write_references(out, masks, store, read_targets(targets), seed, made_with)


def fit(
    method: MethodName,
    scene: SceneFolder,
    targets: TargetFile,
    out: Out,
    method_log: Annotated[Path, typer.Option(help="Where the method's own output goes.")],
    variant: str = "default",
    options: Options = "{}",
    seed: Seed = 0,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    fit_seconds: Annotated[float | None, typer.Option(help="Wall time it should take.")] = None,
    limit: FitLimit = None,
    attempt: Attempt = 0,
) -> None:
    """Fit a method to a scene; a failure is written down, not raised."""
    from geoevs.methods.contract import Budget
    from geoevs.protocol.entries import MethodEntry
    from geoevs.protocol.runs import fit_method

    entry = MethodEntry(method, variant, parse_json("--options", options), seed)
    budget = Budget(fit_seconds, threads)
    fit_method(entry, scene, targets, budget, out, method_log, limit, attempt)


def render(
    method: MethodName,
    model: Annotated[Path, typer.Option(help="What `geoevs fit` wrote.")],
    targets: TargetFile,
    masks: MaskFile,
    out: Out,
    method_log: Annotated[Path, typer.Option(help="Where the method's own output goes.")],
    run: OfOracles = "",
    dataset: OfOracles = "",
    scene: OfOracles = "",
    limit: RenderLimit = None,
    attempt: Attempt = 0,
) -> None:
    """Render a scene's targets with a fitted method; a failure is written down, not raised."""
    from geoevs.protocol.entries import MethodEntry
    from geoevs.protocol.runs import render_method

    answers = {"run": run, "dataset": dataset, "scene": scene}
    entry = MethodEntry(method)
    render_method(entry, model, targets, masks, out, method_log, answers, limit, attempt)


def score(
    method: MethodName,
    run: Run,
    dataset: Dataset,
    scene: SceneInRun,
    protocol: Annotated[str, typer.Option(help="The config's protocol section, as JSON.")],
    out: Out,
    costs: Annotated[Path, typer.Option(help="Where the cost rows go.")],
    variant: str = "default",
    seed: Seed = 0,
    run_seed: Annotated[int, typer.Option(min=0, help="The config's seed.")] = 0,
) -> None:
    """Score a method's renders of a scene: one row a target and metric."""
    from geoevs.core.parquet import write_parquet
    from geoevs.protocol.entries import MethodEntry
    from geoevs.protocol.provenance import check_answers, check_renders
    from geoevs.protocol.rows import cost_frame, protocol_fingerprint, score_frame
    from geoevs.protocol.scoring import cost_rows, score_method
    from geoevs.run import Answers

    settings = parse_json("--protocol", protocol)
    entry, answers = MethodEntry(method, variant, {}, seed), Answers(run, dataset, scene)
    check_answers(answers, run_seed, settings)
    check_renders(answers, entry.label)
    fingerprint = protocol_fingerprint(answers.scene, settings)
    rows = score_method(entry, answers, settings["reference_keep"], fingerprint)
    write_parquet(out, score_frame(rows))
    write_parquet(costs, cost_frame(cost_rows(entry, answers)))


def score_sets(
    method: MethodName,
    run: Run,
    dataset: Dataset,
    scenes: Annotated[list[str], typer.Option(help="A test scene of it; repeat for more.")],
    confidence: Annotated[float, typer.Option(min=0, max=1, help="Of the intervals.")],
    protocol: Annotated[str, typer.Option(help="The config's protocol section, as JSON.")],
    out: Out,
    views: Annotated[Path, typer.Option(help="Where the score rows of single views go.")],
    variant: str = "default",
    seed: Seed = 0,
) -> None:
    """Score a method's views of a data set as a set of images: FID and KID, or what stands in."""
    from geoevs.core.parquet import write_parquet
    from geoevs.protocol.entries import MethodEntry
    from geoevs.protocol.rows import score_frame
    from geoevs.protocol.set_scoring import score_sets as score
    from geoevs.protocol.set_scoring import set_frame

    settings = parse_json("--protocol", protocol)
    entry = MethodEntry(method, variant, {}, seed)
    sets, scores = score(entry, run, dataset, scenes, confidence, settings)
    write_parquet(out, set_frame(sets))
    write_parquet(views, score_frame(scores))


def export(
    scene: SceneFolder,
    targets: TargetFile,
    out: Out,
    sources: Annotated[
        str, typer.Option(help="all-cameras, or front-side for interpolation.")
    ] = "all-cameras",
) -> None:
    """Write what a method may see as a scene folder, and the cameras to render as cameras.json.

    For methods in another environment or language: they leave <camera>/<frame>.png, six digits a
    frame, which the method `external` scores.
    """
    from geoevs.protocol.export import export_views
    from geoevs.protocol.targets import read_targets
    from geoevs.scenes.store import Scene

    export_views(out, Scene(scene), read_targets(targets), sources)


def export_colmap(
    scene: Annotated[Path, typer.Argument(help="a scene store")],
    out: Out,
) -> None:
    """Write a scene store as a COLMAP text model with its images, for tools that read those.

    The points are LiDAR that may condition methods; what scores them is left out.
    """
    from geoevs.scenes.interop import export_colmap as write_colmap
    from geoevs.scenes.store import Scene

    write_colmap(Scene(scene), out)
