"""The fine-tuning loss by hand, against a plain twin, and its gradient."""

import math

import numpy as np
import pytest
import torch

from geoevs.geometry.depth_loss import ALPHA, DROPPED, SCALES, depth_loss
from geoevs.geometry.vggt import DepthPrediction


def sample(seed, shape, known=1.0):
    """Predicted depth, confidence and true depth, float64, with a share of pixels known."""
    rng = np.random.default_rng(seed)
    predicted = np.exp(rng.normal(2.5, 0.6, shape))
    confidence = 1 + np.exp(rng.normal(0, 0.7, shape))
    truth = np.exp(rng.normal(2.5, 0.6, shape)) * (rng.random(shape) < known)
    return predicted, confidence, truth


def loss(predicted, confidence, truth):
    predicted, confidence, truth = map(torch.as_tensor, (predicted, confidence, truth))
    return depth_loss(DepthPrediction(predicted, confidence), truth)


def twin(predicted, confidence, truth):
    """The definition, a pixel at a time."""
    errors = {
        place: math.log(predicted[place] / truth[place])
        for place in np.ndindex(truth.shape)
        if truth[place] > 0
    }
    kept = sorted(errors, key=lambda place: abs(errors[place]))
    kept = set(kept[: len(kept) - int(DROPPED * len(kept))])
    weighted = [
        confidence[place] * abs(errors[place]) - ALPHA * math.log(confidence[place])
        for place in kept
    ]
    gradient = 0.0
    for scale in SCALES:
        pairs = [
            ((*place, row, column), (*place, *other))
            for *place, row, column in kept
            for other in ((row + scale, column), (row, column + scale))
        ]
        differences = [abs(errors[one] - errors[two]) for one, two in pairs if two in kept]
        gradient += sum(differences) / max(len(differences), 1) / len(SCALES)
    return sum(weighted) / len(weighted) + gradient


def test_two_pixels_by_hand():
    # Log errors -1 and 0: mean error 1/2 at confidence 1, whose reward is nil, and one difference
    # of 1 at the first of four scales.
    truth = np.array([[[[math.e, 1.0]]]])
    assert loss(np.ones((1, 1, 1, 2)), np.ones((1, 1, 1, 2)), truth) == pytest.approx(0.75)
    confident = loss(np.ones((1, 1, 1, 2)), np.full((1, 1, 1, 2), 3.0), truth)
    assert confident == pytest.approx(1.5 - ALPHA * math.log(3) + 0.25)


@pytest.mark.parametrize("known", [1.0, 0.3, 0.02])
def test_it_equals_its_plain_twin(known):
    arrays = sample(0, (2, 2, 11, 13), known)
    assert loss(*arrays).item() == pytest.approx(twin(*arrays), rel=1e-12)


@pytest.mark.parametrize("known", [1.0, 0.4])
def test_its_gradient_is_right(known):
    predicted, confidence, truth = map(torch.from_numpy, sample(1, (1, 2, 9, 10), known))
    inputs = predicted.requires_grad_(), confidence.requires_grad_()
    assert torch.autograd.gradcheck(lambda *maps: depth_loss(DepthPrediction(*maps), truth), inputs)


def test_the_worst_pixels_do_not_count():
    predicted, confidence, truth = sample(2, (1, 1, 10, 10))
    truth[0, 0, 3, 4] = truth[0, 0, 7, 2] = 1e4  # 2 of 100
    before = loss(predicted, confidence, truth)
    truth[0, 0, 3, 4] = truth[0, 0, 7, 2] = 1e9
    assert loss(predicted, confidence, truth) == before
    truth[0, 0, 5, 5] = 1e9  # a third
    assert loss(predicted, confidence, truth) > before + 0.1


def test_what_is_unknown_has_no_gradient():
    predicted, confidence, truth = map(torch.from_numpy, sample(3, (1, 1, 8, 8), 0.5))
    predicted.requires_grad_()
    depth_loss(DepthPrediction(predicted, confidence), truth).backward()
    assert not predicted.grad[truth == 0].any()
    assert predicted.grad[truth > 0].all()


def test_nothing_known_costs_nothing():
    predicted, confidence, _ = map(torch.from_numpy, sample(4, (1, 1, 8, 8)))
    predicted.requires_grad_()
    value = depth_loss(DepthPrediction(predicted, confidence), torch.zeros_like(predicted))
    value.backward()
    assert value == 0
    assert not predicted.grad.any()


def test_only_ratios_count():
    predicted, confidence, truth = sample(5, (1, 2, 8, 8), 0.7)
    tenfold = loss(10 * predicted, confidence, 10 * truth)
    assert tenfold.item() == pytest.approx(loss(predicted, confidence, truth).item(), rel=1e-12)
