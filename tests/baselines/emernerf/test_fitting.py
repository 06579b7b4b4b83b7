"""The schedule of the fit, by hand."""

import pytest

from baselines.emernerf.fitting import Fitting


@pytest.mark.parametrize(
    ("done", "share"),
    [
        (0, 0.01),
        (0.05, 0.505),
        (0.1, 1),
        (0.49, 1),
        (0.5, 0.33),
        (0.75, 0.33**2),
        (0.9, 0.33**3),
        (1, 0.33**3),
    ],
)
def test_the_learning_rate_rises_then_falls_three_times(done, share):
    rate = Fitting(iterations=100, rays=8, learning_rate=0.02).learning_rate_at(done)
    assert rate == pytest.approx(0.02 * share)
