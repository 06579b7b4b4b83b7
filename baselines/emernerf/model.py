"""The whole of EmerNeRF: fields, heads and proposals, rendered along rays."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from baselines.emernerf.fields import (
    ColourHead,
    DynamicField,
    HashField,
    contract,
    encode_directions,
    to_density,
)
from baselines.emernerf.hash_grid import HashGrid
from baselines.emernerf.sampling import (
    Proposal,
    points_along,
    propose,
    to_distance,
    to_place,
    weigh,
)

DIRECTION_FEATURES = 27
COARSEST = 16  # cells along an axis of every grid's first level; published so of the static grid
# Cells of the last one, of the static and of the proposals' grids. Published: 8192, and 512 and
# 2048, for images five times as wide.
FINEST, PROPOSALS_FINEST = 4096, (256, 1024)
APPEARANCE = 16  # numbers an image's embedding has
AROUND = (-1.0, -0.3, 0.3, 1.0)  # metres from a LiDAR point, where its ray's extra samples end
# Samples that weigh less than this in their ray get no colour: nobody would see it.
SEEN = 1e-4


@dataclass(frozen=True)
class Sizes:
    """The sizes of the networks; docs/emernerf.md has the published ones beside them.

    Args:
        levels: of the static hash grid. Proposals and the dynamic grid have half as many, the flow
            grid one less than that.
        log2_entries: of a level of the static and the dynamic grid, as a power of two. The flow
            grid's have half as many entries, proposals' a quarter.
        width: of features and hidden layers. The static and the colour network's hidden layers have
            twice it, proposals' half.
        samples: along a ray, for the two proposal rounds and for the radiance field.
    """

    levels: int
    log2_entries: int
    width: int
    samples: tuple[int, int, int]


class Rays(NamedTuple):
    """Rays in the scene's frame, which is the world's moved to the middle of its box."""

    origins: Tensor  # [R, 3] metres
    directions: Tensor  # [R, 3] unit vectors
    times: Tensor  # [R] in [0, 1]
    images: Tensor  # [R] int64: whose appearance, or -1 for the mean of all


class Motion(NamedTuple):
    """The dynamic field's values along rays."""

    densities: Tensor  # [R, S]
    share: Tensor  # [R, S] of the density
    flow: Tensor  # [N, 6] at every sample
    shadow: Tensor  # [R] squared shadow, rendered


class Rendered(NamedTuple):
    """The values rendered along rays; `rgb` is None where only geometry was asked for."""

    rgb: Tensor | None  # [R, 3]
    depth: Tensor  # [R] metres along the ray, the mean that losses need
    opacity: Tensor  # [R]
    weights: Tensor  # [R, S]
    edges: Tensor  # [R, S + 1] in [0, 1]
    proposals: list[Proposal]
    motion: Motion | None

    @property
    def distances(self) -> Tensor:
        """(R, S + 1) metres of the samples' edges."""
        return to_distance(self.edges)


