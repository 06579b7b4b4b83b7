"""Training the generator as commands: its pretraining, and Geo-EVS itself."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import Out, Rate, Scenes, Seed, Steps, Work, parse_json
from geoevs.core.errors import GeoEvsError
from geoevs.core.progress import training_bar

Batch = Annotated[int, typer.Option(min=1, help="Images a step.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (train, train_autoencoder, train_prior):
        app.command()(command)


def train(
    pairs: Annotated[list[Path], typer.Option(help="What `geoevs pairs` wrote; repeat for more.")],
    library: Annotated[Path, typer.Option(help="What `geoevs mask-library` wrote.")],
    settings: Annotated[str, typer.Option(help="The config's training section of one variant.")],
    weights: Annotated[Path, typer.Option(help="The folder of this suite's pretrained weights.")],
    geometry: Annotated[str, typer.Option(help="The depth model that made the pairs.")],
    work: Work,
    out: Out,
    geometry_weights: Annotated[Path | None, typer.Option(help="Its weights, if any.")] = None,
    seed: Seed = 0,
) -> None:
    """Train Geo-EVS on condition-target pairs, with artifact masks.

    A failure is written down, not raised: methods that take these weights fail with its reason, and
    the others go on.
    """
    from geoevs.conditions.artifact_masks import read_artifact_masks
    from geoevs.conditions.pairs import read_pairs
    from geoevs.core.files import link_file, new_folder, write_json
    from geoevs.core.optimising import finish, training_seconds
    from geoevs.core.settings import check_options
    from geoevs.generator.geo_evs.task import TrainingSettings, train_geo_evs
    from geoevs.methods.trained import seconds_file, trained_seconds

    parsed = parse_json("--settings", settings)
    check_options("--settings", TrainingSettings, parsed)
    wanted = TrainingSettings(**parsed)
    if geometry_weights is not None and not geometry_weights.is_file():
        raise GeoEvsError(f"{geometry_weights} is missing; make or copy it there")
    data = read_pairs(pairs)
    with failure_written(out):
        with training_bar(f"training on {len(data)} pairs", wanted.steps) as report:
            generator = train_geo_evs(
                wanted, data, read_artifact_masks(library), weights, seed, work, report
            )
        with new_folder(out) as partial:
            generator.save(partial)
            seconds = {"training": training_seconds(work)}
            if geometry_weights is not None:
                link_file(geometry_weights, partial / "geometry.safetensors")
                seconds["geometry"] = trained_seconds(geometry_weights) or 0.0
            write_json(seconds_file(partial), seconds)
            made_with = {"timesteps": wanted.timesteps, "sampling": wanted.sampling}
            write_json(partial / "settings.json", {"geometry": geometry, **made_with})
        finish(work)


@contextmanager
def failure_written(out: Path) -> Iterator[None]:
    """Where the block's training fails, leave the reason in place of its networks."""
    from geoevs.core.files import new_folder, write_json
    from geoevs.methods.trained import FAILURE_FILE

    try:
        yield
    except GeoEvsError as error:
        print(f"error: {error}", file=sys.stderr)
        with new_folder(out) as partial:
            write_json(partial / FAILURE_FILE, {"reason": str(error)})


def train_autoencoder(
    scenes: Scenes,
    out: Out,
    work: Work,
    steps: Steps,
    batch: Batch,
    learning_rate: Rate,
    crop: Annotated[int, typer.Option(min=16, help="Side of the crops, pixels.")] = 64,
    seed: Seed = 0,
) -> None:
    """Pretrain this suite's autoencoder on the images of scenes; weights are stored as float16."""
    import torch

    from geoevs.core.networks import best_device, seeded
    from geoevs.core.optimising import Optimisation, finish, optimise
    from geoevs.diffusion.autoencoder import NANO_BLOCK, Autoencoder, nano_autoencoder, to_tensor
    from geoevs.diffusion.pretraining import AutoencoderTask, read_images
    from geoevs.diffusion.prior import save_autoencoder

    images = read_images(scenes)
    with seeded(seed, "autoencoder"):
        autoencoder = Autoencoder(nano_autoencoder(), NANO_BLOCK)
    every = max(1, len(images) // 128)
    some = to_tensor(images.rgb[::every])
    autoencoder.fit_linear(some)
    device = best_device()
    autoencoder.to(device)
    task = AutoencoderTask(autoencoder, images, batch, (crop, crop))
    with training_bar(f"autoencoder on {len(images)} images", steps) as report:
        optimisation = Optimisation(steps, learning_rate, weight_decay=0.0)
        trained = optimise(task, optimisation, seed, "autoencoder", work, report)
    trained.fit_statistics(some.to(device))
    save_autoencoder(out, trained, torch.float16)
    finish(work)


def train_prior(
    scenes: Scenes,
    autoencoder: Annotated[Path, typer.Option(help="What `geoevs train-autoencoder` wrote.")],
    out: Out,
    work: Work,
    steps: Steps,
    batch: Batch,
    learning_rate: Rate,
    seed: Seed = 0,
) -> None:
    """Pretrain the unconditional denoiser on the images of scenes; stored as float16."""
    import torch

    from geoevs.core.networks import best_device, seeded
    from geoevs.core.optimising import Optimisation, finish, optimise
    from geoevs.diffusion.denoiser import Denoiser, nano_unet
    from geoevs.diffusion.pretraining import PriorTask, read_images
    from geoevs.diffusion.prior import load_autoencoder, save_denoiser
    from geoevs.diffusion.process import Diffusion

    device = best_device()
    images, frozen = read_images(scenes), load_autoencoder(autoencoder).to(device)
    with seeded(seed, "prior"):
        denoiser = Denoiser(nano_unet(frozen.latent_channels), None).to(device)
    task = PriorTask(denoiser, frozen, Diffusion(), images, batch)
    with training_bar(f"prior on {len(images)} images", steps) as report:
        trained = optimise(task, Optimisation(steps, learning_rate), seed, "prior", work, report)
    save_denoiser(out, trained, Diffusion(), torch.float16)
    finish(work)
