import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.generator.support import keep_support, push_pull


@st.composite
def scattered(draw):
    """Values, some of them known: odd sizes and single rows, columns, pixels and channels too."""
    shape = draw(st.tuples(*3 * [st.integers(1, 19)]))
    shape = shape[0], shape[1], min(shape[2], 3)
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    known = rng.random(shape[:2]) < draw(st.sampled_from([0.02, 0.3, 0.9]))
    known.flat[draw(st.integers(0, known.size - 1))] = True
    return rng.uniform(-1, 1, shape).astype(np.float32), known


@given(scattered())
def test_known_pixels_keep_their_value_and_others_stay_between(case):
    values, known = case
    filled = push_pull(values, known)
    assert filled.shape == values.shape
    assert filled.dtype == np.float32
    np.testing.assert_array_equal(filled[known], values[known])
    low, high = values[known].min(axis=0), values[known].max(axis=0)
    assert np.all(filled >= low - 1e-5)
    assert np.all(filled <= high + 1e-5)


@given(scattered(), st.floats(-1, 1, width=32))
def test_a_constant_stays_one(case, constant):
    values, known = case
    values = np.where(known[..., None], np.float32(constant), values)
    np.testing.assert_allclose(push_pull(values, known), constant, atol=1e-5)


def test_unknown_values_do_not_count():
    rng = np.random.default_rng(0)
    values, known = rng.random((9, 13, 2), np.float32), rng.random((9, 13)) < 0.2
    other = np.where(known[..., None], values, 5.0).astype(np.float32)
    np.testing.assert_array_equal(push_pull(values, known), push_pull(other, known))


def test_a_hole_continues_what_is_around_it():
    ramp = np.tile(np.linspace(0, 1, 64, dtype=np.float32), (64, 1))[..., None]
    known = np.ones((64, 64), bool)
    known[24:40, 24:40] = False
    filled = push_pull(ramp, known)
    assert np.abs(filled - ramp).max() < 0.15
    assert np.abs(np.diff(filled[..., 0], axis=1)).max() < 0.1  # no seam


@pytest.fixture
def view():
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.3, 0.7, (33, 47, 3)).astype(np.float32)
    valid = rng.random((33, 47)) < 0.6
    valid[5:25, 10:30] = False
    return truth, valid


@pytest.mark.parametrize("offset", [-0.2, 0.15])
def test_an_image_that_is_off_by_a_constant_is_mended_exactly(view, offset):
    truth, valid = view
    shown = keep_support(truth + np.float32(offset), truth * valid[..., None], valid)
    np.testing.assert_array_equal(shown[valid], truth[valid])
    np.testing.assert_allclose(shown, truth, atol=1e-5)


def test_supported_pixels_are_exact_and_the_rest_is_generated(view):
    truth, valid = view
    generated = np.random.default_rng(1).uniform(0, 1, truth.shape).astype(np.float32)
    shown = keep_support(generated, truth * valid[..., None], valid)
    np.testing.assert_array_equal(shown[valid], truth[valid])
    residual = push_pull(truth - generated, valid)
    np.testing.assert_allclose(
        shown[~valid], np.clip(generated + residual, 0, 1)[~valid], atol=1e-6
    )
    assert shown.min() >= 0
    assert shown.max() <= 1


def test_without_support_all_is_generated(view):
    truth, valid = view
    nothing = np.zeros_like(valid)
    shown = keep_support(2 * truth, np.zeros_like(truth), nothing)
    np.testing.assert_array_equal(shown, np.minimum(2 * truth, 1))
