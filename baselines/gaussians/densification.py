"""Where Gaussians are added and removed while they are trained.

A strategy acts on the optimiser alone, so that parameters and moments stay in step. Both here are
rules as published; streets do without one rule of 3DGS, which prunes Gaussians larger than a tenth
of the scene's extent: facades are farther away than the cameras drive, and rightly coarser.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from baselines.gaussians.interface import Footprints
from baselines.gaussians.model import Gaussians
from baselines.gaussians.optimiser import Optimiser
from baselines.gaussians.rotations import rotation_matrices
from geoevs.scenes.camera import Camera

LEAST_OPACITY = 0.005
"""Opacity below which Gaussians are pruned, or relocated."""

RESET_OPACITY = 2 * LEAST_OPACITY
SHRINK = 1.6
"""Factor by which the parts of a split Gaussian are smaller."""

GROWTH = 1.05
MOST_COPIES = 51
"""Most copies of one Gaussian at a time, as many as gsplat's table has."""

NOISE = 5e5
"""Size of the noise of positions, in learning rates of the means."""

NOISE_SLOPE, NOISE_OPACITY = 100.0, 0.005
"""Slope and middle of the step by which noise depends on opacity: Gaussians above hardly move."""

PENALTY = 0.01
"""Weight of mean opacity, and of mean scale, in the loss."""


@dataclass(frozen=True)
class Schedule:
    """The steps at which a strategy acts, counted from 0, as published for 30 000 steps."""

    start: int = 500
    stop: int = 15_000
    every: int = 100

    def acts(self, step: int) -> bool:
        """Whether Gaussians are added and removed after this step."""
        return self.start < step < self.stop and step % self.every == 0


class Strategy(Protocol):
    """A rule by which Gaussians are added and removed during training."""

    def penalty(self, gaussians: Gaussians) -> Tensor | float:
        """The term that the strategy adds to the loss."""
        ...

    def update(
        self,
        step: int,
        optimiser: Optimiser,
        footprints: Footprints,
        camera: Camera,
        generator: torch.Generator,
    ) -> None:
        """Called after every step of the optimiser.

        Args:
            step: counted from 0.
            optimiser: of the Gaussians that were drawn.
            footprints: where they fell, with their gradients.
            camera: the view they were drawn in.
            generator: of all randomness.

        Raises:
            GeoEvsError: no Gaussian is left.
        """
        ...


