"""Training any network: resumable to the same bytes, logged, and stopped by the first NaN.

The randomness of a step is a function of the seed and the step alone, so that a run that was killed
needs no more than its last weights to go on as if nothing had happened.
"""

import copy
import hashlib
import io
import json
import math
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import whole_file, write_bytes, write_text
from geoevs.core.images import write_image
from geoevs.core.mapped import Stack, pieces
from geoevs.core.randomness import Rng

STATE = "state.pt"
CHECKPOINTS = 20  # of a whole training
PREVIEWS = 4
GRADIENT_NORM = 1.0


class Task(Protocol):
    """A model with the data that it learns from, as `optimise` trains it.

    `identity` is a `fingerprint` of what decides the losses besides the model's weights: settings
    and data. Trainings that differ in it never go on from each other's state.
    """

    model: nn.Module
    identity: str

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """Losses of one random batch, `loss` among them, which is minimised."""
        ...

    def batch(self, rng: Rng) -> list[str]:
        """The names of the samples that `losses` takes, given the same randomness."""
        ...

    def preview(self, model: nn.Module) -> np.ndarray:
        """(H, W, 3) picture of what the model does so far."""
        ...


@dataclass(frozen=True)
class Optimisation:
    """AdamW with a linear warm-up and a cosine decay to zero; weights are averaged (EMA).

    Args:
        steps: optimiser steps.
        learning_rate: its peak.
        warmup: share of the steps that the learning rate rises for.
        weight_decay: AdamW's.
        average: EMA decay; it starts lower, so that the first weights are soon forgotten.
    """

    steps: int
    learning_rate: float
    warmup: float = 0.05
    weight_decay: float = 0.01
    average: float = 0.995

    def learning_rate_at(self, step: int) -> float:
        """The learning rate of a step, counted from 0."""
        rising = (step + 1) / max(self.warmup * self.steps, 1)
        falling = 0.5 * (1 + math.cos(math.pi * step / self.steps))
        return self.learning_rate * min(rising, falling)

    def average_at(self, step: int) -> float:
        """The EMA decay of a step, counted from 0."""
        return min(self.average, (1 + step) / (10 + step))


