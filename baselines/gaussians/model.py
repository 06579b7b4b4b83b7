"""The Gaussians of a scene as the raw, unbounded parameters that are optimised."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from baselines.gaussians.constants import SH_C0
from geoevs.core.errors import GeoEvsError

INITIAL_OPACITY = 0.1
NEIGHBOURS = 3
LEAST_SPACING = 1e-7
"""Least mean squared distance to neighbours, square metres: points in one place get a size
still."""


@dataclass
class Gaussians:
    """3D Gaussians; the rasterizer takes `means`, `quats`, `scales`, `opacities` and `sh`.

    Args:
        means: (N, 3) centres in the world, metres.
        quats: (N, 4) rotations as w, x, y, z, of any length but zero.
        log_scales: (N, 3) logarithms of the standard deviations along the rotated axes, metres.
        logit_opacities: (N,) before the sigmoid.
        sh0: (N, 1, 3) the constant part of the spherical harmonics.
        sh_rest: (N, K - 1, 3) the others.
    """

    means: Tensor  # [N, 3]
    quats: Tensor  # [N, 4]
    log_scales: Tensor  # [N, 3]
    logit_opacities: Tensor  # [N]
    sh0: Tensor  # [N, 1, 3]
    sh_rest: Tensor  # [N, K - 1, 3]

    def __len__(self) -> int:
        return len(self.means)

    def named_parameters(self) -> Iterator[tuple[str, Tensor]]:
        """Names and parameters, in a fixed order."""
        return ((field.name, getattr(self, field.name)) for field in fields(self))

    @property
    def scales(self) -> Tensor:
        """(N, 3) standard deviations in metres."""
        return self.log_scales.exp()

    @property
    def opacities(self) -> Tensor:
        """(N,) opacities of the centres, in (0, 1)."""
        return self.logit_opacities.sigmoid()

    @property
    def sh(self) -> Tensor:
        """(N, K, 3) coefficients of the spherical harmonics."""
        return torch.cat([self.sh0, self.sh_rest], dim=1)

    def to(self, device: str) -> "Gaussians":
        """A copy elsewhere, without gradients."""
        return Gaussians(**{name: t.detach().to(device) for name, t in self.named_parameters()})

    def select(self, rows: Tensor) -> "Gaussians":  # [M] int64 or [N] bool
        """A copy of some rows, without gradients."""
        return Gaussians(
            **{name: tensor.detach()[rows] for name, tensor in self.named_parameters()}
        )


def gaussians_from_points(
    xyz: np.ndarray,  # [N, 3] metres
    rgb: np.ndarray,  # [N, 3] in [0, 1]
    sh_degree: int,
) -> Gaussians:
    """Round Gaussians at points, as 3DGS starts (Kerbl et al. 2023).

    Their standard deviation is the root mean square distance to the three nearest points, their
    opacity 0.1; their colour is the points', seen from everywhere.

    Args:
        xyz: centres in the world.
        rgb: colours.
        sh_degree: of the spherical harmonics; coefficients beyond the constant one start at 0.

    Returns:
        N Gaussians in float32.

    Raises:
        GeoEvsError: there are fewer than two points, or the two arrays do not pair up.

    >>> square = np.array([[0, 0, 5], [2, 0, 5], [0, 2, 5], [2, 2, 5]])
    >>> gaussians_from_points(square, np.full((4, 3), 0.5), sh_degree=1).scales[0].tolist()
    [2.309..., 2.309..., 2.309...]
    """
    if len(xyz) < 2 or rgb.shape != xyz.shape:
        raise GeoEvsError(
            f"points of shape {xyz.shape} came with colours of shape {rgb.shape}; give at least "
            "two points, and each its colour"
        )
    nearest, _ = cKDTree(xyz).query(xyz, min(len(xyz), NEIGHBOURS + 1))
    squared = np.maximum((nearest[:, 1:] ** 2).mean(axis=1), LEAST_SPACING)  # [:, 0] is itself
    count = len(xyz)
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1.0
    log_scales = torch.from_numpy(0.5 * np.log(squared)).float()
    return Gaussians(
        means=torch.tensor(xyz, dtype=torch.float32),
        quats=quats,
        log_scales=log_scales[:, None].repeat(1, 3),
        logit_opacities=torch.full((count,), math.log(INITIAL_OPACITY / (1 - INITIAL_OPACITY))),
        sh0=(torch.tensor(rgb, dtype=torch.float32)[:, None] - 0.5) / SH_C0,
        sh_rest=torch.zeros(count, (sh_degree + 1) ** 2 - 1, 3),
    )