@dataclass
class GradientStrategy:
    """Adaptive density control (Kerbl et al. 2023): grow where the loss pulls footprints about.

    Gaussians whose mean gradient is over `gradient` are cloned where they are small, split where
    they are large; transparent ones are pruned, and all are made so now and then, so that only
    those that the images need come back.

    Args:
        cap: no more Gaussians than this; the steepest gradients come first.
        schedule: when.
        reset_every: steps between resets of the opacity.
        gradient: of the loss by the centre, whose coordinates go from -1 to 1 across the picture.
        small: largest scale of a clone, as a part of the scene's extent.
    """

    cap: int
    schedule: Schedule = Schedule()
    reset_every: int = 3000
    gradient: float = 2e-4
    small: float = 0.01
    _total: Tensor | None = field(default=None, init=False)  # [N]
    _count: Tensor | None = field(default=None, init=False)  # [N]

    def penalty(self, gaussians: Gaussians) -> float:
        """The term added to the loss: zero, since this strategy has no penalty."""
        return 0.0

    @torch.no_grad()
    def update(
        self,
        step: int,
        optimiser: Optimiser,
        footprints: Footprints,
        camera: Camera,
        generator: torch.Generator,
    ) -> None:
        """Count gradients; from time to time clone, split, prune and reset opacities.

        Raises:
            GeoEvsError: no Gaussian is left.
        """
        if step >= self.schedule.stop:
            return
        self._accumulate(footprints, camera)
        if self.schedule.acts(step):
            if self._total is not None:
                self._grow(optimiser, generator)
            optimiser.keep(optimiser.gaussians.opacities >= LEAST_OPACITY)
            self._total = self._count = None
        if step > 0 and step % self.reset_every == 0:
            reset_opacities(optimiser)

    def _accumulate(self, footprints: Footprints, camera: Camera) -> None:
        """Add a picture's gradients, per half side of the picture, of what it shows."""
        if not footprints.radii.any():
            return  # and no gradient
        half = footprints.radii.new_tensor([camera.width / 2, camera.height / 2])
        steepness = (footprints.means2d_grad.to(half) * half).norm(dim=1)
        visible = (footprints.radii > 0).to(half)
        if self._total is None or len(self._total) != len(visible):  # others may prune too
            self._total, self._count = torch.zeros_like(visible), torch.zeros_like(visible)
        self._total += steepness * visible
        self._count += visible

    def _grow(self, optimiser: Optimiser, generator: torch.Generator) -> None:
        gaussians = optimiser.gaussians
        mean = self._total / self._count.clamp_min(1)
        order = mean.argsort(descending=True, stable=True)
        room = max(self.cap - len(gaussians), 0)
        growing = order[mean[order] > self.gradient][:room].sort().values
        small = gaussians.scales[growing].amax(1) <= self.small * optimiser.extent
        clones = gaussians.select(growing[small])
        parts = split(gaussians.select(growing[~small]), generator)
        kept = torch.ones(len(gaussians), dtype=torch.bool, device=growing.device)
        kept[growing[~small]] = False
        # Appended first: where all are split, none would be left in between.
        new = len(clones) + len(parts)
        optimiser.append(clones)
        optimiser.append(parts)
        optimiser.keep(torch.cat([kept, kept.new_ones(new)]))


@dataclass
class MCMCStrategy:
    """3DGS as Markov chain Monte Carlo (Kheradmand et al. 2024): a budget, noise, no loss of mass.

    Transparent Gaussians become copies of opaque ones, new ones too until there are `cap`; copies
    share the opacity and size of their original so that the picture hardly changes.

    Args:
        cap: the number of Gaussians that is grown to.
        schedule: when.
    """

    cap: int
    schedule: Schedule = Schedule(stop=25_000)

    def penalty(self, gaussians: Gaussians) -> Tensor:
        """Mean opacity and scale, which make Gaussians vanish that the images do not need."""
        return PENALTY * (gaussians.opacities.mean() + gaussians.scales.mean())

    @torch.no_grad()
    def update(
        self,
        step: int,
        optimiser: Optimiser,
        footprints: Footprints,
        camera: Camera,
        generator: torch.Generator,
    ) -> None:
        """Move transparent Gaussians at random; relocate and add others as the schedule says."""
        if self.schedule.acts(step):
            self._relocate(optimiser, generator)
            self._add(optimiser, generator)
        add_noise(optimiser.gaussians, NOISE * optimiser.means_rate(step), generator)

    def _relocate(self, optimiser: Optimiser, generator: torch.Generator) -> None:
        """Make transparent Gaussians copies of others."""
        gaussians = optimiser.gaussians
        dead = gaussians.opacities <= LEAST_OPACITY
        chances = torch.where(dead, 0.0, gaussians.opacities)
        dead = dead.nonzero()[:, 0]
        if not len(dead) or len(dead) == len(gaussians):
            return
        originals = draw(chances, len(dead), generator)
        share(gaussians, originals)
        copies = gaussians.select(originals)
        for name, tensor in gaussians.named_parameters():
            tensor[dead] = getattr(copies, name)
        optimiser.forget(torch.cat([dead, originals]))

    def _add(self, optimiser: Optimiser, generator: torch.Generator) -> None:
        """Add copies, a twentieth of all, as far as the cap allows."""
        gaussians = optimiser.gaussians
        count = min(self.cap, int(GROWTH * len(gaussians))) - len(gaussians)
        if count <= 0:
            return
        originals = draw(gaussians.opacities, count, generator)
        share(gaussians, originals)
        optimiser.forget(originals)
        optimiser.append(gaussians.select(originals))


