"""What Street Gaussians adds to the photometric loss: LiDAR depth, sky, actors of solid boxes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from baselines.gaussians.nodes import SKY_SHAPE, Drawn, SceneGraph, Sky
from baselines.gaussians.rasterizer import rasterize_gaussians
from baselines.gaussians.training import Photo
from baselines.street_gaussians.actors import Track
from geoevs.geometry.sky import find_sky
from geoevs.projection import zbuffer
from geoevs.scenes.scene import PointCloud

DEPTH_WEIGHT, SKY_WEIGHT, ENTROPY_WEIGHT = 0.01, 0.05, 0.1
"""Weights of the three losses, as published."""

TRUSTED = 0.95
"""Share of LiDAR pixels that teach, those with the smallest errors."""

ENTROPY_START = 0.5
"""Share of the training after which boxes become solid or empty."""

TINY = 1e-6


def with_evidence(photo: Photo, cloud: PointCloud, tracks: Sequence[Track]) -> Photo:
    """A photograph with its LiDAR depth, its sky and the outlines of its boxes."""
    depth = zbuffer(cloud.xyz, photo.camera, visibility="footprint").depth
    boxes = np.zeros(depth.shape, bool)
    for track in tracks:
        boxes |= track.shown(photo.camera, photo.frame)
    sky = find_sky(photo.image.cpu().numpy(), cloud.xyz, photo.camera)
    known = {"depth": depth.astype(np.float32), "sky": sky, "boxes": boxes}
    return replace(
        photo, known={k: torch.from_numpy(v).to(photo.image.device) for k, v in known.items()}
    )


def street_loss(graph: SceneGraph, photo: Photo, drawn: Drawn, done: float) -> Tensor:
    """The three losses of a picture, weighted; `done` is the share of the training so far."""
    opacity = drawn.picture.opacity.clamp(TINY, 1 - TINY)
    measured = photo.known["depth"] > 0
    loss = SKY_WEIGHT * sky_loss(opacity, photo.known["sky"], measured)
    loss = loss + DEPTH_WEIGHT * depth_loss(
        drawn.picture.depth[measured], photo.known["depth"][measured]
    )
    start = drawn.rows["background"].stop
    if done >= ENTROPY_START and start < len(drawn.whole.means):
        actors = rasterize_gaussians(*(part[start:] for part in drawn.whole), photo.camera)
        loss = loss + ENTROPY_WEIGHT * entropy_loss(actors.opacity, photo.known["boxes"])
    return loss


def depth_loss(
    depths: Tensor,  # [P]
    measured: Tensor,  # [P]
) -> Tensor:
    """Mean difference in metres from LiDAR, without the largest: moving or mistaken points."""
    count = int(TRUSTED * len(measured))
    if not count:
        return depths.sum() * 0
    return (depths - measured).abs().topk(count, largest=False, sorted=False).values.mean()


def sky_loss(
    opacity: Tensor,  # [H, W]
    sky: Tensor,  # [H, W] bool
    measured: Tensor,  # [H, W] bool
) -> Tensor:
    """Cross-entropy of opacity: nothing before the sky, something where LiDAR met it.

    The published loss takes all that is not sky for opaque; sky is found here without a network,
    which misses some.
    """
    clear, solid = -(1 - opacity).log(), -opacity.log()
    return (clear * (sky & ~measured) + solid * measured).mean()


def entropy_loss(
    opacity: Tensor,  # [H, W] of the actors alone
    boxes: Tensor,  # [H, W] bool
) -> Tensor:
    """Binary entropy in boxes, and nothing outside them."""
    opacity = opacity.clamp(TINY, 1 - TINY)
    empty = -(1 - opacity).log()
    entropy = -opacity * opacity.log() + (1 - opacity) * empty
    return torch.where(boxes, entropy, empty).mean()


def new_sky(photos: Sequence[Photo]) -> Sky:
    """A sky of the mean colour of what the photographs show of it; grey if nothing."""
    pixels = torch.cat([photo.image[photo.known["sky"]] for photo in photos])
    colour = pixels.mean(dim=0) if len(pixels) else photos[0].image.new_full((3,), 0.5)
    return Sky(colour[:, None, None].repeat(1, *SKY_SHAPE))
