"""Adam with changing rows, against Adam written out in NumPy."""

import numpy as np
import pytest
import torch

from baselines.gaussians.optimiser import LEARNING_RATES, Optimiser
from geoevs.core.errors import GeoEvsError

STEPS, EXTENT = 10, 5.0
OPACITIES = [0.2, 0.4, 0.6, 0.8]


class NumpyAdam:
    """Kingma and Ba 2015, in float64, of one array."""

    def __init__(self, value, rate):
        self.value, self.rate, self.count = value.astype(float), rate, 0
        self.first, self.second = np.zeros_like(self.value), np.zeros_like(self.value)

    def step(self, gradient):
        self.count += 1
        self.first = 0.9 * self.first + 0.1 * gradient
        self.second = 0.999 * self.second + 0.001 * gradient**2
        first = self.first / (1 - 0.9**self.count)
        second = self.second / (1 - 0.999**self.count)
        self.value = self.value - self.rate(self.count - 1) * first / (np.sqrt(second) + 1e-15)

    def change(self, rows, new):
        self.value = np.concatenate([self.value[rows], new])
        for moment in ("first", "second"):
            kept = getattr(self, moment)[rows]
            setattr(self, moment, np.concatenate([kept, np.zeros_like(new, dtype=float)]))


def rate_of(name):
    if name == "means":  # falls a hundredfold in the training
        return lambda step: 1.6e-4 * EXTENT * 0.01 ** (step / STEPS)
    return lambda step: LEARNING_RATES[name]


def twins_of(gaussians):
    return {
        name: NumpyAdam(t.detach().numpy(), rate_of(name))
        for name, t in gaussians.named_parameters()
    }


def step_both(optimiser, twins, step):
    rng = np.random.default_rng(step)
    for name, tensor in optimiser.gaussians.named_parameters():
        gradient = rng.standard_normal(tensor.shape)
        tensor.grad = torch.from_numpy(gradient).float()
        twins[name].step(gradient)
    optimiser.step(step)


def assert_equal(optimiser, twins):
    for name, tensor in optimiser.gaussians.named_parameters():
        # Steps are about a learning rate long.
        tolerance = 1e-3 * LEARNING_RATES[name]
        np.testing.assert_allclose(
            tensor.detach(), twins[name].value, rtol=3e-7, atol=tolerance, err_msg=name
        )


def test_it_is_adam_with_the_published_rates(make_gaussians):
    optimiser = Optimiser(make_gaussians(OPACITIES), STEPS, EXTENT)
    twins = twins_of(optimiser.gaussians)
    for step in range(4):
        step_both(optimiser, twins, step)
    assert_equal(optimiser, twins)
    assert all(tensor.grad is None for _, tensor in optimiser.gaussians.named_parameters())


@pytest.mark.parametrize("rows", [[2, 0], [True, False, False, True]])
@pytest.mark.parametrize("steps_before", [0, 3])
def test_moments_stay_with_their_rows(make_gaussians, rows, steps_before):
    optimiser = Optimiser(make_gaussians(OPACITIES), STEPS, EXTENT)
    twins = twins_of(optimiser.gaussians)
    for step in range(steps_before):
        step_both(optimiser, twins, step)
    new = make_gaussians([0.3, 0.5, 0.7])
    optimiser.keep(torch.tensor(rows))
    optimiser.append(new)
    for name, twin in twins.items():
        twin.change(rows, getattr(new, name).numpy())
    for step in range(steps_before, steps_before + 3):
        step_both(optimiser, twins, step)
    assert len(optimiser.gaussians) == 5
    assert_equal(optimiser, twins)


def test_moments_can_be_forgotten(make_gaussians):
    optimiser = Optimiser(make_gaussians(OPACITIES), STEPS, EXTENT)
    twins = twins_of(optimiser.gaussians)
    step_both(optimiser, twins, 0)
    optimiser.forget(torch.tensor([1]))
    optimiser.forget(torch.tensor([2]), "quats")
    for name, twin in twins.items():
        rows = [1, 2] if name == "quats" else [1]
        twin.first[rows] = twin.second[rows] = 0
    for step in (1, 2):
        step_both(optimiser, twins, step)
    assert_equal(optimiser, twins)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_a_broken_gradient_is_named(make_gaussians, bad):
    optimiser = Optimiser(make_gaussians(OPACITIES), STEPS, EXTENT)
    step_both(optimiser, twins_of(optimiser.gaussians), 0)
    before = {
        name: tensor.detach().clone() for name, tensor in optimiser.gaussians.named_parameters()
    }
    for _, tensor in optimiser.gaussians.named_parameters():
        tensor.grad = torch.ones_like(tensor)
    optimiser.gaussians.log_scales.grad[2, 1] = bad
    with pytest.raises(GeoEvsError, match="of log_scales of cars is not finite at step 7;"):
        optimiser.check(7, " of cars")
    for name, tensor in optimiser.gaussians.named_parameters():
        assert torch.equal(tensor, before[name]), name


def test_a_parameter_that_the_picture_does_not_need_stays(make_gaussians):
    optimiser = Optimiser(make_gaussians(OPACITIES), STEPS, EXTENT)
    before = optimiser.gaussians.sh_rest.detach().clone()
    optimiser.gaussians.sh0.sum().backward()
    optimiser.step(0)
    assert torch.equal(optimiser.gaussians.sh_rest, before)


def test_none_left_is_refused(make_gaussians):
    optimiser = Optimiser(make_gaussians(OPACITIES), STEPS, EXTENT)
    with pytest.raises(GeoEvsError, match="no Gaussian is left after pruning"):
        optimiser.keep(torch.zeros(4, dtype=torch.bool))
    assert len(optimiser.gaussians) == 4
