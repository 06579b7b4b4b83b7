"""Training the nodes of a scene on its photographs."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from baselines.gaussians.densification import (
    GradientStrategy,
    MCMCStrategy,
    Schedule,
    Strategy,
)
from baselines.gaussians.loss import photometric_loss
from baselines.gaussians.nodes import Drawn, SceneGraph
from baselines.gaussians.optimiser import EPSILON, MEANS_DECAY, Optimiser
from baselines.gaussians.options import STRATEGIES
from baselines.gaussians.size import SizeChoice
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.methods.contract import Views
from geoevs.scenes.camera import Camera

EXTRA_RATES = {"shifts": 5e-3, "turns": 1e-3, "colours": 1e-2}
"""Published learning rates of track corrections (metres, radians) and of the sky's map."""

GROWTH_START, GROWTH_STOP = 0.04, 0.55
"""Shares of the training between which Gaussians are added."""

GROWTH_ROUNDS = 125
"""Rounds of growth that a whole training would have time for. A round grows by a twentieth, so that
70 rounds make 30 Gaussians of one."""

SHORTEST_ROUND = 10
"""Fewest steps of a round: what was just split is faint, and a short training would split it again
and again."""

RESETS = 10


@dataclass(frozen=True)
class Photo:
    """The image of a camera in a frame, and whatever else is known of that view.

    Args:
        image: (H, W, 3) in [0, 1].
        known: pictures for a method's own losses, by name.
    """

    camera: Camera
    frame: int
    image: Tensor  # [H, W, 3]
    known: dict[str, Tensor] = field(default_factory=dict)


def photos_of(views: Views, device: str) -> list[Photo]:
    """All source views, frame by frame."""
    return [
        Photo(
            views.camera(name, frame),
            frame,
            torch.from_numpy(views.image(name, frame)).to(device),
        )
        for frame in views.frames
        for name in views.cameras
    ]


def make_strategy(name: str, cap: int, steps: int) -> Strategy:
    """A strategy that acts in fixed shares of a training of `steps`.

    Raises:
        GeoEvsError: there is no such strategy.
    """
    if name not in STRATEGIES:
        raise GeoEvsError(f"there is no densification '{name}'; {did_you_mean(name, STRATEGIES)}")
    start, stop = round(GROWTH_START * steps), round(GROWTH_STOP * steps)
    schedule = Schedule(start, stop, max(SHORTEST_ROUND, steps // GROWTH_ROUNDS))
    if name == "mcmc":
        return MCMCStrategy(cap, schedule)
    return GradientStrategy(cap, schedule, reset_every=max(1, steps // RESETS))


OwnLoss = Callable[[SceneGraph, Photo, Drawn, float], Tensor | float]
"""A method's addition to the photometric loss; the number is the share of the training so far."""


class Trainer:
    """The optimisers of a scene's nodes, and how their numbers change.

    Args:
        graph: trained in place.
        steps: how long the training is.
        extents: of each node, metres (see `scene_extent`).
        strategy: how the background's number changes; actors keep theirs.
        own_loss: what is added to the photometric loss.
        generator: of all randomness.
    """

    def __init__(
        self,
        graph: SceneGraph,
        steps: int,
        extents: dict[str, float],
        strategy: Strategy,
        own_loss: OwnLoss,
        generator: torch.Generator,
    ) -> None:
        self.graph, self.steps = graph, steps
        self.optimisers = {
            node.name: Optimiser(node.gaussians, steps, extents[node.name])
            for node in graph.nodes()
        }
        self._strategy, self._own_loss, self._generator = strategy, own_loss, generator
        self._extras = {
            f"{name} of {node}": (tensor.requires_grad_(), EXTRA_RATES[name])
            for node, extras in graph.extras().items()
            for name, tensor in extras.items()
        }
        groups = [{"params": [tensor], "lr": rate} for tensor, rate in self._extras.values()]
        self._adam = torch.optim.Adam(groups, eps=EPSILON, fused=True) if groups else None

    def advance(self, step: int, photo: Photo) -> float:
        """One step on one photograph, counted from 0; its loss.

        Raises:
            GeoEvsError: a gradient is not finite, when everything is as before this step; or no
                Gaussian is left.
        """
        drawn = self.graph.draw(photo.camera, photo.frame)
        loss = photometric_loss(drawn.picture.rgb, photo.image)
        loss = loss + self._own_loss(self.graph, photo, drawn, step / self.steps)
        actors = [actor for actor in self.graph.actors if actor.name in drawn.rows]
        nodes = [self.graph.background, *actors]
        loss = loss + self._strategy.penalty(self.graph.background.gaussians)
        loss.backward()
        for node in nodes:
            self.optimisers[node.name].check(step, f" of {node.name}")
        self._check_extras(step)
        for node in nodes:
            self.optimisers[node.name].step(step)
        self._step_extras(step)
        footprints = drawn.footprints("background")
        optimiser = self.optimisers["background"]
        self._strategy.update(step, optimiser, footprints, photo.camera, self._generator)
        for actor in actors:
            actor.confine()
        return loss.item()

    def _check_extras(self, step: int) -> None:
        for name, (tensor, _) in self._extras.items():
            if tensor.grad is not None and not tensor.grad.sum().isfinite():
                raise GeoEvsError(
                    f"the gradient of {name} is not finite at step {step}; the values "
                    "stay as they were before it, so look for broken views or boxes"
                )

    def _step_extras(self, step: int) -> None:
        if self._adam is None:
            return
        decay = MEANS_DECAY ** (step / self.steps)
        for group, (_, rate) in zip(self._adam.param_groups, self._extras.values(), strict=True):
            group["lr"] = rate * decay
        self._adam.step()
        self._adam.zero_grad()


def train(
    trainer: Trainer,
    photos: Sequence[Photo],
    choice: SizeChoice | None,
    until: float,
    generator: torch.Generator,
    report: Callable[[float, str], None],
) -> int:
    """Train on photographs in random order, each once before any is seen again.

    Args:
        trainer: of the scene.
        photos: to train on.
        choice: holds out some of them until it has chosen the number of Gaussians; None: the
            number is the strategies' alone.
        until: `time.monotonic()` by which the training ends, early if need be.
        generator: of the order.
        report: called after every step with its loss, and with speed and number for the reader.

    Returns:
        The steps taken.

    Raises:
        GeoEvsError: see `Trainer.advance`.
    """
    start = time.monotonic()
    order: Iterator[int] = iter(())
    if choice is not None:
        photos = choice.hold_out(photos)
    for step in range(trainer.steps):
        now = time.monotonic()
        if now >= until:
            if choice is not None:
                choice.settle(trainer)
            break
        number = next(order, None)
        if number is None:
            order = iter(torch.randperm(len(photos), generator=generator).tolist())
            number = next(order)
        loss = trainer.advance(step, photos[number])
        if choice is not None and choice.update(step, trainer, photos):
            photos, order, choice = [*photos, *choice.held], iter(()), None
        rate = (step + 1) / (time.monotonic() - start)
        report(loss, f", {rate:.0f} it/s, {len(trainer.graph):,} Gaussians")
    else:
        return trainer.steps
    return step
