"""Samples along rays against values by hand."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from baselines.emernerf.sampling import (
    FAR,
    NEAR,
    Proposal,
    median_distance,
    proposal_loss,
    propose,
    resample,
    to_distance,
    to_place,
    weigh,
)


def test_places_run_from_near_to_far_and_meet_in_the_middle():
    assert to_distance(torch.tensor([0.0, 1.0])).tolist() == pytest.approx([NEAR, FAR], rel=1e-4)
    distances = to_distance(torch.linspace(0, 1, 1001, dtype=torch.float64))
    steps = distances.diff()
    assert (steps > 0).all()
    # Even in distance first, then in disparity.
    torch.testing.assert_close(steps[:400], steps[:1].expand(400))
    disparity = (1 / distances[600:]).diff()
    torch.testing.assert_close(disparity, disparity[:1].expand(len(disparity)))


@given(st.floats(0.11, 990))
def test_places_and_distances_are_inverse(distance):
    distance = torch.tensor([distance], dtype=torch.float64)
    torch.testing.assert_close(to_distance(to_place(distance)), distance)


def test_what_is_too_near_or_too_far_is_at_the_ends():
    assert to_place(torch.tensor([-1.0, 0.0, 5000.0])).tolist() == [0, 0, 1]


def test_each_sample_stops_its_share_of_what_reaches_it():
    half = math.log(2)  # the density that stops half the light in a metre
    weights = weigh(torch.tensor([[half, half, 2 * half]]), torch.tensor([[0.0, 1, 2, 3]]))
    assert weights[0].tolist() == pytest.approx([1 / 2, 1 / 4, 3 / 16])


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=8))
def test_no_more_light_is_stopped_than_there_is(densities):
    distances = torch.arange(len(densities) + 1.0)[None] + 0.5
    weights = weigh(torch.tensor([densities]), distances)
    assert (weights >= 0).all()
    assert weights.sum() <= 1 + 1e-6


def test_samples_lie_as_the_histogram_says():
    edges = torch.tensor([[0.0, 0.2, 0.4, 1.0]])
    resampled = resample(Proposal(edges, torch.tensor([[0.25, 0.5, 0.25]])), 4)
    assert resampled[0].tolist() == pytest.approx([0, 0.2, 0.3, 0.4, 1])


def test_light_that_nothing_stopped_counts_to_the_last_sample():
    edges = torch.tensor([[0.0, 0.5, 1.0]])
    resampled = resample(Proposal(edges, torch.tensor([[0.5, 0.0]])), 4)
    assert resampled[0].tolist() == pytest.approx([0, 0.25, 0.5, 0.75, 1])


def test_jittered_edges_rise_and_stay_inside():
    generator = torch.Generator().manual_seed(0)
    edges = torch.linspace(0, 1, 9).expand(50, -1)
    weights = torch.rand(50, 8, generator=generator) / 8
    jittered = resample(Proposal(edges, weights), 5, generator)
    assert (jittered.diff(dim=1) >= 0).all()
    assert 0 <= jittered.min() <= jittered.max() <= 1
    assert len(jittered[:, 2].unique()) > 40  # each ray's own


def test_proposals_close_in_on_a_wall():
    def wall(positions):
        return 1e3 * ((positions[:, 0] > 20) & (positions[:, 0] < 22)).float()

    origins, directions = torch.zeros(1, 3), torch.tensor([[1.0, 0, 0]])
    edges, rounds = propose([wall, wall], (128, 64, 8), origins, directions)
    distances = to_distance(edges)[0]
    assert [proposal.weights.shape[1] for proposal in rounds] == [128, 64]
    # The first sample inside stops everything; 128 samples lie 0.79 m apart there.
    assert ((distances[1:-1] > 19) & (distances[1:-1] < 21)).all()


def test_only_weight_that_proposals_miss_is_a_loss():
    edges = torch.tensor([[0.0, 0.5, 1.0]])
    covering = Proposal(edges, torch.tensor([[0.6, 0.4]], requires_grad=True))
    weights = torch.tensor([[0.6, 0.3]])
    assert proposal_loss(edges, weights, [covering]).item() == 0
    missing = Proposal(edges, torch.tensor([[0.2, 0.4]], requires_grad=True))
    loss = proposal_loss(edges, weights, [covering, missing])
    assert loss.item() == pytest.approx((0.6 - 0.2) ** 2 / 0.6, rel=1e-5)
    loss.backward()
    # d/dp (w - p)^2 / w = -2 (w - p) / w
    assert missing.weights.grad[0].tolist() == pytest.approx([-2 * 0.4 / 0.6, 0], rel=1e-5)


def test_a_sample_may_spread_over_several_of_a_proposals():
    fine = Proposal(torch.tensor([[0.0, 0.25, 0.5, 1.0]]), torch.tensor([[0.1, 0.2, 0.3]]))
    edges = torch.tensor([[0.1, 0.6]])  # touches all three, whose sum is 0.6
    loss = proposal_loss(edges, torch.tensor([[0.8]]), [fine])
    assert loss.item() == pytest.approx((0.8 - 0.6) ** 2 / 0.8, rel=1e-5)


def test_the_median_lies_where_half_of_the_light_has_ended():
    distances = torch.tensor([[0.0, 1.0, 3.0, 7.0]]).expand(4, -1)
    weights = torch.tensor(
        [
            [0.2, 0.4, 0.2],  # half of 0.8 after a half of the second sample
            [0.0, 0.0, 1.0],
            [0.1, 0.1, 0.8],  # 0.3 of the last sample's 0.8
            [0.0, 0.0, 0.0],  # nothing ends anywhere
        ]
    )
    found = median_distance(weights, distances)
    torch.testing.assert_close(found[:3], torch.tensor([2.0, 5.0, 4.5]))
    assert found[3].isfinite()
