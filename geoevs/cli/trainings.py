"""What methods learn beforehand, as commands: the same three for every method that trains."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import (
    Attempt,
    Out,
    Run,
    SceneFolder,
    Seed,
    TrainingLimit,
    Work,
    parse_json,
    scene_pairs,
)

Method = Annotated[str, typer.Argument(help="The name of a method that trains.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (prepare, combine, train, mask_figure):
        app.command()(command)


def prepare(
    method: Method,
    scene: SceneFolder,
    out: Out,
    point_maps: Annotated[
        Path | None, typer.Option(help="What `geoevs point-maps` wrote of the scene.")
    ] = None,
    mask_poses: Annotated[
        str, typer.Option(help="The config's conditions.masks section, as JSON.")
    ] = "{}",
    limit: TrainingLimit = None,
    attempt: Attempt = 0,
) -> None:
    """Make what a method's training learns from one scene."""
    from geoevs.methods.training import Inputs
    from geoevs.methods.training_steps import prepare_scene

    poses = parse_json("--mask-poses", mask_poses)
    inputs = Inputs(point_maps=point_maps, mask_poses=poses)
    prepare_scene(method, scene, inputs, out, limit, attempt)


def combine(
    method: Method,
    out: Out,
    files: Annotated[list[Path] | None, typer.Argument(help="What `geoevs prepare` wrote.")] = None,
    limit: TrainingLimit = None,
    attempt: Attempt = 0,
) -> None:
    """Make one file of what was prepared of all scenes, such as the artifact-mask library."""
    from geoevs.methods.training_steps import combine_files

    combine_files(method, files or [], out, limit, attempt)


def train(
    method: Method,
    work: Work,
    out: Out,
    files: Annotated[
        list[Path] | None, typer.Option(help="What `geoevs prepare` wrote; repeat for more.")
    ] = None,
    settings: Annotated[
        str, typer.Option(help="The training's settings that are not its defaults, as JSON.")
    ] = "{}",
    combined: Annotated[Path | None, typer.Option(help="What `geoevs combine` wrote.")] = None,
    geometry: Annotated[str, typer.Option(help="The depth model that made the point maps.")] = "",
    geometry_weights: Annotated[Path | None, typer.Option(help="Its weights, if any.")] = None,
    weights: Annotated[
        Path | None, typer.Option(help="The folder of this suite's pretrained weights.")
    ] = None,
    seed: Seed = 0,
    limit: TrainingLimit = None,
    attempt: Attempt = 0,
) -> None:
    """Train a method's networks.

    A failure is written down, not raised: methods that take these weights fail with its reason, and
    the others go on.
    """
    from geoevs.methods.training import Inputs
    from geoevs.methods.training_steps import train_method

    inputs = Inputs(
        combined=combined, geometry=geometry, geometry_weights=geometry_weights, weights=weights
    )
    values = parse_json("--settings", settings)
    train_method(method, values, files or [], inputs, seed, work, out, limit, attempt)


def mask_figure(
    library: Annotated[Path, typer.Option(help="An artifact-mask library of `geoevs combine`.")],
    run: Run,
    scenes: Annotated[list[str], typer.Option(help="DATASET/SCENE under test; repeat for more.")],
    out: Out,
) -> None:
    """Draw masks of the library, and its support beside that of the extrapolation targets."""
    from geoevs.conditions.artifact_masks import read_artifact_masks
    from geoevs.core.files import write_bytes
    from geoevs.results.mask_figure import library_picture, target_support

    support = target_support(run, scene_pairs(scenes))
    write_bytes(out, library_picture(read_artifact_masks(library), support))
