"""Training iterations a second, everything included, of 20 000 Gaussians, and on the torch twin.

python -m benchmarks.gaussian_training
"""

import time
from unittest.mock import patch

import numba
import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from baselines.gaussians import nodes
from baselines.gaussians.interface import Rasterization
from baselines.gaussians.model import Gaussians
from baselines.gaussians.nodes import Background, SceneGraph
from baselines.gaussians.options import STRATEGIES
from baselines.gaussians.reference import rasterize_reference
from baselines.gaussians.training import Photo, Trainer, make_strategy
from benchmarks.projection import processor
from benchmarks.rasterizer import GAUSSIANS, camera, scattered_gaussians

BARS = {128: 45.0, 256: 29.0}
"""Iterations a second on two cores, by the picture's side in pixels."""

TRAINING, FIRST = 2500, 101
"""Steps of a training, and the first one timed, from which the strategies act: as the cap is the
number of Gaussians, they relocate or prune some, but add none."""

STEPS, TWIN_STEPS = 61, 2


def seconds_each(side: int, densification: str, count: int) -> list[float]:
    """What each step takes: drawing, loss, gradients, Adam and the strategy."""
    means, quats, scales, opacities, sh = (tensor.detach() for tensor in scattered_gaussians())
    gaussians = Gaussians(means, quats, scales.log(), opacities.logit(), sh[:, :1], sh[:, 1:])
    generator = torch.Generator().manual_seed(0)
    trainer = Trainer(
        SceneGraph(Background(gaussians)),
        steps=TRAINING,
        extents={"background": 5.0},
        strategy=make_strategy(densification, GAUSSIANS, TRAINING),
        own_loss=lambda *_: 0.0,
        generator=generator,
    )
    image = torch.rand(side, side, 3, generator=generator)
    photo = Photo(camera().resized(side, side), 0, image)
    seconds = []
    for step in range(FIRST, FIRST + count):
        start = time.perf_counter()
        trainer.advance(step, photo)
        seconds.append(time.perf_counter() - start)
    return seconds[1:]  # the first may compile


def draw_by_twin(*arguments) -> Rasterization:
    """What `rasterize_gaussians` gives, drawn and differentiated by torch ops in float64."""
    rgb, depth, opacity, footprints = rasterize_reference(*arguments)
    return Rasterization(rgb.float(), depth.float(), opacity.float(), footprints)


def main() -> None:
    """Print iterations a second by size and strategy, beside the bars and the twin's."""
    table = Table("pixels", "densification", "it/s, median", "best", "bar", "torch twin, it/s")
    for side, bar in BARS.items():
        for densification in STRATEGIES:
            seconds = seconds_each(side, densification, STEPS)
            with patch.object(nodes, "rasterize_gaussians", draw_by_twin):
                twin = seconds_each(side, densification, TWIN_STEPS)
            rates = 1 / np.median(seconds), 1 / min(seconds)
            table.add_row(
                f"{side} x {side}",
                densification,
                *(f"{rate:.1f}" for rate in rates),
                f"{bar:.0f}",
                f"{1 / np.median(twin):.2f}",
            )
    console = Console()
    console.print(f"{processor()}; numba threads: {numba.get_num_threads()}")
    console.print(table)


if __name__ == "__main__":
    main()
