"""Losses, their weights and their schedules against values by hand."""

import math
from types import SimpleNamespace

import pytest
import torch

from baselines.emernerf import losses
from baselines.emernerf.losses import image_losses, lidar_losses, line_of_sight
from baselines.emernerf.model import Motion, Rendered
from baselines.emernerf.sampling import Proposal, to_distance


def seen(rgb=None, depth=None, motion=None):
    """Two rays of two samples; a proposal misses 0.4 of the first sample's 0.6 in one of them."""
    edges = torch.tensor([[0.0, 0.5, 1.0]]).repeat(2, 1)
    weights = torch.tensor([[0.6, 0.3], [0.2, 0.3]])
    proposal = Proposal(edges, torch.tensor([[0.2, 0.4], [0.2, 0.4]]))
    return Rendered(rgb, depth, weights.sum(1), weights, edges, [proposal], motion)


MISSED = 0.4**2 / 0.6 / 2  # the mean of two rays


def rendering(what):
    """A model that has one thing to show, whose flow's cycle loss is 2."""
    return SimpleNamespace(render=lambda *_: what, cycle=lambda *_: torch.tensor(2.0))


def of_images(motion, done):
    what = seen(torch.tensor([[0.5, 0.5, 0.5], [0.2, 0.2, 0.2]]), motion=motion)
    rgb, sky = torch.tensor([[0.3, 0.5, 0.1], [0.2, 0.2, 0.2]]), torch.tensor([True, False])
    found, errors = image_losses(rendering(what), None, rgb, sky, done, None)
    assert errors.tolist() == pytest.approx([(0.04 + 0.16) / 3, 0])
    return {name: value.item() for name, value in found.items()}


ALWAYS = {
    "rgb": 0.2 / 3 / 2,
    "sky": -0.001 * (math.log(1 - 0.9) + math.log(0.5)) / 2,
    "proposal": MISSED,
}


def test_losses_of_a_static_scenes_pixels():
    assert of_images(None, 0.5) == pytest.approx(ALWAYS, rel=1e-5)


@pytest.mark.parametrize(("done", "dynamic"), [(0.0, 0), (0.29, 0), (0.3, 0.03), (1.0, 0.03)])
def test_dynamic_density_is_free_at_first(done, dynamic):
    motion = Motion(
        densities=torch.tensor([[0.0, 8.0], [4.0, 0.0]]),
        share=None,
        flow=None,
        shadow=torch.tensor([0.25, 0.75]),
    )
    added = {"dynamic": dynamic, "shadow": 0.005, "cycle": 0.02}
    assert of_images(motion, done) == pytest.approx(ALWAYS | added, rel=1e-5)


def of_lidar(done):
    what = seen(depth=torch.tensor([20.0, 60.0]))
    found = lidar_losses(rendering(what), None, torch.tensor([24.0, 81.0]), done, None)
    return {name: value.item() for name, value in found.items()}


@pytest.mark.parametrize(
    ("done", "margin", "sight"),
    [
        (0.0, None, None),
        (0.08, None, None),
        (0.0801, 3.0, 0.1),
        (0.31, 2.5, 0.05),
        (0.54, 2.0, 0.025),
        (1.0, 1.0, 0.1 / 2**4),
    ],
)
def test_line_of_sight_starts_late_then_narrows_and_fades(monkeypatch, done, margin, sight):
    margins = []
    monkeypatch.setattr(
        losses, "line_of_sight", lambda *args: margins.append(args[2]) or torch.tensor(1.0)
    )
    # The second point is beyond 80 m: 4 m of 80 is the first one's error, and the mean's.
    expected = {"depth": (4 / 80) ** 2, "lidar proposal": MISSED}
    expected |= {} if sight is None else {"sight": sight}
    assert of_lidar(done) == pytest.approx(expected, rel=1e-4)
    assert margins == ([] if margin is None else [pytest.approx(margin, rel=1e-3)])


def test_depths_are_cut_at_80_metres():
    what = seen(depth=torch.tensor([20.0, 500.0]))
    found = lidar_losses(rendering(what), None, torch.tensor([20.0, 72.0]), 0.0, None)
    assert found["depth"].item() == pytest.approx((8 / 80) ** 2 / 2, rel=1e-4)


def test_light_that_ends_as_a_normal_distribution_has_no_sight_loss():
    places = torch.linspace(0.05, 0.5, 200)[None]
    distances = to_distance(places)
    normal = torch.distributions.Normal(30.0, 2.0 / 3)
    weights = normal.cdf(distances).diff(dim=1)

    def loss(weights):
        rendered = Rendered(None, None, None, weights, places, [], None)
        return line_of_sight(rendered, torch.tensor([30.0]), 2.0).item()

    assert loss(weights) < 1e-5
    before = weights.clone()
    middles = (distances[0, 1:] + distances[0, :-1]) / 2
    before[0, int((middles - 20).abs().argmin())] += 0.5  # 10 m before the point
    assert loss(before) == pytest.approx(0.25, rel=1e-4)
    behind = weights.clone()
    behind[0, int((middles - 40).abs().argmin())] += 0.5  # nobody knows what is behind it
    assert loss(behind) < 1e-5
