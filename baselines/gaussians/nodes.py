"""A scene as nodes: what stands still, what drives about in a box of its own, the sky behind.

For a picture, the Gaussians of all nodes are put together in the world, and drawn at once; autograd
takes the gradients back to each node (Street Gaussians, Yan et al. 2024).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from baselines.gaussians.constants import ALPHA_THRESHOLD, BLUR, NEAR_PLANE
from baselines.gaussians.interface import Footprints, Rasterization
from baselines.gaussians.model import Gaussians
from baselines.gaussians.rasterizer import rasterize_gaussians
from geoevs.scenes.camera import Camera

REACH = math.sqrt(-2 * math.log(ALPHA_THRESHOLD))
"""Standard deviations from its centre beyond which no Gaussian shows, however opaque."""

FOURIER = 5
"""Coefficients of an actor's colour over time, as published."""

SKY_SHAPE = 64, 256
"""Rows and columns of the sky's map: a pixel is 1.4 degrees wide, three of a default image's."""


class Placed(NamedTuple):
    """Gaussians in the world, as `rasterize_gaussians` takes them."""

    means: Tensor  # [N, 3]
    quats: Tensor  # [N, 4]
    scales: Tensor  # [N, 3]
    opacities: Tensor  # [N]
    sh: Tensor  # [N, K, 3]


@dataclass
class Background:
    """The part of a scene that stands still: Gaussians in the world."""

    gaussians: Gaussians
    name = "background"

    def placed(self, frame: int) -> Placed:
        """The Gaussians in any frame."""
        here = self.gaussians
        return Placed(here.means, here.quats, here.scales, here.opacities, here.sh)


@dataclass
class Actor:
    """An object that moves rigidly: Gaussians about the middle of its box, x along its heading.

    Args:
        name: its track.
        gaussians: in the box; their `sh0` (N, FOURIER, 3) is the constant part over time.
        frames: in which it is there, rising.
        size: length, width and height of its box, metres.
        centres: (F, 3) of the box in the world, metres.
        yaws: (F,) of the box, radians.
        shifts: (F, 3) learned corrections of the centres, metres.
        turns: (F,) learned corrections of the yaws, radians.
    """

    name: str
    gaussians: Gaussians
    frames: tuple[int, ...]
    size: Tensor  # [3]
    centres: Tensor  # [F, 3]
    yaws: Tensor  # [F]
    shifts: Tensor  # [F, 3]
    turns: Tensor  # [F]

    def placed(self, frame: int) -> Placed:
        """The Gaussians where the actor is in one of its frames."""
        here, now = self.gaussians, self.frames.index(frame)
        yaw = self.yaws[now] + self.turns[now]
        means = _turned(here.means, yaw) + self.centres[now] + self.shifts[now]
        constant = torch.einsum("f,nfc->nc", self._waves(now), here.sh0)[:, None]
        sh = torch.cat([constant, _turned_harmonics(here.sh_rest, yaw)], dim=1)
        return Placed(means, _turned_quats(here.quats, yaw), here.scales, here.opacities, sh)

    @torch.no_grad()
    def reaches(self, camera: Camera, frame: int) -> bool:
        """Whether a ball around all that its Gaussians can show is partly in a view."""
        if frame not in self.frames:
            return False
        now = self.frames.index(frame)
        middle = (self.centres[now] + self.shifts[now]).tolist()
        largest = self.gaussians.log_scales.max().exp()
        radius = float(self.size.norm() / 2 + REACH * largest)
        x, y, z, _ = camera.camera_from_world @ [*middle, 1]
        (fx, _, cx), (_, fy, cy), _ = camera.K
        blur = REACH * math.sqrt(BLUR)
        left, right = cx + blur, camera.width - cx + blur
        top, bottom = cy + blur, camera.height - cy + blur
        sides = (
            (left * z + fx * x, math.hypot(fx, left)),
            (right * z - fx * x, math.hypot(fx, right)),
            (top * z + fy * y, math.hypot(fy, top)),
            (bottom * z - fy * y, math.hypot(fy, bottom)),
            (z - NEAR_PLANE, 1.0),
        )
        return all(inward > -radius * length for inward, length in sides)

    def extras(self) -> dict[str, Tensor]:
        """The learned tensors besides the Gaussians, by name: the corrections of the track."""
        return {"shifts": self.shifts, "turns": self.turns}

    @torch.no_grad()
    def confine(self) -> None:
        """Put the Gaussians that have left the box on its sides."""
        half = self.size / 2
        self.gaussians.means.copy_(torch.minimum(torch.maximum(self.gaussians.means, -half), half))

    def _waves(self, now: int) -> Tensor:
        """(FOURIER,) cosines and sines in turn, the first constant, of the time in [0, 1]."""
        first, last = self.frames[0], self.frames[-1]
        time = math.pi * (self.frames[now] - first) / max(last - first, 1)
        waves = [
            math.sin((k + 1) * time) if k % 2 else math.cos(k * time)
            for k in range(self.gaussians.sh0.shape[1])
        ]
        return self.gaussians.sh0.new_tensor(waves)


