"""Training any network: resumable to the same bytes, logged, and stopped by the first NaN.

The randomness of a step is a function of the seed and the step alone, so that a run that was killed
needs no more than its last weights to go on as if nothing had happened.
"""

import copy
import hashlib
import io
import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.adapter import Rng
from geoevs.errors import GeoEvsError
from geoevs.io import whole_file, write_bytes, write_image, write_text

CHECKPOINTS = 20  # of a whole training
GRADIENT_NORM = 1.0


class Task(Protocol):
    """What is trained on what."""

    model: nn.Module

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """Losses of one random batch, `loss` among them, which is minimised."""
        ...

    def preview(self, model: nn.Module) -> np.ndarray | None:
        """(H, W, 3) picture of what the model does so far, or nothing."""
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
        previews: how many pictures are written on the way.
    """

    steps: int
    learning_rate: float
    warmup: float = 0.05
    weight_decay: float = 0.01
    average: float = 0.995
    previews: int = 4

    def learning_rate_at(self, step: int) -> float:
        """The learning rate of a step, counted from 0."""
        rising = (step + 1) / max(self.warmup * self.steps, 1)
        falling = 0.5 * (1 + math.cos(math.pi * step / self.steps))
        return self.learning_rate * min(rising, falling)

    def average_at(self, step: int) -> float:
        """The EMA decay of a step, counted from 0."""
        return min(self.average, (1 + step) / (10 + step))


def train(
    task: Task,
    optimisation: Optimisation,
    seed: int,
    key: str,
    folder: Path,
    report: Callable[[float], None] = lambda loss: None,
) -> nn.Module:
    """Train a task's model and return its averaged weights as a model of the same kind.

    `folder` holds what a killed run needs to go on (`state.pt`, of the same key, seed and
    settings; others are started over), `losses.csv` and `previews/`.

    Args:
        task: the model and its losses.
        optimisation: how long and how fast.
        seed: decides every batch.
        key: what is trained, so that two trainings of one seed differ.
        folder: this training's own.
        report: called after every step with its loss, for a progress bar.

    Raises:
        GeoEvsError: a loss or gradient is not finite; the last good weights stay in `state.pt`.
    """
    identity = _identity(task.model, optimisation, seed, key)
    state = _TrainingState(task.model, optimisation, folder / "state.pt", identity)
    every = max(1, optimisation.steps // CHECKPOINTS)
    shown = max(1, optimisation.steps // max(optimisation.previews, 1))
    task.model.train()
    for _ in range(state.step):
        report(math.nan)
    while state.step < optimisation.steps:
        losses = task.losses(Rng(seed, key, str(state.step)))
        _check_finite(losses, "loss", state.step, folder)
        report(state.advance(losses, folder))
        if state.step % every == 0 or state.step == optimisation.steps:
            state.save(folder / "losses.csv")
        if state.step % shown == 0 or state.step == optimisation.steps:
            picture = task.preview(state.averaged)
            if picture is not None:
                write_image(folder / f"previews/{state.step:06d}.png", picture)
    return state.averaged.eval()


def _identity(model: nn.Module, optimisation: Optimisation, seed: int, key: str) -> str:
    """Hash of the settings and the weights that a training starts from."""
    digest = hashlib.sha256(json.dumps([asdict(optimisation), seed, key]).encode())
    for name, tensor in model.state_dict().items():
        digest.update(f"{name}{tuple(tensor.shape)}".encode())
        digest.update(tensor.detach().cpu().contiguous().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


class _TrainingState:
    """Weights, their average, the optimiser and the losses so far."""

    def __init__(
        self, model: nn.Module, optimisation: Optimisation, path: Path, identity: str
    ) -> None:
        self.model, self.optimisation = model, optimisation
        self.averaged = copy.deepcopy(model).requires_grad_(False)
        self._parameters = [p for p in model.parameters() if p.requires_grad]
        self._optimiser = torch.optim.AdamW(
            self._parameters,
            lr=optimisation.learning_rate,
            weight_decay=optimisation.weight_decay,
            fused=True,
        )
        self.step = 0
        self._losses: list[dict[str, float]] = []
        self._path, self._identity = path, identity
        if path.exists():
            self._resume()

    def advance(self, losses: dict[str, Tensor], folder: Path) -> float:
        """One optimiser step."""
        self._optimiser.zero_grad(set_to_none=True)
        losses["loss"].backward()
        norm = torch.nn.utils.clip_grad_norm_(self._parameters, GRADIENT_NORM)
        _check_finite({"gradient": norm}, "gradient", self.step, folder)
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

    def save(self, losses: Path) -> None:
        """Write the state and the losses, each whole or not at all."""
        buffer = io.BytesIO()
        contents = {
            "identity": self._identity,
            "step": self.step,
            "model": self.model.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "losses": self._losses,
        }
        torch.save(contents, buffer)
        write_bytes(self._path, buffer.getvalue())
        names = list(self._losses[0])
        lines = [
            ",".join([str(number), *(f"{row[name]:.6g}" for name in names)])
            for number, row in enumerate(self._losses)
        ]
        write_text(losses, "\n".join([",".join(["step", *names]), *lines]) + "\n")

    def _resume(self) -> None:
        device = next(self.model.parameters()).device
        with whole_file(self._path):
            contents = torch.load(self._path, map_location=device, weights_only=True)
            if contents["identity"] != self._identity:  # another training: start over
                return
            self.model.load_state_dict(contents["model"])
            self.averaged.load_state_dict(contents["averaged"])
            self._optimiser.load_state_dict(contents["optimiser"])
            self.step, self._losses = contents["step"], contents["losses"]


def _check_finite(values: dict[str, Tensor], what: str, step: int, folder: Path) -> None:
    for name, value in values.items():
        if not bool(torch.isfinite(value)):
            raise GeoEvsError(
                f"the {what} '{name}' is {float(value)} at step {step}, whose batch is a function "
                f"of seed and step; lower the learning rate (the last good weights are in "
                f"{folder / 'state.pt'})"
            )


@contextmanager
def seeded(seed: int, *key: str) -> Iterator[None]:
    """Let torch's global generator, which fills new networks, be a function of seed and key."""
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(int(Rng(seed, *key, "weights").numpy.integers(2**62)))
        yield


@contextmanager
def mixed_precision(device: torch.device) -> Iterator[None]:
    """Autocast to bfloat16 where the device computes it faster than float32."""
    fast = device.type == "cuda" or torch.cpu._is_avx512_bf16_supported()
    with torch.autocast(device.type, torch.bfloat16, enabled=fast):
        yield
