import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.conditions.boxes import random_boxes, random_erasing

SIDES = st.integers(8, 80)
SEEDS = st.integers(0, 2**32)


def hidden_share(keep):
    return 1 - keep.mean()


@given(SEEDS, SIDES, SIDES, st.floats(0, 1, exclude_max=True))
def test_any_share_is_met(seed, height, width, hidden):
    keep = random_boxes(np.random.default_rng(seed), height, width, hidden)
    assert keep.shape == (height, width)
    assert keep.dtype == bool
    # At worst an edge moves by its whole row or column, and the nearer side of that counts.
    assert abs(hidden_share(keep) - hidden) <= 0.5 / min(height, width) + 1e-9


@given(SEEDS, st.floats(0, 1, exclude_max=True))
def test_at_the_default_resolution_a_share_is_met_within_a_hundredth(seed, hidden):
    keep = random_boxes(np.random.default_rng(seed), 128, 192, hidden)
    assert abs(hidden_share(keep) - hidden) < 0.01


@given(SEEDS, st.floats(0.01, 0.9))
def test_few_boxes_hide_few_rectangles(seed, hidden):
    """A union of at most four boxes has at most 9 different rows, and as many columns."""
    keep = random_boxes(np.random.default_rng(seed), 64, 96, hidden)
    for lines in (keep, keep.T):
        assert len({line.tobytes() for line in lines}) <= 9


def test_nothing_and_everything():
    rng = np.random.default_rng(0)
    assert random_boxes(rng, 20, 30, 0.0).all()
    assert not random_boxes(rng, 20, 30, 1.0).any()


def test_boxes_lie_everywhere():
    rng = np.random.default_rng(0)
    hidden = 1 - np.mean([random_boxes(rng, 16, 24, 0.2) for _ in range(1500)], axis=0)
    assert hidden.mean() == pytest.approx(0.2, abs=0.005)
    assert hidden.min() > 0.05
    for flipped in (hidden[::-1], hidden[:, ::-1]):
        # Five standard errors of the difference of two means of 1500 coin flips.
        assert np.abs(hidden - flipped).max() < 5 * np.sqrt(2 * 0.2 * 0.8 / 1500)


@given(SEEDS, SIDES, SIDES)
def test_erasing_hides_what_random_erasing_may(seed, height, width):
    keep = random_erasing(np.random.default_rng(seed), height, width)
    assert keep.shape == (height, width)
    assert keep.dtype == bool
    # Four boxes of a fifth at most, their edges rounded outwards by half a pixel at worst.
    assert hidden_share(keep) <= 4 * 0.2 + 4 * (height + width + 1) / (height * width)


def test_single_erasures_have_the_areas_and_aspects_of_the_paper():
    rng = np.random.default_rng(0)
    areas, aspects = [], []
    for _ in range(2000):
        rows, columns = np.nonzero(~random_erasing(rng, 300, 300))
        height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
        if height * width == len(rows):  # one box, or the others within it
            areas.append(len(rows) / 300**2)
            aspects.append(np.log(height / width))
    assert len(areas) > 400
    assert 0.018 < min(areas) < 0.025
    assert 0.195 < max(areas) < 0.205
    assert np.mean(areas) == pytest.approx(0.11, abs=0.01)
    assert np.mean(aspects) == pytest.approx(0, abs=0.1)
    assert max(np.abs(aspects)) == pytest.approx(np.log(1 / 0.3), abs=0.1)


@pytest.mark.parametrize(
    "draw", [lambda r: random_boxes(r, 32, 48, 0.3), lambda r: random_erasing(r, 32, 48)]
)
def test_the_same_generator_draws_the_same_boxes(draw):
    first, again, other = (draw(np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
