"""Gaussians and footprints for tests."""

import pytest
import torch

from baselines.gaussians.interface import Footprints
from baselines.gaussians.model import Gaussians


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(0)


@pytest.fixture
def make_gaussians():
    """Gaussians that differ in everything, of given opacities and scale."""

    def make(opacities, scale=0.1):
        count = len(opacities)
        draw = torch.Generator().manual_seed(1)
        return Gaussians(
            means=torch.randn(count, 3, generator=draw),
            quats=torch.randn(count, 4, generator=draw),
            log_scales=torch.log(scale * (1 + torch.rand(count, 3, generator=draw))),
            logit_opacities=torch.tensor(opacities).logit(),
            sh0=torch.randn(count, 1, 3, generator=draw),
            sh_rest=torch.randn(count, 3, 3, generator=draw),
        )

    return make


@pytest.fixture
def footprints_of():
    """Footprints that all show, with gradients of given lengths per pixel along x."""

    def make(lengths):
        gradient = torch.tensor(lengths)[:, None] * torch.tensor([1.0, 0.0])
        return Footprints(torch.full((len(lengths),), 3.0), gradient)

    return make
