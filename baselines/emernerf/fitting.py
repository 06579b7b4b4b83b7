"""Fitting EmerNeRF to one scene."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch

from baselines.emernerf.losses import image_losses, lidar_losses
from baselines.emernerf.model import EmerNeRF, Rays
from baselines.emernerf.rays import TrainingRays
from geoevs.core.errors import GeoEvsError

WEIGHT_DECAY, BETAS, TINY = 1e-5, (0.9, 0.99), 1e-15  # as published
WARMUP = 0.1  # share of the fit that the learning rate rises for
MILESTONES, FACTOR = (0.5, 0.75, 0.9), 0.33  # where it falls, by how much


@dataclass(frozen=True)
class Fitting:
    """The length and the speed of a fit.

    Args:
        iterations: optimiser steps.
        rays: through pixels, in each; LiDAR gets a quarter as many more.
        learning_rate: Adam's, at its highest.
    """

    iterations: int
    rays: int
    learning_rate: float

    def learning_rate_at(self, done: float) -> float:
        """The learning rate after a share of the fit."""
        rising = min(0.01 + 0.99 * done / WARMUP, 1.0)
        return self.learning_rate * rising * FACTOR ** sum(done >= mark for mark in MILESTONES)


def fit_model(
    model: EmerNeRF,
    rays: TrainingRays,
    fitting: Fitting,
    until: float,
    generator: torch.Generator,
    report: Callable[[float], None],
) -> int:
    """Fit a model to a scene's rays.

    Args:
        model: on any device; changed.
        rays: on the CPU.
        fitting: how long and how fast.
        until: `time.monotonic()` by which it ends, early if need be: then schedules run faster.
        generator: decides every batch and sample.
        report: called after every step with its loss.

    Returns:
        The steps taken.

    Raises:
        GeoEvsError: a loss is not finite.
    """
    device = next(model.parameters()).device
    optimiser = torch.optim.Adam(
        model.parameters(),
        lr=fitting.learning_rate,
        betas=BETAS,
        eps=TINY,
        weight_decay=WEIGHT_DECAY,
        fused=True,
    )
    start = time.monotonic()
    for step in range(fitting.iterations):
        spent = (time.monotonic() - start) / max(until - start, 1e-9)
        if spent >= 1:
            return step
        done = max(step / fitting.iterations, spent)
        optimiser.param_groups[0]["lr"] = fitting.learning_rate_at(done)
        batch, *seen, cell = rays.pixels(fitting.rays, generator)
        batch, (rgb, sky) = _moved(batch, device), (part.to(device) for part in seen)
        losses, errors = image_losses(model, batch, rgb, sky, done, generator)
        if len(rays.ends):
            batch, ranges = rays.measured(fitting.rays // 4, generator)
            batch = _moved(batch, device)
            losses |= lidar_losses(model, batch, ranges.to(device), done, generator)
        loss = torch.stack(list(losses.values())).sum()
        if not bool(torch.isfinite(loss)):
            guilty = [name for name, value in losses.items() if not bool(torch.isfinite(value))]
            raise GeoEvsError(
                f"the {' and '.join(guilty) or 'total'} loss is not finite at step {step}; lower "
                "the method's learning_rate"
            )
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        rays.learn_errors(cell, errors.cpu())
        report(loss.item())
    return fitting.iterations


def _moved(rays: Rays, device: torch.device) -> Rays:
    return Rays(*(part.to(device) for part in rays))
