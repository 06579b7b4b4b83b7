"""Tracks as boxes in space and in views, and the losses, by hand."""

import math

import numpy as np
import pytest
import torch

from baselines.street_gaussians.actors import Track, outside_all
from baselines.street_gaussians.losses import depth_loss, entropy_loss, sky_loss
from geoevs.methods.tiny import tiny_camera
from geoevs.scenes.boxes import Box

# Turned a quarter to the left: its length lies along y.
TRACK = Track(
    "car", {3: Box(3, "car", "car", 10.0, 0.0, 1.0, 4.0, 2.0, 2.0, yaw=90.0, moving=True)}
)


def test_a_box_holds_what_is_in_it_above_the_road():
    points = np.array([[10, 1.9, 1], [10, 2.1, 1], [10.9, 0, 1], [11.1, 0, 1], [10, 0, 0.05]])
    assert TRACK.holds(points, 3).tolist() == [True, False, True, False, False]
    assert outside_all(points, [TRACK]).tolist() == [False, True, False, True, True]


def test_a_box_shows_as_its_outline():
    # Its front, 9 m away, is 4 m wide and 2 m high about the optical axis.
    shown = TRACK.shown(tiny_camera("front", 0.0, np.array([0, 0, 1.0])), 3)
    rows, columns = np.nonzero(shown)
    half = 70 / 9
    assert (columns.min(), columns.max()) == pytest.approx((36 - 2 * half, 36 + 2 * half), abs=1)
    assert (rows.min(), rows.max()) == pytest.approx((24 - half, 24 + half), abs=1)
    assert shown[24, 36]
    assert not TRACK.shown(tiny_camera("front", 0.0, np.zeros(3)), 4).any()
    assert not TRACK.shown(tiny_camera("back", 180.0, np.zeros(3)), 3).any()
    assert TRACK.shown(tiny_camera("front", 0.0, np.array([10.0, 0, 1])), 3).any()  # from within


def test_the_largest_depth_errors_do_not_teach():
    depths = torch.arange(40.0, requires_grad=True)
    measured = torch.arange(40.0) + 1.0
    measured[7], measured[30] = 99.0, 0.0
    loss = depth_loss(depths, measured)
    assert loss.item() == 1.0
    loss.backward()
    assert depths.grad[[7, 30]].tolist() == [0, 0]
    assert depth_loss(depths[:1], measured[:1]).item() == 0


def test_sky_is_clear_and_what_lidar_met_is_solid():
    opacity = torch.tensor([[0.2, 0.2, 0.2, 0.2]])
    sky = torch.tensor([[True, False, False, True]])
    measured = torch.tensor([[False, True, False, True]])
    expected = -(math.log(0.8) + 2 * math.log(0.2)) / 4
    assert sky_loss(opacity, sky, measured).item() == pytest.approx(expected)


def test_boxes_are_solid_or_empty_and_nothing_is_outside_them():
    opacity, boxes = torch.tensor([[0.3, 0.3]]), torch.tensor([[True, False]])
    entropy = -(0.3 * math.log(0.3) + 0.7 * math.log(0.7))
    expected = (entropy - math.log(0.7)) / 2
    assert entropy_loss(opacity, boxes).item() == pytest.approx(expected)
    for extreme in (0.0, 1.0):
        assert torch.isfinite(entropy_loss(torch.full((2, 2), extreme), torch.ones(2, 2) > 0))
