"""What all numba kernels have in common."""

import pytest
from numba.core.dispatcher import Dispatcher

from baselines.emernerf import hash_grid_kernels
from baselines.gaussians import binning_kernels, blending_kernels, loss
from baselines.gaussians import projection_kernels as gaussian_projection_kernels
from geoevs import projection_kernels


@pytest.mark.parametrize(
    "kernels",
    [
        *(binning_kernels, blending_kernels, gaussian_projection_kernels, loss),
        *(hash_grid_kernels, projection_kernels),
    ],
)
def test_kernels_may_not_be_rounded_otherwise_when_compiled_again(kernels):
    compiled = [part for part in vars(kernels).values() if isinstance(part, Dispatcher)]
    assert compiled
    assert not any(part.targetoptions.get("fastmath") for part in compiled)
