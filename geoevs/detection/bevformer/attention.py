"""Deformable attention by `grid_sample`, in time and into any number of cameras.

Zhu et al., Deformable DETR (ICLR 2021); Li et al., BEVFormer (ECCV 2022), sections 3.3 and 3.4.
Places are (x, y) in [0, 1] from the outer edge of the first cell to that of the last one.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from geoevs.detection.bevformer.settings import HEADS

BEV_POINTS = 4
"""Places that a head looks at in a BEV."""


def sample(
    values: Tensor,  # [N, M, C, h, w]
    places: Tensor,  # [N, M, Q, P, 2]
    weights: Tensor,  # [N, M, Q, P]
) -> Tensor:
    """[N, Q, M C]: sum over P of weight times the value at a place, bilinear, 0 outside."""
    count = values.shape[0]
    found = functional.grid_sample(
        values.flatten(0, 1), 2 * places.flatten(0, 1) - 1, align_corners=False
    )
    mixed = (found * weights.flatten(0, 1)[:, None]).sum(dim=-1)  # [N M, C, Q]
    return mixed.unflatten(0, (count, -1)).flatten(1, 2).transpose(1, 2)


class Aim(nn.Module):
    """Where a query looks, and how much each place counts.

    At first all heads look on rings around the reference, each in a direction of its own, and all
    places count alike.

    Args:
        channels: of what is asked.
        points: places of a head.
        groups: of points that have the same first rings, one after the other in `points`.
        maps: that are looked at; weights sum to 1 in each.
    """

    def __init__(self, channels: int, points: int, groups: int = 1, maps: int = 1) -> None:
        super().__init__()
        self._shape = (maps, HEADS, points)
        self.offsets = nn.Linear(channels, 2 * math.prod(self._shape))
        self.weights = nn.Linear(channels, math.prod(self._shape))
        angles = torch.arange(HEADS) * 2 * math.pi / HEADS
        ring = torch.stack([angles.cos(), angles.sin()], dim=-1)
        reach = 1 + torch.arange(points) // groups
        bias = (ring[:, None] * reach[:, None]).expand(maps, -1, -1, -1)
        with torch.no_grad():
            self.offsets.bias.copy_(bias.flatten())
        for weight in (self.offsets.weight, self.weights.weight, self.weights.bias):
            nn.init.zeros_(weight)

    def forward(self, query: Tensor) -> tuple[Tensor, Tensor]:  # [N, Q, C]
        """Offsets in cells, (maps, N, M, Q, P, 2), and weights, (maps, N, M, Q, P)."""
        offsets = self.offsets(query).unflatten(-1, (*self._shape, 2)).permute(2, 0, 3, 1, 4, 5)
        weights = self.weights(query).unflatten(-1, self._shape).softmax(dim=-1)
        return offsets, weights.permute(2, 0, 3, 1, 4)


class Values(nn.Module):
    """One linear map of every place, split among the heads."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.linear = nn.Linear(channels, channels)

    def forward(
        self,
        tokens: Tensor,  # [N, h w, C]
        size: tuple[int, int],
    ) -> Tensor:
        """(N, M, C / M, h, w) values."""
        return self.linear(tokens).transpose(1, 2).unflatten(1, (HEADS, -1)).unflatten(-1, size)


def cells(size: tuple[int, int], like: Tensor) -> Tensor:
    """(2,) cells across and down of maps of height and width `size`."""
    return like.new_tensor([size[1], size[0]])


class BevAttention(nn.Module):
    """Queries with a place each look around it in a BEV (the decoder's cross-attention).

    Args:
        channels: of queries and BEV.
        size: rows and columns of the BEV.
    """

    def __init__(self, channels: int, size: tuple[int, int]) -> None:
        super().__init__()
        self.size = size
        self.aim = Aim(channels, BEV_POINTS)
        self.values = Values(channels)
        self.out = nn.Linear(channels, channels)

    def forward(
        self,
        query: Tensor,  # [B, N, C]
        reference: Tensor,  # [B, N, 2]
        bev: Tensor,  # [B, rows columns, C]
    ) -> Tensor:
        """(B, N, C) what each sees."""
        offsets, weights = self.aim(query)
        places = reference[:, None, :, None] + offsets[0] / cells(self.size, query)
        return self.out(sample(self.values(bev, self.size), places, weights[0]))


class Past(NamedTuple):
    """The BEV of an earlier frame, for each item of a batch."""

    bev: Tensor  # [B, Q, C]
    present: Tensor  # [B] bool, whether there is one
    from_here: Tensor  # [B, 2, 3] places in the present BEV to places in the earlier one
    motion: Tensor  # [B, 4] metres ahead and to the left, radians, seconds since then


