"""What the generator trains on, as commands: point maps, pairs and the artifact-mask library."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import Out, Run, SceneFolder, parse_json, scene_pairs
from geoevs.core.progress import progress_bar

PointMapFile = Annotated[Path, typer.Option(help="What `geoevs point-maps` wrote of the scene.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (point_maps, pairs, masks, mask_library, mask_figure):
        app.command()(command)


def point_maps(
    scene: SceneFolder,
    model: Annotated[str, typer.Option(help="The depth model's name, such as lidar.")],
    out: Out,
    weights: Annotated[
        Path | None, typer.Option(help="The model's weights, if it has any.")
    ] = None,
) -> None:
    """Estimate the depth of every recorded view of a scene."""
    from geoevs.geometry.depth_models import make_depth_model
    from geoevs.geometry.point_maps import write_point_maps
    from geoevs.scenes.store import Scene

    store, made = Scene(scene), make_depth_model(model, weights)
    with progress_bar(f"point maps {store.info.name}", len(store.frames)) as advance:
        write_point_maps(out, store, made, advance)


def pairs(scene: SceneFolder, point_maps: PointMapFile, out: Out) -> None:
    """Make the condition map and the supervision image of every recorded view of a scene."""
    from geoevs.conditions.pairs import make_pairs, write_pairs
    from geoevs.geometry.point_maps import PointMaps
    from geoevs.scenes.store import Scene

    store = Scene(scene)
    with progress_bar(f"pairs {store.info.name}", len(store.frames)) as advance:
        write_pairs(out, make_pairs(store, PointMaps(point_maps), advance))


def masks(
    scene: SceneFolder,
    point_maps: PointMapFile,
    poses: Annotated[str, typer.Option(help="The config's conditions.masks section, as JSON.")],
    out: Out,
) -> None:
    """Take the validity masks of a training scene at virtual poses."""
    from geoevs.conditions.artifact_masks import make_artifact_masks, write_artifact_masks
    from geoevs.geometry.point_maps import PointMaps
    from geoevs.scenes.store import Scene

    store, wanted = Scene(scene), parse_json("--poses", poses)
    with progress_bar(f"masks {store.info.name}", len(store.frames)) as advance:
        write_artifact_masks(
            out, make_artifact_masks(store, PointMaps(point_maps), wanted, advance)
        )


def mask_library(
    out: Out,
    parts: Annotated[list[Path] | None, typer.Argument(help="What `geoevs masks` wrote.")] = None,
) -> None:
    """Put the masks of many training scenes into one artifact-mask library."""
    from geoevs.conditions.artifact_masks import (
        join_artifact_masks,
        read_artifact_masks,
        write_artifact_masks,
    )

    write_artifact_masks(
        out, join_artifact_masks([read_artifact_masks(part) for part in parts or []])
    )


def mask_figure(
    library: Annotated[Path, typer.Option(help="What `geoevs mask-library` wrote.")],
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
