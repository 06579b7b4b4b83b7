"""A scene's nodes as plain Gaussians of one frame, for files that know no nodes."""

import math

import numpy as np
import torch
from torch import Tensor

from baselines.gaussians.constants import SH_C0
from baselines.gaussians.nodes import SceneGraph, Sky
from geoevs.scenes.splats import Splats

SKY_COUNT = 32768
"""Gaussians of the sky: 1.1 degrees apart, where a pixel of the sky's map has 1.4."""

SKY_RADIUS = 5000.0
"""Metres to the sky at least: ten metres aside, it is off by a tenth of a degree."""

SKY_BEYOND = 2.0
"""Times as far as the farthest other Gaussian the sky lies, where that is more."""

SKY_OVERLAP = 0.7
"""Standard deviation of a Gaussian of the sky, in spacings: little more than 1 % shines through."""

SKY_OPACITY = 0.99


@torch.no_grad()
def scene_splats(graph: SceneGraph, frame: int) -> Splats:
    """All that a graph draws in a frame, in the world, actors where they are then.

    Args:
        graph: the scene.
        frame: the moment; actors that are not there are left out.
    """
    nodes = [graph.background, *(actor for actor in graph.actors if frame in actor.frames)]
    placed = [node.placed(frame) for node in nodes]
    means = _joined([part.means for part in placed])
    return Splats(
        means,
        _joined([part.quats for part in placed]),
        _joined([node.gaussians.log_scales for node in nodes]),
        _joined([node.gaussians.logit_opacities for node in nodes]),
        _joined([part.sh for part in placed]),
        None if graph.sky is None else sky_splats(graph.sky, means),
    )


def sky_splats(
    sky: Sky,
    means: np.ndarray,  # [N, 3] what stands before it
) -> Splats:
    """A sky as a shell of round Gaussians about the middle of a scene.

    They lie on a Fibonacci lattice, each of the area 4 pi / SKY_COUNT on the unit sphere. The sky
    itself is infinitely far; the shell is as far as numbers of viewers reach.
    """
    middle = np.median(means, axis=0)
    farthest = float(np.linalg.norm(means - middle, axis=1).max())
    radius = max(SKY_RADIUS, SKY_BEYOND * farthest)
    number = np.arange(SKY_COUNT)
    z = 1 - (2 * number + 1) / SKY_COUNT
    azimuth, across = number * math.pi * (3 - math.sqrt(5)), np.sqrt(1 - z * z)
    directions = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)
    colours = sky.towards(directions).cpu().numpy()
    size = SKY_OVERLAP * radius * math.sqrt(4 * math.pi / SKY_COUNT)
    return Splats(
        (middle + radius * directions).astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (SKY_COUNT, 1)),
        np.full((SKY_COUNT, 3), math.log(size), np.float32),
        np.full(SKY_COUNT, math.log(SKY_OPACITY / (1 - SKY_OPACITY)), np.float32),
        ((colours[:, None] - 0.5) / SH_C0).astype(np.float32),
    )


def _joined(parts: list[Tensor]) -> np.ndarray:
    return torch.cat(parts).float().cpu().numpy()
