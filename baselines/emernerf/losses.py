"""EmerNeRF's losses, with the published weights; docs/emernerf.md says what else differs."""

import torch
from torch import Tensor

from baselines.emernerf.model import EmerNeRF, Rays, Rendered
from baselines.emernerf.sampling import proposal_loss

FARTHEST = 80.0  # metres that depths are divided by, and beyond which none counts
SIGHT_MARGIN = 3.0, 1.0  # metres around a LiDAR point where light may end: at first, at last
SIGHT_START, SIGHT_HALF = 0.08, 0.2  # shares of the fit: when it starts, how soon it halves
DYNAMIC_START = 0.3  # share of the fit that dynamic density is free for
SKY, DYNAMIC, SHADOW, CYCLE, SIGHT = 0.001, 0.01, 0.01, 0.01, 0.1


def image_losses(
    model: EmerNeRF,
    rays: Rays,
    rgb: Tensor,  # [R, 3]
    sky: Tensor,  # [R] bool
    done: float,
    generator: torch.Generator,
) -> tuple[dict[str, Tensor], Tensor]:
    """Losses of pixels' rays, by name, and (R,) squared errors of their colours.

    `done` is the share of the fit so far.
    """
    result = model.render(rays, generator)
    errors = ((result.rgb - rgb) ** 2).mean(1)
    opacity = result.opacity.clamp(1e-6, 1 - 1e-6)
    losses = {
        "rgb": errors.mean(),
        "sky": -SKY * torch.where(sky, torch.log1p(-opacity), opacity.log()).mean(),
        "proposal": proposal_loss(result.edges, result.weights, result.proposals),
    }
    if result.motion is not None:
        sparse = DYNAMIC if done >= DYNAMIC_START else 0.0
        losses["dynamic"] = sparse * result.motion.densities.mean()
        losses["shadow"] = SHADOW * result.motion.shadow.mean()
        losses["cycle"] = CYCLE * model.cycle(rays, result, generator)
    return losses, errors.detach()


def lidar_losses(
    model: EmerNeRF,
    rays: Rays,
    ranges: Tensor,  # [R] metres along the ray
    done: float,
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """Losses of LiDAR points' rays, by name; `done` is the share of the fit so far."""
    result = model.render(rays, generator, ranges)
    near = ranges < FARTHEST
    depth = (result.depth / FARTHEST).clamp(0, 1)
    losses = {
        "depth": (near * (depth - ranges / FARTHEST) ** 2).sum() / near.sum().clamp_min(1),
        "lidar proposal": proposal_loss(result.edges, result.weights, result.proposals),
    }
    if done > SIGHT_START:
        since = done - SIGHT_START
        first, last = SIGHT_MARGIN
        margin = first + (last - first) * since / (1 - SIGHT_START)
        decayed = 0.5 ** (since // SIGHT_HALF)
        losses["sight"] = SIGHT * decayed * line_of_sight(result, ranges, margin)
    return losses


def line_of_sight(
    result: Rendered,
    ranges: Tensor,  # [R]
    margin: float,
) -> Tensor:
    """Light ends near the measured point, as a normal distribution does, and nowhere before it.

    The distribution's mass in each sample is compared with the sample's weight. Within the margin
    are three standard deviations.
    """
    edges = result.distances
    middles = (edges[:, 1:] + edges[:, :-1]) / 2
    offset = middles - ranges[:, None]
    deviations = (edges - ranges[:, None]) * (3 / margin)
    mass = torch.special.ndtr(deviations).diff(dim=1)
    empty = (offset < -margin) * result.weights**2
    around = (offset.abs() <= margin) * (result.weights - mass) ** 2
    return (empty + around).sum(1).mean()