class TemporalSelfAttention(nn.Module):
    """Cells look into the BEV of an earlier frame and into the present one.

    Offsets and weights come from both, one beside the other; what is seen in both is averaged.
    Where there is no earlier frame, the present one stands for it. What the vehicle moved turns and
    shifts the places that are looked at, not the map, so that nothing is resampled twice.

    Args:
        channels: of the BEV.
        size: its rows and columns.
    """

    def __init__(self, channels: int, size: tuple[int, int]) -> None:
        super().__init__()
        self.size = size
        self.aim = Aim(2 * channels, BEV_POINTS, maps=2)
        self.values = Values(channels)
        self.out = nn.Linear(channels, channels)

    def forward(
        self,
        query: Tensor,  # [B, Q, C]
        position: Tensor,  # [Q, C]
        reference: Tensor,  # [Q, 2] the places of the cells
        past: Past,
    ) -> Tensor:
        """(B, Q, C) what each cell sees."""
        there = past.present[:, None, None]
        earlier = torch.where(there, past.bev, query)
        # What lay here, as the earlier BEV has it.
        moved = sample(
            self._map(past.bev)[:, None],
            self._then(reference.expand(len(query), -1, -1), past)[:, None, :, None],
            query.new_ones(len(query), 1, query.shape[1], 1),
        )
        asked = torch.cat([torch.where(there, moved, query), query + position], dim=-1)
        offsets, weights = self.aim(asked)
        places = reference[:, None] + offsets / cells(self.size, query)
        then = self._then(places[0].flatten(1, 3), past).view_as(places[0])
        seen = [
            sample(self.values(bev, self.size), at, weight)
            for bev, at, weight in zip((earlier, query), (then, places[1]), weights, strict=True)
        ]
        return self.out((seen[0] + seen[1]) / 2)

    def _map(self, tokens: Tensor) -> Tensor:
        return tokens.transpose(1, 2).unflatten(-1, self.size)

    def _then(self, places: Tensor, past: Past) -> Tensor:  # [B, N, 2] to the same
        """Places of the present BEV in the earlier one, and where there is none, as they are."""
        moved = places @ past.from_here[:, :, :2].mT + past.from_here[:, None, :, 2]
        # Far outside nothing is seen, and gradients need no numbers of any size.
        return torch.where(past.present[:, None, None], moved.clamp(-1, 2), places)


class Seen(NamedTuple):
    """The views of a batch, and which cells fall where in them; items may differ in their views."""

    features: Tensor  # [V, C, h, w], the views of all items one behind the other
    rows: Tensor  # [V, S] item * Q + cell, of the cells that a view sees, padded
    held: Tensor  # [V, S] bool, False for padding
    places: Tensor  # [V, S, Z, 2] of the cells' pillars in the view
    hits: Tensor  # [B, Q] views that see a cell


def look_up(
    features: Tensor,  # [V, C, h, w]
    item: Tensor,  # [V] int64, whose view it is
    places: Tensor,  # [V, Q, Z, 2]
    visible: Tensor,  # [V, Q, Z] bool: before the camera and inside the picture
    items: int,
) -> Seen:
    """Find the cells that each view sees: those of whose pillar any point is visible in it."""
    seen = visible.any(dim=-1)
    most = max(1, int(seen.sum(dim=1).max()))
    slots = torch.argsort(~seen, dim=1, stable=True)[:, :most]
    hits = torch.zeros(items, seen.shape[1], dtype=places.dtype, device=places.device)
    return Seen(
        features=features,
        rows=item[:, None] * seen.shape[1] + slots,
        held=seen.gather(1, slots),
        places=places.gather(1, slots[:, :, None, None].expand(-1, -1, *places.shape[2:])),
        hits=hits.index_add(0, item, seen.to(places.dtype)),
    )


class SpatialCrossAttention(nn.Module):
    """Cells look into the views that see them, around the points of their pillars.

    What a cell sees is the mean over these views: each has the same say.

    Args:
        channels: of cells and features.
        points: places of a head in a view, a multiple of `heights`.
        heights: points of a pillar.
    """

    def __init__(self, channels: int, points: int, heights: int) -> None:
        super().__init__()
        self.aim = Aim(channels, points, groups=heights)
        self.values = Values(channels)
        self.out = nn.Linear(channels, channels)
        self._repeats = points // heights

    def forward(self, query: Tensor, views: Seen) -> Tensor:  # query [B, Q, C]
        """(B, Q, C) what each cell sees; zeros before the last linear map where no view sees it."""
        # An embedding's gradient adds up in the same order on any number of threads.
        asking = functional.embedding(views.rows, query.flatten(0, 1))  # [V, S, C]
        offsets, weights = self.aim(asking)
        size = views.features.shape[-2:]
        pillars = views.places.repeat(1, 1, self._repeats, 1)[:, None]  # [V, 1, S, P, 2]
        values = self.values(views.features.flatten(2).transpose(1, 2), size)
        got = sample(values, pillars + offsets[0] / cells(size, query), weights[0])
        got = got * views.held[..., None]
        summed = torch.zeros_like(query).flatten(0, 1)
        summed = summed.index_add(0, views.rows.flatten(), got.flatten(0, 1)).view_as(query)
        return self.out(summed / views.hits.clamp(min=1)[..., None])
