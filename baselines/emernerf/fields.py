"""EmerNeRF's fields: density and features at points of space and time."""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from baselines.emernerf.hash_grid import HashGrid

LARGEST_EXPONENT = 15.0  # beyond it, density has no larger gradient
FREQUENCIES = 4  # of the encoded direction: 1 to 8


def contract(
    positions: Tensor,  # [..., 3]
    box: Tensor,  # [2, 3] lowest and highest corner
) -> Tensor:
    """(..., 3) in [0, 1]: the box becomes the middle half, all that is beyond it the rest."""
    place = (positions - box[0]) / (box[1] - box[0]) * 2 - 1
    reach = place.abs().amax(-1, keepdim=True).clamp_min(1)
    return place * (2 - 1 / reach) / reach / 4 + 0.5


class _TruncatedExp(torch.autograd.Function):
    """exp whose gradient does not overflow."""

    @staticmethod
    def forward(ctx: Any, exponent: Tensor) -> Tensor:
        ctx.save_for_backward(exponent)
        return exponent.clamp_max(2 * LARGEST_EXPONENT).exp()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (exponent,) = ctx.saved_tensors
        return gradient * exponent.clamp_max(LARGEST_EXPONENT).exp()


def to_density(
    feature: Tensor,  # [...]
) -> Tensor:
    """(...) density a metre from a field's first feature."""
    return _TruncatedExp.apply(feature - 1)


class HashField(nn.Module):
    """A hash grid and a small network.

    Args:
        grid: encodes positions in space, or in space and time.
        hidden: widths of the hidden layers.
        features: what comes out.
    """

    def __init__(self, grid: HashGrid, hidden: tuple[int, ...], features: int) -> None:
        super().__init__()
        self.grid = grid
        layers: list[nn.Module] = []
        width = grid.out_features
        for wide in hidden:
            layers += [nn.Linear(width, wide), nn.ReLU()]
            width = wide
        self.network = nn.Sequential(*layers, nn.Linear(width, features))

    def forward(
        self,
        places: Tensor,  # [N, D] in [0, 1]
    ) -> Tensor:
        """(N, features) of positions, or of positions and times."""
        return self.network(self.grid(places))


class DynamicField(nn.Module):
    """The field of all that moves: features averaged along the scene flow over neighbouring times.

    Nothing supervises the flow; it emerges because features that agree along it explain more.

    Args:
        content: features at (position, time).
        flow: forward and backward flow in metres a time step, at (position, time).
        box: of the contraction.
        step: between neighbouring times, which lie in [0, 1].
        coarsest: cells of the grids' first level. In short scenes a step is one of them, not
            more: neighbouring frames that share no cell would learn apart, from too few rays.
    """

    def __init__(
        self, content: HashField, flow: HashField, box: Tensor, step: float, coarsest: int
    ) -> None:
        super().__init__()
        self.content, self.flow, self.step = content, flow, step
        self.duration = min(1 / (step * coarsest), 1.0)
        self.register_buffer("box", box, persistent=False)

    def forward(
        self,
        positions: Tensor,  # [N, 3]
        times: Tensor,  # [N]
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Features averaged along the flow, and the flow (section 3.2 of EmerNeRF).

        Args:
            positions: in metres.
            times: in [0, 1].
            generator: in training, draws which neighbour to look at; without one it is both.

        Returns:
            (N, features), and (N, 6) forward and backward flow.
        """
        places = self._places(positions, times)
        here, flow = self.content(places), self.flow(places)
        ahead, behind = self._neighbours(positions, times, flow)
        if generator is None:
            around = self.content(torch.cat([ahead, behind])).view(2, len(positions), -1).mean(0)
        else:
            # One of the two, at random, is in the mean what both are, for half the work.
            coin = torch.rand(times.shape, generator=generator).to(times) < 0.5
            around = self.content(torch.where(coin[:, None], ahead, behind))
        return (here + around) / 2, flow

    def cycle(
        self,
        positions: Tensor,  # [N, 3]
        times: Tensor,  # [N]
        flow: Tensor,  # [N, 6]
    ) -> Tensor:
        """The cycle loss: the flow back, from where the flow led, is its opposite."""
        ahead, behind = self._neighbours(positions, times, flow)
        there, before = self.flow(torch.cat([ahead, behind])).view(2, len(positions), 6)
        forward, backward = flow.detach().split(3, dim=1)
        return 0.5 * ((forward + there[:, 3:]) ** 2 + (backward + before[:, :3]) ** 2).mean()

    def _neighbours(
        self,
        positions: Tensor,  # [N, 3]
        times: Tensor,  # [N]
        flow: Tensor,  # [N, 6]
    ) -> tuple[Tensor, Tensor]:
        """(N, 4) places one step ahead and one behind."""
        forward, backward = flow.split(3, dim=1)
        ahead = self._places(positions + forward, (times + self.step).clamp_max(1))
        behind = self._places(positions + backward, (times - self.step).clamp_min(0))
        return ahead, behind

    def _places(self, positions: Tensor, times: Tensor) -> Tensor:
        return torch.cat([contract(positions, self.box), self.duration * times[:, None]], dim=1)


class ColourHead(nn.Module):
    """Colours from features of samples and of their rays, with one skip connection.

    What depends on the ray alone is multiplied once a ray, not once a sample.
    """

    def __init__(self, sample_features: int, ray_features: int, width: int) -> None:
        super().__init__()
        self.sample_features = sample_features
        inputs = sample_features + ray_features
        self.first = nn.Linear(inputs, width)
        self.second = nn.Linear(inputs + width, width)
        self.last = nn.Linear(width, 3)

    def forward(
        self,
        samples: Tensor,  # [M, sample_features]
        rays: Tensor,  # [R, ray_features]
        ray: Tensor,  # [M] int64: each sample's ray
    ) -> Tensor:
        """(M, 3) colours of the samples, in [0, 1]."""
        inputs = self.sample_features + rays.shape[1]

        def layer(of: nn.Linear) -> Tensor:
            of_samples, of_rays = of.weight[:, :inputs].split(
                [self.sample_features, rays.shape[1]], dim=1
            )
            # Not `[ray]`: its gradient adds up in the order in which threads get to it.
            of_ray = linear(rays, of_rays, of.bias).index_select(0, ray)
            return of_ray + linear(samples, of_samples)

        hidden = layer(self.first).relu()
        hidden = (layer(self.second) + linear(hidden, self.second.weight[:, inputs:])).relu()
        return self.last(hidden).sigmoid()


def encode_directions(
    directions: Tensor,  # [R, 3] unit vectors
) -> Tensor:
    """(R, 27): the direction, and sines and cosines of its multiples."""
    scaled = torch.cat([directions * 2**k for k in range(FREQUENCIES)], dim=1)
    return torch.cat([directions, scaled.sin(), scaled.cos()], dim=1)