@dataclass
class Sky:
    """The sky, infinitely far: colours in rows of elevation and columns of azimuth.

    Args:
        colours: (3, rows, columns); the top row looks up, the middle column along the world's x.
    """

    colours: Tensor  # [3, rows, columns]
    name = "sky"

    def extras(self) -> dict[str, Tensor]:
        """The learned tensors of the sky, by name."""
        return {"colours": self.colours}

    def seen(self, camera: Camera) -> Tensor:
        """(H, W, 3) the sky in a view, bilinear between its pixels, all around."""
        return self._at(_sky_grid(camera))

    def towards(self, directions: np.ndarray) -> Tensor:  # [N, 3] of any length but zero
        """(N, 3) the sky in directions of the world, likewise."""
        return self._at(_places(*directions.T)[None])[0]

    def _at(self, places: np.ndarray) -> Tensor:  # [H, W, 2]
        grid = torch.from_numpy(places).to(self.colours)[None]
        around = torch.cat([self.colours[..., -1:], self.colours, self.colours[..., :1]], dim=2)
        columns = self.colours.shape[2]
        grid = grid * grid.new_tensor([columns / (columns + 2), 1])
        colours = torch.nn.functional.grid_sample(
            around[None], grid, padding_mode="border", align_corners=False
        )
        return colours[0].permute(1, 2, 0)


@dataclass
class SceneGraph:
    """The nodes of a scene: one background, its actors, and a sky where there is one."""

    background: Background
    actors: Sequence[Actor] = ()
    sky: Sky | None = None

    def nodes(self) -> Iterator[Background | Actor]:
        """The nodes that are made of Gaussians, the background first."""
        yield self.background
        yield from self.actors

    def draw(self, camera: Camera, frame: int) -> "Drawn":
        """Draw a frame as a camera sees it, with the sky behind."""
        parts = {self.background.name: self.background.placed(frame)}
        # An actor that is elsewhere costs as much as one in the picture.
        parts |= {a.name: a.placed(frame) for a in self.actors if a.reaches(camera, frame)}
        whole = Placed(*map(torch.cat, zip(*parts.values(), strict=True)))
        picture = rasterize_gaussians(*whole, camera)
        if self.sky is not None:
            behind = (1 - picture.opacity)[..., None] * self.sky.seen(camera)
            picture = picture._replace(rgb=picture.rgb + behind)
        ends = np.cumsum([0, *(len(part.means) for part in parts.values())]).tolist()
        rows = dict(zip(parts, map(slice, ends[:-1], ends[1:]), strict=True))
        return Drawn(picture, whole, rows)

    def __len__(self) -> int:
        """The number of Gaussians."""
        return sum(len(node.gaussians) for node in self.nodes())

    def extras(self) -> dict[str, dict[str, Tensor]]:
        """The learned tensors besides the Gaussians, by node and name."""
        nodes = [*self.actors, *((self.sky,) if self.sky else ())]
        return {node.name: node.extras() for node in nodes}

    def parameters(self) -> int:
        """The number of learned values."""
        tensors = [t for node in self.nodes() for _, t in node.gaussians.named_parameters()]
        tensors += [t for extras in self.extras().values() for t in extras.values()]
        return sum(tensor.numel() for tensor in tensors)


class Drawn(NamedTuple):
    """A picture of a scene, what was drawn, the background first, and which rows are whose."""

    picture: Rasterization
    whole: Placed
    rows: dict[str, slice]  # by the node's name

    def footprints(self, name: str) -> Footprints:
        """The footprints of one node's Gaussians."""
        rows, everyone = self.rows[name], self.picture.footprints
        gradient = everyone.means2d_grad
        return Footprints(everyone.radii[rows], None if gradient is None else gradient[rows])


def _turned(points: Tensor, yaw: Tensor) -> Tensor:  # [N, 3], []
    x, y, z = points.unbind(1)
    cos, sin = yaw.cos(), yaw.sin()
    return torch.stack([cos * x - sin * y, sin * x + cos * y, z], dim=1)


def _turned_quats(quats: Tensor, yaw: Tensor) -> Tensor:  # [N, 4], []
    w, x, y, z = quats.unbind(1)
    cos, sin = (yaw / 2).cos(), (yaw / 2).sin()
    turned = [cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w]
    return torch.stack(turned, dim=1)


def _turned_harmonics(sh_rest: Tensor, yaw: Tensor) -> Tensor:  # [N, 0 or 3, 3], []
    """Harmonics of degree 1, which are -y, z and -x of a vector, turned with the actor."""
    if not sh_rest.shape[1]:
        return sh_rest
    y, z, x = sh_rest.unbind(1)
    cos, sin = yaw.cos(), yaw.sin()
    return torch.stack([sin * x + cos * y, z, cos * x - sin * y], dim=1)


@lru_cache(maxsize=64)  # a scene's photographs, which are drawn again and again
def _sky_grid(camera: Camera) -> np.ndarray:
    """(H, W, 2) float32 places in the sky's map, from -1 to 1 across it."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    pixels = np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size)])
    directions = camera.world_from_camera[:3, :3] @ np.linalg.solve(camera.K, pixels)
    return _places(*directions).reshape(camera.height, camera.width, 2)


def _places(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:  # [N] each
    """(N, 2) float32 where directions lie in the sky's map, from -1 to 1 across it."""
    azimuth, elevation = np.arctan2(y, x) / np.pi, np.arctan2(z, np.hypot(x, y)) / (np.pi / 2)
    return np.stack([azimuth, -elevation], axis=1).astype(np.float32)
