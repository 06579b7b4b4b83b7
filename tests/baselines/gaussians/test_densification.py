"""Strategies against the published rules, with footprints made up for the purpose."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from baselines.gaussians.densification import (
    GradientStrategy,
    MCMCStrategy,
    Schedule,
    add_noise,
    shared_opacities,
    split,
)
from baselines.gaussians.interface import Footprints
from baselines.gaussians.optimiser import Optimiser
from baselines.gaussians.rotations import rotation_matrices
from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera

# A half side is 50 pixels, so that a gradient of 1 a pixel is 50 as strategies count.
CAMERA = Camera([[100, 0, 50], [0, 100, 50], [0, 0, 1]], np.eye(4), 100, 100)
EVERY = Schedule(start=0, stop=100, every=1)
STEEP, FLAT = 3e-4 / 50, 1e-4 / 50


def optimiser_of(gaussians, extent=1000.0):
    """After a step, so that no moment is zero; all are small by this extent, and large by 1."""
    optimiser = Optimiser(gaussians, steps=100, extent=extent)
    for _, tensor in gaussians.named_parameters():
        tensor.grad = torch.ones_like(tensor)
    optimiser.step(0)
    return optimiser


def moments(optimiser, name="means"):
    return optimiser._adam.state[getattr(optimiser.gaussians, name)]["exp_avg"]


def rows(gaussians):
    """(N, 23) everything about each Gaussian."""
    columns = [t.detach().reshape(len(gaussians), -1) for _, t in gaussians.named_parameters()]
    return torch.cat(columns, dim=1)


def test_steep_small_gaussians_are_cloned(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5, 0.6, 0.7]))
    before = rows(optimiser.gaussians)
    strategy = GradientStrategy(cap=10, schedule=EVERY)
    strategy.update(1, optimiser, footprints_of([FLAT, STEEP, FLAT]), CAMERA, generator)
    assert torch.equal(rows(optimiser.gaussians), before[[0, 1, 2, 1]])
    np.testing.assert_array_equal(moments(optimiser)[:, 0] > 0, [True, True, True, False])


def test_steep_large_gaussians_are_split(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5, 0.6, 0.7]), extent=1.0)
    before = rows(optimiser.gaussians)
    parent = optimiser.gaussians.select(torch.tensor([1, 1]))
    strategy = GradientStrategy(cap=10, schedule=EVERY)
    strategy.update(1, optimiser, footprints_of([FLAT, STEEP, FLAT]), CAMERA, generator)
    after = optimiser.gaussians
    assert torch.equal(rows(after)[:2], before[[0, 2]])
    parts = after.select(torch.tensor([2, 3]))
    np.testing.assert_allclose(parts.scales, parent.scales / 1.6, rtol=1e-6)
    for name in ("quats", "logit_opacities", "sh0", "sh_rest"):
        assert torch.equal(getattr(parts, name), getattr(parent, name)), name
    assert not torch.equal(parts.means[0], parts.means[1])
    np.testing.assert_array_equal(moments(optimiser)[:, 0] > 0, [True, True, False, False])


def test_all_may_be_split(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5, 0.6]), extent=1.0)
    strategy = GradientStrategy(cap=10, schedule=EVERY)
    strategy.update(1, optimiser, footprints_of([STEEP, STEEP]), CAMERA, generator)
    assert len(optimiser.gaussians) == 4


def test_parts_of_a_split_are_spread_as_their_parent(make_gaussians, generator):
    parent = make_gaussians([0.5])
    many = parent.select(torch.zeros(20_000, dtype=torch.int64))
    spread = torch.cov((split(many, generator).means - parent.means).T)
    root = rotation_matrices(parent.quats)[0] * parent.scales[0]
    np.testing.assert_allclose(spread, root @ root.T, atol=0.03 * float(parent.scales.max()) ** 2)


def test_gradients_are_averaged_over_the_views_that_show(make_gaussians, generator):
    # All have the same sum, but the first is shown in one view of two: only its mean is steep. The
    # third is not shown in the first view, and what is noted of it there is no matter.
    optimiser = optimiser_of(make_gaussians([0.5] * 3))
    strategy = GradientStrategy(cap=10, schedule=Schedule(start=1, stop=100, every=1))
    first = Footprints(
        torch.tensor([1.0, 1.0, 0.0]), torch.tensor([[0, STEEP], [0, STEEP / 2], [9.0, 9.0]])
    )
    second = Footprints(
        torch.tensor([0.0, 1.0, 1.0]), torch.tensor([[0.0, 0.0], [STEEP / 2, 0], [FLAT, 0]])
    )
    strategy.update(1, optimiser, first, CAMERA, generator)
    assert len(optimiser.gaussians) == 3
    strategy.update(2, optimiser, second, CAMERA, generator)
    assert len(optimiser.gaussians) == 4
    assert torch.equal(optimiser.gaussians.means[3], optimiser.gaussians.means[0])


def test_means_start_over_after_growth(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5, 0.5]))
    strategy = GradientStrategy(cap=10, schedule=EVERY)
    strategy.update(1, optimiser, footprints_of([FLAT, FLAT]), CAMERA, generator)
    assert len(optimiser.gaussians) == 2
    # Steep by itself, but not on the average with the step before.
    gradients = footprints_of([2.5e-4 / 50, FLAT])
    strategy.update(2, optimiser, gradients, CAMERA, generator)
    assert len(optimiser.gaussians) == 3


def test_gradients_count_by_the_side_they_are_along(make_gaussians, generator):
    # In a picture four times as wide, the same gradient a pixel is four times as steep along x.
    wide = Camera([[100, 0, 200], [0, 100, 50], [0, 0, 1]], np.eye(4), 100, 400)
    optimiser = optimiser_of(make_gaussians([0.5, 0.5]))
    gradient = torch.tensor([[FLAT, 0.0], [0.0, FLAT]])
    strategy = GradientStrategy(cap=10, schedule=EVERY)
    strategy.update(1, optimiser, Footprints(torch.ones(2), gradient), wide, generator)
    assert len(optimiser.gaussians) == 3
    assert torch.equal(optimiser.gaussians.means[2], optimiser.gaussians.means[0])


def test_the_cap_leaves_the_steepest_to_grow(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5] * 4))
    before = rows(optimiser.gaussians)
    strategy = GradientStrategy(cap=6, schedule=EVERY)
    lengths = [2 * STEEP, STEEP, 4 * STEEP, 3 * STEEP]
    strategy.update(1, optimiser, footprints_of(lengths), CAMERA, generator)
    assert torch.equal(rows(optimiser.gaussians), before[[0, 1, 2, 3, 2, 3]])
    strategy.update(2, optimiser, footprints_of([STEEP] * 6), CAMERA, generator)
    assert len(optimiser.gaussians) == 6


def test_transparent_gaussians_are_pruned(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5, 0.003, 0.02]))
    strategy = GradientStrategy(cap=10, schedule=EVERY)
    strategy.update(1, optimiser, footprints_of([FLAT] * 3), CAMERA, generator)
    assert len(optimiser.gaussians) == 2
    assert optimiser.gaussians.opacities.min() > 0.005


def test_none_left_after_pruning_says_so(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.003, 0.001]))
    strategy = GradientStrategy(cap=10, schedule=EVERY)
    with pytest.raises(GeoEvsError, match="no Gaussian is left after pruning"):
        strategy.update(1, optimiser, footprints_of([FLAT] * 2), CAMERA, generator)


def test_a_view_of_nothing_counts_for_nothing(make_gaussians, generator):
    optimiser = optimiser_of(make_gaussians([0.5, 0.5]))
    before = rows(optimiser.gaussians)
    strategy = GradientStrategy(cap=10, schedule=EVERY)
    strategy.update(1, optimiser, Footprints(torch.zeros(2)), CAMERA, generator)
    assert torch.equal(rows(optimiser.gaussians), before)


def test_others_may_prune_in_between(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5] * 3))
    strategy = GradientStrategy(cap=10, schedule=Schedule(start=1, stop=100, every=1))
    strategy.update(1, optimiser, footprints_of([STEEP, FLAT, STEEP]), CAMERA, generator)
    optimiser.keep(torch.tensor([1, 2]))
    strategy.update(2, optimiser, footprints_of([FLAT, STEEP]), CAMERA, generator)
    assert len(optimiser.gaussians) == 3


def test_nothing_happens_outside_the_schedule(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5, 0.5]))
    strategy = GradientStrategy(cap=10, schedule=Schedule(start=3, stop=9, every=4), reset_every=99)
    counts = []
    for step in range(1, 14):
        lengths = [STEEP] * len(optimiser.gaussians)
        strategy.update(step, optimiser, footprints_of(lengths), CAMERA, generator)
        counts.append(len(optimiser.gaussians))
    # Steps 4 and 8 are multiples of four after the start and before the stop.
    assert counts == [2] * 3 + [4] * 4 + [8] * 6


def test_opacities_are_reset(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5, 0.007]))
    never = Schedule(start=50, stop=100, every=1)
    strategy = GradientStrategy(cap=10, schedule=never, reset_every=7)
    before = optimiser.gaussians.opacities.detach()
    for step in range(7):
        strategy.update(step, optimiser, footprints_of([FLAT] * 2), CAMERA, generator)
    assert torch.equal(optimiser.gaussians.opacities.detach(), before)
    strategy.update(7, optimiser, footprints_of([FLAT] * 2), CAMERA, generator)
    after = optimiser.gaussians.opacities
    np.testing.assert_allclose(after.detach(), [0.01, before[1].item()], rtol=1e-5)
    assert not moments(optimiser, "logit_opacities").any()
    assert moments(optimiser, "means").all()
    after.sum().backward()
    assert optimiser.gaussians.logit_opacities.grad.all()  # they go on learning


@given(opacity=st.floats(0.01, 0.999), copies=st.integers(1, 51))
def test_copies_look_like_their_original(opacity, copies):
    one = torch.tensor([opacity], dtype=torch.float64)
    shared, factor = (value.item() for value in shared_opacities(one, torch.tensor([copies])))
    exact = 1 - (1 - opacity) ** (1 / copies)
    assert shared == pytest.approx(max(exact, 0.005), rel=1e-9)
    # They cover as much: the integral of what all copies hide along a line through the centre.
    hidden, _ = quad(lambda x: 1 - (1 - exact * np.exp(-0.5 * x**2)) ** copies, -12, 12)
    assert factor * hidden == pytest.approx(opacity * np.sqrt(2 * np.pi), rel=1e-6)


def test_dead_gaussians_become_copies(make_gaussians, footprints_of, generator):
    # Only the second can be drawn: two dead ones and it are three copies in the end.
    optimiser = optimiser_of(make_gaussians([0.001, 0.6, 0.002]))
    original = optimiser.gaussians.select(torch.tensor([1]))
    strategy = MCMCStrategy(cap=3, schedule=EVERY)
    strategy.update(1, optimiser, footprints_of([FLAT] * 3), CAMERA, generator)
    after = optimiser.gaussians
    opacities = 1 - (1 - original.opacities) ** (1 / 3)
    np.testing.assert_allclose(after.opacities.detach(), opacities.expand(3), rtol=1e-5)
    _, factor = shared_opacities(original.opacities, torch.tensor([3]))
    np.testing.assert_allclose(after.scales.detach(), (factor * original.scales).expand(3, 3), 1e-5)
    for name in ("quats", "sh0", "sh_rest"):
        expected = getattr(original, name)
        assert torch.equal(getattr(after, name), expected.expand(3, *expected.shape[1:])), name
    # Too opaque for noise, even with steps as long as this extent's.
    np.testing.assert_allclose(after.means.detach(), original.means.expand(3, 3), atol=1e-3)
    assert not moments(optimiser).any()


def test_mcmc_grows_to_its_cap_by_twentieths(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5] * 40))
    strategy = MCMCStrategy(cap=45, schedule=EVERY)
    counts = []
    for step in range(1, 6):
        lengths = [FLAT] * len(optimiser.gaussians)
        strategy.update(step, optimiser, footprints_of(lengths), CAMERA, generator)
        counts.append(len(optimiser.gaussians))
    assert counts == [42, 44, 45, 45, 45]  # int(1.05 * 42) = 44, int(1.05 * 44) = 46


def test_copies_and_their_originals_have_no_moments(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.5] * 40))
    strategy = MCMCStrategy(cap=42, schedule=EVERY)
    strategy.update(1, optimiser, footprints_of([FLAT] * 40), CAMERA, generator)
    sh0 = optimiser.gaussians.sh0.detach()[:, 0]
    copied = (sh0[:, None] == sh0[40:]).all(dim=2).any(dim=1)  # the copies too
    assert copied.sum() in (3, 4)
    assert torch.equal(moments(optimiser)[:, 0] == 0, copied)


def test_mcmc_survives_when_all_are_dead(make_gaussians, footprints_of, generator):
    optimiser = optimiser_of(make_gaussians([0.001, 0.002]))
    strategy = MCMCStrategy(cap=2, schedule=EVERY)
    strategy.update(1, optimiser, footprints_of([FLAT] * 2), CAMERA, generator)
    assert len(optimiser.gaussians) == 2


def test_noise_moves_transparent_gaussians_within_their_shape(make_gaussians, generator):
    gaussians = make_gaussians([0.001])
    many, opaque = (gaussians.select(torch.zeros(20_000, dtype=torch.int64)) for _ in range(2))
    opaque.logit_opacities[:] = torch.tensor(0.2).logit()
    for some in (many, opaque):
        some.means[:] = 0
        add_noise(some, 3.0, generator)
    gate = 1 / (1 + np.exp(-100 * (1 - 0.001 - 0.995)))
    rotation = rotation_matrices(gaussians.quats)[0]
    covariance = (rotation * gaussians.scales[0] ** 2) @ rotation.T
    expected = (3 * gate) ** 2 * covariance @ covariance
    np.testing.assert_allclose(torch.cov(many.means.T), expected, atol=0.03 * float(expected.max()))
    assert opaque.means.abs().max() < 1e-6 * many.means.abs().max()


def test_mcmc_prefers_few_and_small(make_gaussians):
    gaussians = make_gaussians([0.2, 0.4])
    mean = 0.3 + gaussians.scales.mean().item()
    assert MCMCStrategy(cap=2).penalty(gaussians).item() == pytest.approx(0.01 * mean)


@pytest.mark.parametrize("strategy", [GradientStrategy, MCMCStrategy])
def test_the_generator_decides(make_gaussians, footprints_of, strategy):
    def grown(seed):
        optimiser = optimiser_of(make_gaussians([0.003, 0.2, 0.5, 0.7] * 10), extent=1.0)
        chance = torch.Generator().manual_seed(seed)
        footprints = footprints_of([STEEP] * 40)
        strategy(cap=60, schedule=EVERY).update(1, optimiser, footprints, CAMERA, chance)
        return rows(optimiser.gaussians)

    torch.manual_seed(0)
    first = grown(0)
    torch.manual_seed(1)  # the global generator has no say
    assert torch.equal(grown(0), first)
    assert not torch.equal(grown(1), first)