class EmerNeRF(nn.Module):
    """A static field, and where something moves a dynamic one with its flow.

    Args:
        sizes: of the networks.
        images: that have an appearance of their own.
        box: (2, 3) lowest and highest corner of what is resolved finely, metres.
        step: between neighbouring times, or None for a scene where nothing moves.
        generator: fills the hash grids; networks come from torch's global generator.
    """

    def __init__(
        self, sizes: Sizes, images: int, box: Tensor, step: float | None, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.sizes = sizes
        self.register_buffer("box", box, persistent=False)
        width, levels = sizes.width, sizes.levels
        entries = sizes.log2_entries

        def field(
            dims: int, levels: int, finest: int, entries: int, hidden: tuple[int, ...], out: int
        ) -> HashField:
            grid = HashGrid(dims, levels, COARSEST, finest, entries, generator)
            return HashField(grid, hidden, out)

        def moving(levels: int, entries: int, hidden: tuple[int, ...], out: int) -> HashField:
            # Cells double, so that every level has a vertex at every frame's time.
            return field(4, levels, COARSEST << levels - 1, entries, hidden, out)

        self.static = field(3, levels, FINEST, entries, (2 * width,), width)
        self.proposals = nn.ModuleList(
            field(3, levels // 2, finest, entries - 2, (width // 2,), 1)
            for finest in PROPOSALS_FINEST
        )
        self.dynamic = self.shadow = None
        if step is not None:
            content = moving(levels // 2, entries, (width,), width)
            flow = moving(levels // 2 - 1, entries - 1, (width, width), 6)
            self.dynamic = DynamicField(content, flow, box, step, COARSEST)
            self.shadow = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))
        self.appearance = nn.Embedding(images, APPEARANCE)
        self.colour = ColourHead(width, DIRECTION_FEATURES + APPEARANCE, 2 * width)
        self.sky = ColourHead(0, DIRECTION_FEATURES + APPEARANCE, width)

    def render(
        self,
        rays: Rays,
        generator: torch.Generator | None = None,
        ranges: Tensor | None = None,  # [R]
    ) -> Rendered:
        """Render rays.

        Args:
            rays: what to render.
            generator: jitters the samples, as in training.
            ranges: of LiDAR rays, metres: they get samples around them too, and no colour.
        """
        fields = [self._proposed(field) for field in self.proposals]
        edges, proposals = propose(
            fields, self.sizes.samples, rays.origins, rays.directions, generator
        )
        if ranges is not None:
            # Proposals forget what is there in few frames; measured points keep it in sight.
            around = ranges[:, None] + torch.tensor(AROUND, device=ranges.device)
            edges = torch.cat([edges, to_place(around)], dim=1).sort(dim=1).values
        distances = to_distance(edges)
        points = points_along(rays.origins, rays.directions, distances)
        shape = points.shape[:2]
        features = self.static(contract(points, self.box).view(-1, 3))
        densities = still = to_density(features[:, 0]).view(shape)
        moving = flow = None
        if self.dynamic is not None:
            times = rays.times[:, None].expand(shape).reshape(-1)
            moving, flow = self.dynamic(points.view(-1, 3), times, generator)
            densities = still + to_density(moving[:, 0]).view(shape)
        weights = weigh(densities, distances)
        opacity = weights.sum(1)
        middles = (distances[:, 1:] + distances[:, :-1]) / 2
        depth = (weights * middles).sum(1) / opacity.clamp_min(1e-6)
        share = None if moving is None else (densities - still) / densities.clamp_min(1e-6)
        rgb = shadow = None
        if ranges is None:
            rgb, shadow = self._colours(rays, weights, features, moving, share)
        motion = None
        if moving is not None:
            motion = Motion(densities - still, share, flow, shadow)
        return Rendered(rgb, depth, opacity, weights, edges, proposals, motion)

    def cycle(self, rays: Rays, rendered: Rendered, generator: torch.Generator) -> Tensor:
        """The flow's cycle loss at a random quarter of the samples of rays."""
        points = points_along(rays.origins, rays.directions, rendered.distances)
        times = rays.times[:, None].expand(points.shape[:2]).reshape(-1)
        chosen = torch.randperm(len(times), generator=generator)[: len(times) // 4]
        chosen = chosen.to(times.device)
        return self.dynamic.cycle(
            points.view(-1, 3)[chosen], times[chosen], rendered.motion.flow[chosen]
        )

    def _proposed(self, field: HashField):
        return lambda positions: to_density(field(contract(positions, self.box))[:, 0])

    def _colours(
        self,
        rays: Rays,
        weights: Tensor,  # [R, S]
        features: Tensor,  # [R * S, F]
        moving: Tensor | None,  # [R * S, F]
        share: Tensor | None,  # [R, S]
    ) -> tuple[Tensor, Tensor | None]:
        """(R, 3) colours over the sky, and (R,) squared shadow."""
        known = rays.images.clamp_min(0)
        appearance = torch.where(
            (rays.images >= 0)[:, None], self.appearance(known), self.appearance.weight.mean(0)
        )
        view = torch.cat([encode_directions(rays.directions), appearance], dim=1)
        samples = weights.shape[1]

        def seen(weights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            flat = weights.reshape(-1)
            index = (flat.detach() > SEEN).nonzero()[:, 0]
            return index, index // samples, flat[index]

        everyone = torch.arange(len(view), device=view.device)
        sky = self.sky(view[:, :0], view, everyone)
        rgb = (1 - weights.sum(1))[:, None] * sky
        still = weights if share is None else weights * (1 - share)
        index, ray, weight = seen(still)
        lit = self.colour(features[index], view, ray)
        shadow = None
        if moving is not None:
            shade = self.shadow(moving[index])[:, 0].sigmoid()
            shadow = weight.new_zeros(len(view)).index_add(0, ray, weight * shade**2)
            weight = weight * (1 - shade)
        rgb = rgb.index_add(0, ray, weight[:, None] * lit)
        if moving is not None:
            index, ray, weight = seen(weights * share)
            own = self.colour(moving[index], view, ray)
            rgb = rgb.index_add(0, ray, weight[:, None] * own)
        return rgb, shadow