def optimise(
    task: Task,
    optimisation: Optimisation,
    seed: int,
    key: str,
    folder: Path,
    report: Callable[[float], None] = lambda loss: None,
    began: float | None = None,
) -> nn.Module:
    """Train a task's model and return its averaged weights as a model of the same kind.

    `folder` holds what a killed run needs to go on (`state.pt`; that of another training is started
    over), `losses.csv` and `previews/`. Code is no part of what tells trainings apart, so whoever
    has kept the result deletes `state.pt` (see `finish`).

    Args:
        task: the model and its losses.
        optimisation: how long and how fast.
        seed: decides every batch.
        key: what is trained, so that two trainings of one seed differ.
        folder: this training's own.
        report: called after every step with its loss, for a progress bar; with NaN for every step
            that a killed run has done.
        began: when the task's preparation began, which `training_seconds` then holds too, on
            `time.monotonic`'s clock; None: now.

    Raises:
        GeoEvsError: a loss or gradient is not finite; the last good weights are in `state.pt`.
    """
    weights = [part for name, tensor in task.model.state_dict().items() for part in (name, tensor)]
    identity = fingerprint(asdict(optimisation), seed, key, task.identity, *weights)
    state = _TrainingState(
        task.model, optimisation, folder, identity, time.monotonic() if began is None else began
    )
    every = max(1, optimisation.steps // CHECKPOINTS)
    preview_every = max(1, optimisation.steps // PREVIEWS)
    task.model.train()
    for _ in range(state.step):
        report(math.nan)
    while state.step < optimisation.steps:
        key_of_step = (seed, key, str(state.step))
        try:
            loss = state.advance(task.losses(Rng(*key_of_step)))
        except FloatingPointError as error:
            state.save()
            batch = ", ".join(task.batch(Rng(*key_of_step)))
            raise GeoEvsError(
                f"{error} at step {state.step}, whose batch is {batch}; lower the learning rate or "
                f"mend those samples (the last good weights are in {state.path})"
            ) from None
        report(loss)
        last = state.step == optimisation.steps
        # The state comes last: a run killed before it repeats the picture.
        if state.step % preview_every == 0 or last:
            picture = np.nan_to_num(task.preview(state.averaged))  # of a training that diverges
            write_image(folder / f"previews/{state.step:06d}.png", picture)
        if state.step % every == 0 or last:
            state.save()
    return state.averaged


def training_seconds(folder: Path) -> float:
    """Wall seconds that a training took until its last saving, those of killed parts among them.

    They are kept in its state, because all that Snakemake knows of is the last part.

    Raises:
        GeoEvsError: the state is missing, as after `finish`, or damaged.
    """
    path = folder / STATE
    with whole_file(path):
        return torch.load(path, map_location="cpu", mmap=True, weights_only=True)["seconds"]


def finish(folder: Path) -> None:
    """Delete a training's state once its result is kept: changed code must not find it."""
    (folder / STATE).unlink(missing_ok=True)


def fingerprint(*parts: Any) -> str:
    """Hash of arrays, on disk or not, tensors and JSON-able values, in their order."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Tensor):
            part = part.detach().cpu().numpy()
        if isinstance(part, np.ndarray | Stack):
            digest.update(f"{part.dtype}{part.shape}".encode())
            for piece in pieces(part):
                digest.update(np.ascontiguousarray(piece).data)
        else:
            digest.update(json.dumps(part).encode())
    return digest.hexdigest()


class _TrainingState:
    """Weights, their average, the optimiser and the losses so far; those on disk, if they fit."""

    def __init__(
        self,
        model: nn.Module,
        optimisation: Optimisation,
        folder: Path,
        identity: str,
        began: float,
    ) -> None:
        self.model, self.optimisation = model, optimisation
        self.averaged = copy.deepcopy(model).requires_grad_(False).eval()
        self._parameters = [p for p in model.parameters() if p.requires_grad]
        self._optimiser = torch.optim.AdamW(
            self._parameters,
            lr=optimisation.learning_rate,
            weight_decay=optimisation.weight_decay,
            fused=True,
        )
        self.step = 0
        self._losses: list[dict[str, float]] = []
        self._began, self._earlier = began, 0.0
        self.path = folder / STATE
        self._folder, self._identity = folder, identity
        if self.path.exists():
            self._resume()
        if self.step == 0:
            shutil.rmtree(folder / "previews", ignore_errors=True)  # another training's

    def advance(self, losses: dict[str, Tensor]) -> float:
        """One optimiser step; its loss.

        Raises:
            FloatingPointError: a loss or the gradient is not finite; nothing has changed.
        """
        for name, value in losses.items():
            _check_finite(f"the loss '{name}'", value)
        self._optimiser.zero_grad(set_to_none=True)
        losses["loss"].backward()
        _check_finite(
            "the gradient's norm", torch.nn.utils.clip_grad_norm_(self._parameters, GRADIENT_NORM)
        )
        for group in self._optimiser.param_groups:
            group["lr"] = self.optimisation.learning_rate_at(self.step)
        self._optimiser.step()
        decay = self.optimisation.average_at(self.step)
        with torch.no_grad():
            for mean, new in zip(self.averaged.parameters(), self.model.parameters(), strict=True):
                mean.lerp_(new, 1 - decay)
            for mean, new in zip(self.averaged.buffers(), self.model.buffers(), strict=True):
                mean.copy_(new)
        self._losses.append({name: value.item() for name, value in losses.items()})
        self.step += 1
        return self._losses[-1]["loss"]

    def save(self) -> None:
        """Write the losses and the state, each whole or not at all."""
        names = list(self._losses[0]) if self._losses else []
        lines = [
            ",".join([str(number), *(f"{row[name]:.6g}" for name in names)])
            for number, row in enumerate(self._losses)
        ]
        header = ",".join(["step", *names])
        write_text(self._folder / "losses.csv", "\n".join([header, *lines]) + "\n")
        contents = {
            "identity": self._identity,
            "step": self.step,
            "model": self.model.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "losses": self._losses,
            "seconds": self._earlier + time.monotonic() - self._began,
        }
        buffer = io.BytesIO()
        torch.save(contents, buffer)
        write_bytes(self.path, buffer.getvalue())

    def _resume(self) -> None:
        device = next(self.model.parameters()).device
        with whole_file(self.path):
            contents = torch.load(self.path, map_location=device, weights_only=True)
            if contents["identity"] != self._identity:  # another training: start over
                return
            self.model.load_state_dict(contents["model"])
            self.averaged.load_state_dict(contents["averaged"])
            self._optimiser.load_state_dict(contents["optimiser"])
            self.step, self._losses = contents["step"], contents["losses"]
            self._earlier = contents["seconds"]


def _check_finite(what: str, value: Tensor) -> None:
    if not bool(torch.isfinite(value)):
        raise FloatingPointError(f"{what} is {value.item()}")
