"""Options that many commands have; arguments that are JSON or name scenes; tables of rows."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from geoevs.core.errors import GeoEvsError

if TYPE_CHECKING:
    import pandas as pd

    from geoevs.results.settings import TableSettings

Run = Annotated[Path, typer.Option(help="The run's folder, results/<run>.")]
RunOrFolder = Annotated[str, typer.Argument(help="The run's name, or its folder.")]
Dataset = Annotated[str, typer.Option(help="The data set's name in the config.")]
SceneInRun = Annotated[str, typer.Option(help="The scene's name in the config.")]
MethodName = Annotated[str, typer.Option(help="The method's name.")]
MethodOptions = Annotated[str, typer.Option(help="The method's own, as a JSON object.")]
TargetFile = Annotated[Path, typer.Option(help="The scene's target list.")]
SceneFolder = Annotated[Path, typer.Option(help="A scene store.")]
Out = Annotated[Path, typer.Option(help="What to write, whole or not at all.")]
Scores = Annotated[Path, typer.Option(help="The run's scores.parquet.")]
Costs = Annotated[Path, typer.Option(help="The run's costs.parquet.")]
SetScores = Annotated[Path | None, typer.Option(help="The run's set-scores.parquet.")]
TablesSection = Annotated[str, typer.Option(help="The config's tables section, as JSON.")]
EntrantsFile = Annotated[Path, typer.Option(help="What `geoevs entrants` wrote: who plays.")]
FitLimit, RenderLimit, TrainingLimit = (
    Annotated[
        float | None,
        typer.Option(
            min=0,
            envvar=f"GEOEVS_{step}_LIMIT",
            help=f"Seconds after which a {step.lower()} is ended; none: never.",
        ),
    ]
    for step in ("FIT", "RENDER", "TRAINING")
)
"""The workflow sets the variables: another limit makes no job run again."""

Attempt = Annotated[
    int, typer.Option(min=0, help="Which attempt this is; faults of the machine have a second.")
]
Work = Annotated[
    Path, typer.Option(help="The training's state, losses and previews; a killed one goes on.")
]
Seed = Annotated[int, typer.Option(min=0, help="Decides initial weights and every batch.")]
Scenes = Annotated[list[Path], typer.Option(help="A scene store; repeat for more.")]
Steps = Annotated[int, typer.Option(min=1, help="Optimiser steps.")]
Rate = Annotated[float, typer.Option(help="Peak learning rate of AdamW.")]

EXAMPLES = {dict: "object, such as '{\"steps\": 100}'", list: "list, such as '[1.0, 0.5]'"}


def run_folder(run: str) -> Path:
    """The folder of a run that is named, or given as a path with a slash."""
    return Path(run) if "/" in run else Path("results") / run


def parse_json(option: str, text: str, kind: type = dict) -> Any:
    """The JSON object (or list) that an option was given.

    Raises:
        GeoEvsError: the text is not JSON, or of another kind; the sentence names the option.
    """
    try:
        value = json.loads(text)
    except ValueError as error:
        raise GeoEvsError(
            f"{option} is not JSON ({error}); write a JSON {EXAMPLES[kind]}"
        ) from error
    if not isinstance(value, kind):
        raise GeoEvsError(f"{option} is {text}; write a JSON {EXAMPLES[kind]}")
    return value


def table_settings(section: str) -> "TableSettings":
    """The config's tables section.

    Raises:
        GeoEvsError: it is not JSON, or has another key, or a value of another type.
    """
    from geoevs.results.settings import TableSettings

    return TableSettings.parse(parse_json("--settings", section))


def scene_pairs(scenes: Sequence[str]) -> list[tuple[str, str]]:
    """The (dataset, scene) pairs that `--scenes DATASET/SCENE` names.

    Raises:
        GeoEvsError: one is not of that form.
    """
    pairs = []
    for scene in scenes:
        dataset, slash, name = scene.partition("/")
        if not slash:
            raise GeoEvsError(f"--scenes {scene} is not of the form DATASET/SCENE; name both")
        pairs.append((dataset, name))
    return pairs


def read_rows(path: Path, name: str) -> "pd.DataFrame":
    """The rows of a file, checked; `name` says which of the run's files it is, by the layout."""
    from geoevs.results.rows import read_rows

    return read_rows(path, name)
