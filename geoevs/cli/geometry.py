"""The depth network as commands: training it, and saying how good it is (paper section 3.2)."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import Out, Rate, SceneFolder, Scenes, Seed, Steps, Work
from geoevs.core.progress import progress_bar


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (point_maps, train_geometry, train_refiner, score_geometry):
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


def train_geometry(
    out: Out,
    work: Work,
    steps: Steps,
    batch: Annotated[int, typer.Option(min=1, help="Frames a step.")],
    learning_rate: Rate,
    scenes: Annotated[
        list[Path] | None, typer.Option(help="A scene store; repeat for more.")
    ] = None,
    depths: Annotated[
        list[Path] | None,
        typer.Option(help="Its dense true depth, once a scene; left out, LiDAR supervises."),
    ] = None,
    start: Annotated[
        Path | None, typer.Option(help="VGGT weights to fine-tune; left out, a new nano one.")
    ] = None,
    half: Annotated[bool, typer.Option("--half", help="Store weights as float16.")] = False,
    seed: Seed = 0,
) -> None:
    """Fine-tune VGGT on driving scenes, or train a nano one from scratch.

    How many seconds that took is written beside the weights, as `<name>.seconds.json`.
    """
    import torch

    from geoevs.core.optimising import Optimisation
    from geoevs.geometry.finetuning import train_depth_network

    optimisation = Optimisation(steps, learning_rate)
    dtype = torch.float16 if half else torch.float32
    truths = depths or []
    train_depth_network(scenes or [], truths, start, batch, optimisation, seed, work, out, dtype)


def train_refiner(
    model: Annotated[Path, typer.Option(help="VGGT weights whose depth is to be refined.")],
    scenes: Scenes,
    depths: Annotated[list[Path], typer.Option(help="Its dense true depth, once a scene.")],
    out: Out,
    work: Work,
    steps: Steps,
    batch: Annotated[int, typer.Option(min=1, help="Views a step.")],
    learning_rate: Rate,
    seed: Seed = 0,
) -> None:
    """Train what refines a VGGT's depth by LiDAR; writes both together, as float16."""
    from geoevs.core.optimising import Optimisation
    from geoevs.geometry.refiner_training import train_depth_refiner

    optimisation = Optimisation(steps, learning_rate)
    train_depth_refiner(model, scenes, depths, batch, optimisation, seed, work, out)


def score_geometry(
    dataset: Annotated[str, typer.Option(help="The data set's name in the config.")],
    scene_name: Annotated[str, typer.Option(help="The scene's name in the config.")],
    scene: SceneFolder,
    depths: Annotated[Path, typer.Option(help="Its dense true depth; may be empty.")],
    model: Annotated[str, typer.Option(help="The depth model's name; lidar is always scored.")],
    out: Out,
    pretrained: Annotated[Path | None, typer.Option(help="The model's weights before.")] = None,
    finetuned: Annotated[
        Path | None, typer.Option(help="The model's weights after fine-tuning.")
    ] = None,
) -> None:
    """Score the depth of a scene's recorded views: one row a view, stage, scale and metric."""
    from geoevs.core.parquet import write_parquet
    from geoevs.geometry.depth_models import make_depth_model
    from geoevs.protocol.depth_scoring import (
        CONTROL,
        FINE_TUNED,
        PRETRAINED,
        Candidate,
        depth_scores,
    )
    from geoevs.scenes.store import Scene

    store = Scene(scene)
    candidates = []
    if model != "lidar":
        candidates.append(Candidate(model, PRETRAINED, make_depth_model(model, pretrained)))
    if finetuned is not None:
        candidates.append(Candidate(model, FINE_TUNED, make_depth_model(model, finetuned)))
    candidates.append(Candidate("lidar", CONTROL, make_depth_model("lidar", None)))
    total = len(store.frames) * sum(len(candidate.scales) for candidate in candidates)
    common = {"dataset": dataset, "scene": scene_name}
    with progress_bar(f"depth of {scene_name}", total) as advance:
        rows = depth_scores(store, depths, candidates, common, advance)
    write_parquet(out, rows)
