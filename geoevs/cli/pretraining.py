"""Making this suite's own starting weights, as commands."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import Out, Rate, Scenes, Seed, Steps, Work

Batch = Annotated[int, typer.Option(min=1, help="Images a step.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (train_autoencoder, train_prior):
        app.command()(command)


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
    from geoevs.diffusion.pretraining import pretrain_autoencoder

    size = (crop, crop)
    pretrain_autoencoder(scenes, batch, steps, learning_rate, seed, work, out, size)


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
    from geoevs.diffusion.pretraining import pretrain_prior

    pretrain_prior(scenes, autoencoder, batch, steps, learning_rate, seed, work, out)
