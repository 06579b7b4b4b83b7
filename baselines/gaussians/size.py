"""No more Gaussians than a scene needs: deleted for as long as views that were held out allow.

A training grows to a cap first. Then, round by round, the Gaussians that make up the least of the
pictures are deleted, and the others go on learning. Held-out views of the source cameras say what
a round has cost: a Gaussian is kept if it is worth its price in decibels, the same in all scenes.
"""

import copy
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from baselines.gaussians.nodes import SceneGraph
from baselines.gaussians.optimiser import Optimiser
from baselines.gaussians.rasterizer import blending_weights

if TYPE_CHECKING:
    from baselines.gaussians.training import Photo, Trainer

PRICE = 1e-5
"""Price of a Gaussian in decibels: a thousand must gain 0.01 dB on views that were held out."""

MOST, UNCHOSEN = 32_000, 8_000
"""Most Gaussians that a training starts from and grows to; and their number where nothing can be
held out."""

HELD_OUT = 8
"""One in so many photographs is held out."""

START, STOP, ROUNDS = 0.55, 0.85, 6
"""Shares of the training between which Gaussians are deleted, and the most rounds of it."""

DELETED = 0.3
"""Share of the Gaussians that a round deletes."""


class SizeChoice:
    """The choice of one scene's size, while it is trained.

    Args:
        steps: how long the training is.
        price: decibels a Gaussian.
    """

    def __init__(self, steps: int, price: float = PRICE) -> None:
        every = (STOP - START) * steps / ROUNDS
        self._rounds = {round(START * steps + every * number) for number in range(ROUNDS + 1)}
        self._last, self._price = max(self._rounds), price
        self._best, self._score = None, -float("inf")
        self.held: list[Photo] = []

    def hold_out(self, photos: "Sequence[Photo]") -> "list[Photo]":
        """Take one in HELD_OUT photographs; the others are returned, to train on.

        Args:
            photos: frame by frame, all cameras in turn.
        """
        cameras = sum(photo.frame == photos[0].frame for photo in photos)
        places = held_out(len(photos), cameras)
        self.held = [photos[place] for place in places]
        return [photo for place, photo in enumerate(photos) if place not in places]

    def update(self, step: int, trainer: "Trainer", photos: "Sequence[Photo]") -> bool:
        """Called after every step; whether the choice is made."""
        if step not in self._rounds:
            return False
        optimiser = trainer.optimisers["background"]
        score = psnr(trainer.graph, self.held) - self._price * len(optimiser.gaussians)
        if score > self._score:
            self._best, self._score = copy.deepcopy(optimiser), score
            if step < self._last:
                delete(trainer.graph, optimiser, photos)
                return False
        self.settle(trainer)
        return True

    def settle(self, trainer: "Trainer") -> None:
        """Take up the best state again, if any was judged: the last deletion was not."""
        if self._best is not None:
            trainer.optimisers["background"] = self._best
            trainer.graph.background.gaussians = self._best.gaussians


def held_out(count: int, cameras: int) -> list[int]:
    """Places of one in HELD_OUT of `count` photographs, which are listed camera after camera.

    Where HELD_OUT and the number of cameras share a factor, even steps would meet some cameras
    alone, so that every round of them begins one place earlier.

    >>> held_out(16, 2), held_out(40, 5)
    ([7, 14], [7, 15, 23, 31, 39])
    """
    shared = math.gcd(HELD_OUT, cameras)
    turns = range(count // HELD_OUT)
    return [HELD_OUT * turn + HELD_OUT - 1 - turn // (cameras // shared) % shared for turn in turns]


@torch.no_grad()
def psnr(graph: SceneGraph, photos: "Sequence[Photo]") -> float:
    """The mean PSNR of photographs, decibels."""
    errors = [
        (graph.draw(photo.camera, photo.frame).picture.rgb.clamp(0, 1) - photo.image)
        .square()
        .mean()
        for photo in photos
    ]
    return float((-10 * torch.stack(errors).clamp_min(1e-10).log10()).mean())


def delete(graph: SceneGraph, optimiser: Optimiser, photos: "Sequence[Photo]") -> None:
    """Delete the background's Gaussians that have the least weight in all photographs together."""
    weights = torch.zeros_like(optimiser.gaussians.logit_opacities)
    for photo in photos:
        with torch.no_grad():
            whole = graph.draw(photo.camera, photo.frame).whole
        weights += blending_weights(*whole[:4], photo.camera)[: len(weights)]
    least = weights.argsort(stable=True)
    optimiser.keep(least[int(DELETED * len(least)) :].sort().values)
