"""Depth metrics by hand."""

import numpy as np
import pytest

from geoevs.geometry.depth_metrics import depth_metrics

PREDS = np.array([[10.0, 8.0], [24.0, 3.0]], np.float32)
TARGET = np.array([[10.0, 10.0], [20.0, 0.0]], np.float32)


def test_by_hand():
    scores = depth_metrics(PREDS, TARGET, TARGET > 0)
    assert scores["abs_rel"] == pytest.approx((0 + 0.2 + 0.2) / 3)
    assert scores["rmse"] == pytest.approx(np.sqrt((0 + 4 + 16) / 3))
    assert scores["delta_1.25"] == pytest.approx(2 / 3)  # 10 is just 1.25 times 8


def test_an_empty_mask_gives_no_number():
    assert np.isnan(list(depth_metrics(PREDS, TARGET, TARGET > 99).values())).all()
