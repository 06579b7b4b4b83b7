"""Where along a ray to look: proposal sampling, and the volume rendering that both ends share."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

NEAR, FAR = 0.1, 1000.0  # metres, as published
# Up to here samples lie evenly, beyond it evenly in disparity. Published: 200 m, with 128 samples.
EVEN = 50.0
STABLE = 1e-7


class Proposal(NamedTuple):
    """One round's histogram along rays."""

    edges: Tensor  # [R, S + 1] in [0, 1]
    weights: Tensor  # [R, S]


def to_distance(
    places: Tensor,  # [...] in [0, 1]
) -> Tensor:
    """(...) metres: the first half of places is even in distance, the other one in disparity."""
    low, high = NEAR / (2 * EVEN), 1 - EVEN / (2 * FAR)
    places = low + places * (high - low)
    return torch.where(places < 0.5, places * 2 * EVEN, EVEN / (2 - 2 * places))


def to_place(
    distances: Tensor,  # [...] metres
) -> Tensor:
    """(...) in [0, 1]: the inverse of `to_distance`, clamped."""
    low, high = NEAR / (2 * EVEN), 1 - EVEN / (2 * FAR)
    far = 1 - EVEN / (2 * distances.clamp_min(EVEN))
    places = torch.where(distances < EVEN, distances / (2 * EVEN), far)
    return ((places - low) / (high - low)).clamp(0, 1)


def weigh(
    densities: Tensor,  # [R, S]
    distances: Tensor,  # [R, S + 1] of the samples' edges
) -> Tensor:
    """(R, S): the share of each ray's light that ends in each sample."""
    thickness = densities * distances.diff(dim=1)
    before = pad(thickness[:, :-1].cumsum(1), (1, 0))
    return (-before).exp() * -torch.expm1(-thickness)


def median_distance(
    weights: Tensor,  # [R, S]
    distances: Tensor,  # [R, S + 1] of the samples' edges
) -> Tensor:
    """(R,) metres along each ray where half of the light that ends in it has ended.

    The mean would float between a surface and what is seen behind its edge.
    """
    ended = weights.cumsum(1)
    half = ended[:, -1:] / 2
    index = torch.searchsorted(ended, half).clamp_max(weights.shape[1] - 1)
    weight = weights.gather(1, index)
    share = 1 - (ended.gather(1, index) - half) / weight.clamp_min(STABLE)
    near, far = distances.gather(1, index), distances.gather(1, index + 1)
    return (near + share.clamp(0, 1) * (far - near))[:, 0]


def resample(
    proposal: Proposal,
    samples: int,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Edges of new samples that lie as a histogram says.

    Args:
        proposal: R rays; light that nothing stopped counts to the last sample.
        samples: how many a ray gets.
        generator: jitters the edges, each ray's together; without one they are even.

    Returns:
        (R, samples + 1) in [0, 1], rising.
    """
    edges, weights = proposal
    reached = weights.cumsum(1)[:, :-1].clamp_max(1)
    cdf = torch.cat([torch.zeros_like(edges[:, :1]), reached, torch.ones_like(edges[:, :1])], dim=1)
    wanted = torch.linspace(0, 1, samples + 1, device=edges.device).expand(len(edges), -1)
    if generator is not None:
        jitter = torch.rand(len(edges), 1, generator=generator).to(edges) - 0.5
        wanted = (wanted + jitter / samples).clamp(0, 1)
    above = torch.searchsorted(cdf, wanted.contiguous(), right=True).clamp(1, cdf.shape[1] - 1)
    low, high = cdf.gather(1, above - 1), cdf.gather(1, above)
    left, right = edges.gather(1, above - 1), edges.gather(1, above)
    share = ((wanted - low) / (high - low).clamp_min(STABLE)).clamp(0, 1)
    return left + share * (right - left)


def propose(
    fields: Sequence[Callable[[Tensor], Tensor]],
    counts: Sequence[int],
    origins: Tensor,  # [R, 3]
    directions: Tensor,  # [R, 3] unit vectors
    generator: torch.Generator | None = None,
) -> tuple[Tensor, list[Proposal]]:
    """Ask each field in turn where a ray's light may end.

    Args:
        fields: each from (N, 3) positions to (N,) densities.
        counts: samples of each field's round, and at last those of the radiance field.
        origins: of the rays, metres.
        directions: of the rays.
        generator: see `resample`.

    Returns:
        (R, counts[-1] + 1) edges in [0, 1] without gradient, and the rounds' histograms.
    """
    whole = torch.tensor([[0.0, 1.0]], device=origins.device).expand(len(origins), -1)
    proposal = Proposal(whole, torch.ones_like(whole[:, :1]))
    rounds = []
    for field, count in zip(fields, counts[:-1], strict=True):
        edges = resample(Proposal(*map(torch.Tensor.detach, proposal)), count, generator)
        distances = to_distance(edges)
        positions = points_along(origins, directions, distances)
        densities = field(positions.view(-1, 3)).view(positions.shape[:2])
        proposal = Proposal(edges, weigh(densities, distances))
        rounds.append(proposal)
    return resample(Proposal(*map(torch.Tensor.detach, proposal)), counts[-1], generator), rounds


def points_along(
    origins: Tensor,  # [R, 3]
    directions: Tensor,  # [R, 3]
    distances: Tensor,  # [R, S + 1]
) -> Tensor:
    """(R, S, 3): the samples' middles."""
    middles = (distances[:, 1:] + distances[:, :-1]) / 2
    return origins[:, None] + middles[..., None] * directions[:, None]


def proposal_loss(
    edges: Tensor,  # [R, S + 1] in [0, 1]
    weights: Tensor,  # [R, S]
    rounds: Sequence[Proposal],
) -> Tensor:
    """The loss of proposals: the part of the final weights w that each leaves uncovered.

    Of each proposal it is the mean over rays of sum max(0, w - bound)^2 / w, where the bound is the
    proposal's weight over the smallest span of its samples that holds the final sample (mip-NeRF
    360, equations 12 and 13). The losses of all proposals are added.
    """
    weights = weights.detach()
    losses = []
    for proposal in rounds:
        mass = torch.cat([torch.zeros_like(edges[:, :1]), proposal.weights.cumsum(1)], dim=1)
        # The smallest span of the proposal's samples that holds the final sample.
        last = proposal.edges.shape[1] - 1
        below = torch.searchsorted(proposal.edges, edges[:, :-1].contiguous(), right=True) - 1
        above = torch.searchsorted(proposal.edges, edges[:, 1:].contiguous())
        bound = mass.gather(1, above.clamp(0, last)) - mass.gather(1, below.clamp(0, last))
        uncovered = (weights - bound).clamp_min(0)
        losses.append((uncovered**2 / (weights + STABLE)).sum(1).mean())
    return torch.stack(losses).sum()
