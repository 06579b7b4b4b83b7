"""The depth network as commands: training it, and saying how good it is (paper section 3.2)."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import Out, Rate, SceneFolder, Scenes, Seed, Steps, Work
from geoevs.core.errors import GeoEvsError
from geoevs.core.progress import progress_bar, training_bar


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (train_geometry, train_refiner, score_geometry):
        app.command()(command)


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

    from geoevs.core.files import write_json
    from geoevs.core.networks import best_device
    from geoevs.core.optimising import Optimisation, finish, training_seconds
    from geoevs.core.randomness import Rng
    from geoevs.geometry.finetuning import read_depth_frames, train_vggt
    from geoevs.geometry.vggt import VGGT_NANO, load_vggt, new_vggt, save_vggt
    from geoevs.methods.trained import seconds_file

    model = load_vggt(start) if start else new_vggt(VGGT_NANO, Rng(seed, "vggt").torch)
    frames = read_depth_frames(scenes or [], depths or [], model.config)
    count = sum(parameter.numel() for parameter in model.parameters())
    views = frames.images.shape[1]
    described = f"{len(frames)} frames of {views} views, {count / 1e6:.1f} M parameters"
    print(f"VGGT: {described}, {steps} steps", file=sys.stderr)
    model.to(best_device())
    with training_bar("VGGT", steps) as report:
        optimisation = Optimisation(steps, learning_rate)
        trained = train_vggt(model, frames, batch, optimisation, seed, work, report)
    write_json(seconds_file(out), {"training": training_seconds(work)})
    save_vggt(trained, out, torch.float16 if half else torch.float32)
    finish(work)


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
    import torch

    from geoevs.core.networks import best_device, seeded
    from geoevs.core.optimising import Optimisation, finish, optimise
    from geoevs.geometry.depth_models import VggtDepth
    from geoevs.geometry.refinement import NANO_CHANNELS, DepthRefiner
    from geoevs.geometry.refiner_training import RefinementTask, read_refiner_views
    from geoevs.geometry.vggt import save_vggt

    if len(scenes) != len(depths):
        raise GeoEvsError(
            f"there are {len(scenes)} scenes and {len(depths)} folders of true depth; give one for "
            "each scene"
        )
    network = VggtDepth(model)
    network.model.refiner = None
    with progress_bar("depth of scenes", len(scenes)) as advance:
        views = read_refiner_views(scenes, depths, network, advance)
    with seeded(seed, "depth-refiner"):
        refiner = DepthRefiner(NANO_CHANNELS)
    refiner.to(best_device())
    with training_bar(f"depth refiner on {len(views)} views", steps) as report:
        task = RefinementTask(refiner, views, batch)
        optimisation = Optimisation(steps, learning_rate)
        trained = optimise(task, optimisation, seed, "depth-refiner", work, report)
    network.model.set_refiner(trained, NANO_CHANNELS)
    save_vggt(network.model, out, torch.float16)
    finish(work)


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
    from geoevs.core.files import write_bytes
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
    write_bytes(out, rows.to_parquet(index=False))
