"""Table 3 as commands: labels, generated views, detectors, what they find, and tables of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from geoevs import layout
from geoevs.cli.arguments import (
    Attempt,
    EntrantsFile,
    FitLimit,
    MethodName,
    MethodOptions,
    Out,
    RenderLimit,
    Run,
    SceneFolder,
    TablesSection,
    TargetFile,
    Work,
    parse_json,
    scene_pairs,
    table_settings,
)

if TYPE_CHECKING:
    from geoevs.detection.rigs import DetectionScene
    from geoevs.detection.settings import DetectionSettings

Section = Annotated[str, typer.Option(help="The config's detection section, as JSON.")]
Scenes = Annotated[list[str], typer.Option(help="DATASET/SCENE; repeat for more.")]
Setting = Annotated[str, typer.Option(help="blind, native, longer, augmented or with-LABEL.")]
Seed = Annotated[int, typer.Option(min=0, help="Of the detector.")]
Labels = Annotated[str, typer.Option(help="Method and variant by entrant's label, as JSON.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (
        detection_labels,
        detection_targets,
        detection_views,
        detection_backbone,
        detection_train,
        detection_find,
        task_offsets,
        detection_tables,
        detection_figure,
    ):
        app.command()(command)


def detection_labels(
    scene: SceneFolder,
    name: Annotated[str, typer.Option(help="DATASET/SCENE, as rows call it.")],
    settings: Section,
    out: Out,
) -> None:
    """List a scene's boxes in the vehicle's frame: which of them count, or why not."""
    from geoevs.core.parquet import write_parquet
    from geoevs.detection.labels import scene_labels
    from geoevs.scenes.store import Scene

    asked = _settings(settings)
    write_parquet(out, scene_labels(Scene(scene), name, asked.classes, asked.detector.range))


def detection_targets(
    scene: SceneFolder,
    settings: Section,
    out: Out,
    given: Annotated[Path, typer.Option(help="Where the store without boxes goes.")],
    moved: Annotated[bool, typer.Option("--moved", help="The rig moved aside, too.")] = False,
) -> None:
    """List the views that detectors are shown, and write the store that methods are given."""
    from geoevs.detection.views import moved_rig, views_between, write_without_boxes
    from geoevs.protocol.provenance import targets_stamp
    from geoevs.protocol.targets import write_targets
    from geoevs.scenes.store import Scene

    store, asked = Scene(scene), _settings(settings)
    views = views_between(store, asked.views)
    views += moved_rig(store, asked.offsets) if moved else []
    write_targets(out, views, targets_stamp(store, parse_json("--settings", settings), 0))
    write_without_boxes(given, store)


def detection_views(
    method: MethodName,
    scene: SceneFolder,
    targets: TargetFile,
    model: Annotated[Path, typer.Option(help="Where the fit goes.")],
    out: Out,
    fit_log: Annotated[Path, typer.Option(help="Where the method's output goes, of its fit.")],
    render_log: Annotated[Path, typer.Option(help="The same, of its rendering.")],
    variant: str = "default",
    options: MethodOptions = "{}",
    seed: Seed = 0,
    fit_limit: FitLimit = None,
    render_limit: RenderLimit = None,
    attempt: Attempt = 0,
) -> None:
    """Fit a method to a scene without boxes and render its views; failures are written down."""
    from geoevs.detection.entrant_views import render_views
    from geoevs.protocol.entries import MethodEntry

    entry = MethodEntry(method, variant, parse_json("--options", options), seed)
    limits = {"fit": fit_limit, "render": render_limit}
    render_views(entry, scene, targets, model, out, (fit_log, render_log), limits, attempt)


def detection_backbone(
    run: Run,
    scenes: Scenes,
    settings: Section,
    seed: Seed,
    weights: Annotated[Path, typer.Option(help="Folder of this suite's pretrained weights.")],
    work: Work,
    out: Out,
) -> None:
    """Train what turns pictures into features, which detectors of all settings share."""
    from geoevs.detection.detectors import train_backbone

    train_backbone(_scenes(run, scenes), _settings(settings), seed, weights, work, out)


def detection_train(
    run: Run,
    scenes: Scenes,
    setting: Setting,
    settings: Section,
    seed: Seed,
    work: Work,
    out: Out,
) -> None:
    """Train a detector in one setting; a failure is written down."""
    from geoevs.detection.detectors import train_setting

    asked = _settings(settings)
    backbone = run / layout.DETECTION_BACKBONE.format(seed=seed)
    train_setting(_scenes(run, scenes), setting, asked, seed, backbone, work, out)


def detection_find(
    run: Run,
    scenes: Scenes,
    labels: Labels,
    seed: Seed,
    counts: Annotated[Path, typer.Option(help="Where rows of counts go.")],
    out: Out,
) -> None:
    """Run the detectors of all settings on the test scenes, and count what they find."""
    import pandas as pd

    from geoevs.core.parquet import write_parquet
    from geoevs.detection.detectors import find_settings
    from geoevs.detection.found import read_found
    from geoevs.detection.setting_counts import count_setting
    from geoevs.detection.training_settings import settings_with

    settings = settings_with(list(_entries(labels)))
    tested = _scenes(run, scenes)
    pattern = layout.DETECTOR
    detectors = {name: run / pattern.format(setting=name, seed=seed) for name in settings}
    find_settings(tested, detectors, out)
    parts = [count_setting(name, seed, tested, read_found(out / name)) for name in settings]
    write_parquet(counts, pd.concat(parts, ignore_index=True))


def _settings(text: str) -> "DetectionSettings":
    from geoevs.detection.settings import DetectionSettings

    return DetectionSettings.parse(parse_json("--settings", text))


def _scenes(run: Path, scenes: list[str]) -> "list[DetectionScene]":
    from geoevs.detection.rigs import DetectionScene

    return [DetectionScene(run, *pair) for pair in scene_pairs(scenes)]


def task_offsets(
    run: Run,
    scenes: Scenes,
    labels: Labels,
    settings: Section,
    seeds: Annotated[list[int], typer.Option(min=0, help="Of a detector; repeat for more.")],
    out: Out,
) -> None:
    """Run the detectors of the recorded views on a rig that moved aside."""
    import pandas as pd

    from geoevs.core.parquet import write_parquet
    from geoevs.detection.detectors import find
    from geoevs.detection.found import detectors_of
    from geoevs.detection.task_rows import RECORDED, task_rows

    offsets, tested = _settings(settings).offsets, _scenes(run, scenes)
    detectors = detectors_of(run, seeds)
    parts = [
        task_rows(label, tested, offsets, detectors, find)
        for label in (RECORDED, *_entries(labels))
    ]
    write_parquet(out, pd.concat(parts, ignore_index=True))


def detection_tables(
    run: Run,
    settings: TablesSection,
    labels: Labels,
    seeds: Annotated[list[int], typer.Option(min=0, help="Of a detector; repeat for more.")],
    entrants: EntrantsFile,
) -> None:
    """Make table 3, the chart of what accuracy costs, and the table of task metrics."""
    from geoevs.core.parquet import read_parquet
    from geoevs.detection.found import outcomes_of
    from geoevs.detection.task_rows import TASK_TYPES
    from geoevs.detection.training_settings import settings_with
    from geoevs.results.detection_chart import write_detection_chart
    from geoevs.results.detection_page import write_detection_stage, write_task_offsets
    from geoevs.results.detection_stage import detection_stage_table, read_setting_counts
    from geoevs.results.entrants import Entrants
    from geoevs.results.task_offsets import task_table

    entries = _entries(labels)
    asked, who = table_settings(settings), Entrants.read(entrants)
    outcomes = outcomes_of(run, settings_with(list(entries)), seeds)
    counts = read_setting_counts(run / layout.DETECTION_COUNTS)
    table = detection_stage_table(counts, outcomes, asked, entries, who)
    write_detection_stage(run / layout.DETECTION_TABLE, table)
    write_detection_chart(run / layout.DETECTION_CHART, table)
    rows = read_parquet(run / layout.TASK_ROWS, TASK_TYPES)
    write_task_offsets(run / layout.TASK_TABLE, task_table(rows, asked, entries, who))


def _entries(labels: str) -> dict[str, tuple[str, str]]:
    entries: dict[str, Any] = parse_json("--labels", labels)
    return {label: (str(method), str(variant)) for label, (method, variant) in entries.items()}


def detection_figure(
    run: Run,
    scenes: Scenes,
    settings: Section,
    labels: Labels,
    seed: Seed,
    out: Out,
) -> None:
    """Draw what detectors of every setting find in the first frame of a test scene."""
    from geoevs.core.images import write_image
    from geoevs.detection.found import found_by
    from geoevs.detection.training_settings import settings_with
    from geoevs.results.detection_figure import detection_figure as draw

    asked = _settings(settings)
    shown = _scenes(run, scenes)[0]
    found = found_by(run, settings_with(list(_entries(labels))), seed)
    write_image(out, draw(shown, shown.store.frames[0], found, asked.detector.range))
