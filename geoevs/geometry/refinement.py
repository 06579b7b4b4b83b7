"""Refining a network's depth by LiDAR and image: what completes what (paper section 3.2).

A network that sees images knows outlines and what lies above the highest beam; LiDAR knows surfaces
to centimetres. Which of the two is right where is learned, on procedural truth.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from geoevs.geometry.lidar import complete_depth, lidar_reach
from geoevs.projection import zbuffer
from geoevs.scenes.camera import Camera

NANO_CHANNELS = (16, 32, 48, 64, 64)
INPUTS = 9
COLOURS = slice(0, 3)
# Channels of the input: what the output builds on, and where LiDAR pixels are.
FITTED, DIFFERENCE, MEASURED = 3, 5, 7
CENTRE = 2.5  # logarithm of a street's typical depth, 12 m
NEAREST, FARTHEST = 0.5, 200.0  # metres
ELEVATION_GAIN = 4.0


class DepthRefiner(nn.Module):
    """A small U-Net that chooses between two depths of every pixel, and corrects its choice.

    Args:
        channels: of its levels, the finest first; each has half the resolution of the one before.
    """

    def __init__(self, channels: Sequence[int]) -> None:
        super().__init__()
        self.down, self.up = nn.ModuleList(), nn.ModuleList()
        count = INPUTS
        for level in channels:
            self.down.append(_two_convolutions(count, level))
            count = level
        for level in channels[-2::-1]:
            self.up.append(_two_convolutions(count + level, level))
            count = level
        self.last = nn.Conv2d(count, 2, 1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, inputs: Tensor) -> Tensor:  # [B, INPUTS, H, W], see `refiner_inputs`
        """(B, H, W) log-depth, at first the geometric mean of both."""
        level, levels = inputs, []
        for number, block in enumerate(self.down):
            level = block(functional.avg_pool2d(level, 2, ceil_mode=True) if number else level)
            levels.append(level)
        for block, finer in zip(self.up, levels[-2::-1], strict=True):
            coarser = functional.interpolate(level, finer.shape[-2:], mode="nearest")
            level = block(torch.cat([coarser, finer], dim=1))
        choice, correction = self.last(level).float().unbind(1)
        chosen = inputs[:, FITTED] + choice.sigmoid() * inputs[:, DIFFERENCE]
        return chosen + correction + CENTRE


def _two_convolutions(read: int, made: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(read, made, 3, padding=1),
        nn.SiLU(),
        nn.Conv2d(made, made, 3, padding=1),
        nn.SiLU(),
    )


def refiner_inputs(
    image: np.ndarray,  # [H, W, 3] float32 in [0, 1]
    fitted: np.ndarray,  # [H, W] metres, 0 = none
    points: np.ndarray,  # [N, 3] LiDAR in the world
    camera: Camera,
) -> np.ndarray | None:
    """The maps of one view that a refiner reads.

    Args:
        image: the view.
        fitted: the network's depth after `fit_scale`.
        points: LiDAR that methods may use.
        camera: the view's.

    Returns:
        (INPUTS, H, W) float32: colours; logarithms of the fitted depth and of the LiDAR's completed
        one, which is the fitted one where the LiDAR does not reach, and their difference; at LiDAR
        pixels how far that is off, and where these are; the sine of every pixel's elevation. None
        where the LiDAR sees too little to be completed.
    """
    completed = complete_depth(points, camera, image)
    if not completed.any():
        return None
    completed = np.where(completed > 0, completed, fitted)
    sparse = zbuffer(points, camera, visibility="footprint").depth
    known = sparse > 0
    first, second, measured = (
        np.log(np.clip(depth, NEAREST, FARTHEST)) - CENTRE for depth in (fitted, completed, sparse)
    )
    maps = first, second, second - first, np.where(known, measured - second, 0), known
    colours = (image * 2 - 1).transpose(2, 0, 1)
    elevation = ELEVATION_GAIN * _elevation(camera)
    return np.concatenate([colours, np.stack([*maps, elevation])]).astype(np.float32)


def _elevation(camera: Camera) -> np.ndarray:
    """(H, W) sines of the angles by which pixels look up."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.linalg.solve(camera.K, np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1))
    up = camera.world_from_camera[2, :3] @ rays / np.linalg.norm(rays, axis=0)
    return up.reshape(camera.height, camera.width)


def refine(
    refiner: DepthRefiner,
    inputs: np.ndarray,  # [INPUTS, H, W], see `refiner_inputs`
    camera: Camera,
) -> np.ndarray:
    """(H, W) float32 metres: refined depth as far as LiDAR reaches, then ever more the fitted."""
    device = next(refiner.parameters()).device
    with torch.inference_mode():
        refined = refiner(torch.from_numpy(inputs)[None].to(device))[0].cpu().numpy()
    fitted = inputs[FITTED] + CENTRE
    return np.exp(fitted + lidar_reach(inputs[MEASURED] > 0, camera) * (refined - fitted))