@torch.no_grad()
def reset_opacities(optimiser: Optimiser) -> None:
    """Make all Gaussians nearly transparent."""
    logits = optimiser.gaussians.logit_opacities
    logits.clamp_(max=math.log(RESET_OPACITY / (1 - RESET_OPACITY)))
    optimiser.forget(torch.arange(len(logits), device=logits.device), "logit_opacities")


def split(gaussians: Gaussians, generator: torch.Generator) -> Gaussians:
    """Two smaller Gaussians for each, at random places within it; all first, then all second."""
    rows = torch.arange(len(gaussians), device=gaussians.means.device).repeat(2)
    parts = gaussians.select(rows)
    offsets = parts.scales * normal(parts.means, generator)
    parts.means += (rotation_matrices(parts.quats) @ offsets[:, :, None])[:, :, 0]
    parts.log_scales -= math.log(SHRINK)
    return parts


def share(gaussians: Gaussians, originals: Tensor) -> None:  # [M] int64
    """Give the drawn Gaussians the opacity and size that they share with their copies.

    `originals` has an index for every copy; see `shared_opacities`.
    """
    times = torch.bincount(originals, minlength=len(gaussians))
    rows = times.nonzero()[:, 0]
    copies = (times[rows] + 1).clamp_max(MOST_COPIES)
    opacities, factors = shared_opacities(gaussians.opacities[rows], copies)
    gaussians.logit_opacities[rows] = opacities.logit()
    gaussians.log_scales[rows] += factors.log()[:, None]


def shared_opacities(
    opacities: Tensor,  # [M]
    copies: Tensor,  # [M] int64, 1 to MOST_COPIES
) -> tuple[Tensor, Tensor]:
    """Opacities and sizes by which N copies in one place look like one Gaussian.

    The rule is equation 9 of Kheradmand et al. 2024. The copies' opacity p lets as much light
    through together, (1 - p)^N = 1 - o. Their scale is o / D of the original's, with D the sum over
    k of C(N, k) (-1)^(k-1) p^k / sqrt(k), so that they cover as much in all along any line. (The
    published double sum over i and k is this one: the sum of C(i-1, k) over i is C(N, k+1).)

    Returns:
        p (M,), from LEAST_OPACITY to just under 1, and the scale's factor (M,).
    """
    exact = opacities.double().clamp_max(1 - torch.finfo(torch.float32).eps)
    shared = 1 - (1 - exact) ** (1 / copies.double())
    k = range(1, MOST_COPIES + 1)
    signed = [[math.comb(n, i) * (-1) ** (i - 1) / math.sqrt(i) for i in k] for n in (0, *k)]
    powers = shared[:, None] ** torch.tensor(k, device=shared.device)
    factors = exact / (exact.new_tensor(signed)[copies] * powers).sum(1)
    return shared.clamp_min(LEAST_OPACITY).to(opacities), factors.to(opacities)


def add_noise(gaussians: Gaussians, size: float, generator: torch.Generator) -> None:
    """Move centres at random within their Gaussians, the transparent ones alone."""
    gate = torch.sigmoid(NOISE_SLOPE * (NOISE_OPACITY - gaussians.opacities))
    noise = size * gate[:, None] * normal(gaussians.means, generator)
    rotations = rotation_matrices(gaussians.quats)
    along = (noise[:, None] @ rotations)[:, 0] * gaussians.scales**2
    gaussians.means += (rotations @ along[:, :, None])[:, :, 0]


def normal(like: Tensor, generator: torch.Generator) -> Tensor:
    """Normal random numbers in the shape of `like`, wherever the generator lives."""
    return torch.randn(like.shape, generator=generator, device=generator.device).to(like)


def draw(
    chances: Tensor,  # [N]
    count: int,
    generator: torch.Generator,
) -> Tensor:
    """(count,) int64 indices, drawn with replacement."""
    drawn = chances.to(generator.device).multinomial(count, True, generator=generator)
    return drawn.to(chances.device)
