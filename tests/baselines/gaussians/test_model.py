"""Gaussians from points, against distances derived by hand."""

import numpy as np
import pytest
import torch

from baselines.gaussians.constants import SH_C0
from baselines.gaussians.model import gaussians_from_points
from geoevs.core.errors import GeoEvsError


def test_gaussians_start_as_published():
    # A line at 0, 1, 3, 7 and 100: the root mean squares of the three nearest distances.
    x = np.array([0.0, 1.0, 3.0, 7.0, 100.0])
    xyz = np.stack([x, 0 * x, 0 * x], axis=1)
    squares = [1 + 9 + 49, 1 + 4 + 36, 9 + 4 + 16, 49 + 36 + 16, 93**2 + 97**2 + 99**2]
    rgb = np.linspace(0, 1, 15).reshape(5, 3)
    gaussians = gaussians_from_points(xyz, rgb, sh_degree=1)
    assert {name: tuple(tensor.shape) for name, tensor in gaussians.named_parameters()} == {
        "means": (5, 3),
        "quats": (5, 4),
        "log_scales": (5, 3),
        "logit_opacities": (5,),
        "sh0": (5, 1, 3),
        "sh_rest": (5, 3, 3),
    }
    assert all(tensor.dtype == torch.float32 for _, tensor in gaussians.named_parameters())
    np.testing.assert_allclose(gaussians.means, xyz)
    expected = np.sqrt(np.array(squares) / 3)
    np.testing.assert_allclose(gaussians.scales, np.stack([expected] * 3, axis=1), rtol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, 0.1, rtol=1e-6)
    np.testing.assert_array_equal(gaussians.quats, [[1, 0, 0, 0]] * 5)
    np.testing.assert_allclose(0.5 + SH_C0 * gaussians.sh[:, 0], rgb, atol=1e-6)
    assert not gaussians.sh[:, 1:].any()


def test_degree_zero_has_one_coefficient():
    gaussians = gaussians_from_points(np.eye(3), np.eye(3), sh_degree=0)
    assert gaussians.sh.shape == (3, 1, 3)


def test_points_in_one_place_have_a_size():
    gaussians = gaussians_from_points(np.ones((5, 3)), np.ones((5, 3)), sh_degree=0)
    np.testing.assert_allclose(gaussians.scales, np.sqrt(1e-7), rtol=1e-5)


def test_two_points_have_one_neighbour():
    gaussians = gaussians_from_points(np.array([[0, 0, 0], [0, 0, 2.0]]), np.ones((2, 3)), 0)
    np.testing.assert_allclose(gaussians.scales, 2.0, rtol=1e-6)


@pytest.mark.parametrize(("points", "colours"), [((1, 3), (1, 3)), ((4, 3), (3, 3))])
def test_points_without_neighbours_or_colours_are_refused(points, colours):
    with pytest.raises(GeoEvsError, match="give at least two points"):
        gaussians_from_points(np.zeros(points), np.zeros(colours), sh_degree=0)


def test_a_selection_is_a_copy():
    gaussians = gaussians_from_points(np.eye(3), np.eye(3), sh_degree=0)
    gaussians.means.requires_grad_()
    for rows in (torch.tensor([2, 0]), torch.tensor([True, False, True])):
        chosen = gaussians.select(rows)
        np.testing.assert_array_equal(chosen.means, gaussians.means.detach()[rows])
        assert not chosen.means.requires_grad
        chosen.means += 1
    np.testing.assert_array_equal(gaussians.means.detach(), np.eye(3))
