"""Scale fitting where the right factors are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.geometry.scale import fit_scale
from geoevs.scenes.camera import Camera

HEIGHT, WIDTH = 40, 60
CAMERA = Camera([[60, 0, 30], [0, 60, 20], [0, 0, 1]], np.eye(4), HEIGHT, WIDTH, "test")
RNG = np.random.default_rng(0)
SHAPE = np.exp(RNG.normal(2.5, 0.5, (HEIGHT, WIDTH))).astype(np.float32)
EVERY_FOURTH = np.zeros((HEIGHT, WIDTH), bool)
EVERY_FOURTH[12::4, ::4] = True  # none above, as with a real LiDAR


def sparse(depth, mask=EVERY_FOURTH):
    return np.where(mask, depth, 0).astype(np.float64)


@given(st.floats(0.01, 100.0))
def test_a_global_factor_is_recovered_everywhere(factor):
    fitted = fit_scale(SHAPE, None, sparse(SHAPE * factor), CAMERA)
    assert fitted.dtype == np.float32
    np.testing.assert_allclose(fitted, SHAPE * np.float32(factor), rtol=1e-5)


def test_lidar_is_kept_exactly():
    lidar = sparse(np.exp(RNG.normal(2.5, 0.5, (HEIGHT, WIDTH))))
    fitted = fit_scale(SHAPE, 1 + RNG.random((HEIGHT, WIDTH)), lidar, CAMERA)
    np.testing.assert_allclose(fitted[lidar > 0], lidar[lidar > 0], rtol=1e-5)


def test_two_planes_with_factors_of_their_own():
    truth = np.full((HEIGHT, WIDTH), 20.0, np.float32)
    truth[:, :28] = 5.0
    predicted = np.where(truth == 5.0, truth / 1.3, truth / 0.8).astype(np.float32)
    everywhere = np.zeros_like(EVERY_FOURTH)
    everywhere[2::4, 2::4] = True  # the columns beside the edge have none
    fitted = fit_scale(predicted, None, sparse(truth, everywhere), CAMERA)
    np.testing.assert_allclose(fitted, truth, rtol=0.02)


def test_far_from_lidar_it_is_the_median():
    # One column of LiDAR in a very wide view: two thirds of it ask for 2, the rest for 3.
    wide = Camera([[60, 0, 30], [0, 60, 20], [0, 0, 1]], np.eye(4), 30, 3000, "wide")
    depth = np.full((30, 3000), 10.0, np.float32)
    lidar = np.zeros(depth.shape)
    lidar[:, 0] = np.where(np.arange(30) % 3, 20.0, 30.0)
    fitted = fit_scale(depth, None, lidar, wide)
    np.testing.assert_allclose(fitted[:, -1], 20.0, rtol=0.01)


def test_where_the_network_is_unsure_lidar_spreads_less():
    depth = np.full((HEIGHT, WIDTH), 10.0, np.float32)
    lidar = np.zeros((HEIGHT, WIDTH))
    lidar[20, 10], lidar[20, 20] = 10.0, 40.0
    confidence = np.ones((HEIGHT, WIDTH))
    even = fit_scale(depth, None, lidar, CAMERA)[20, 15]
    assert even == pytest.approx(20.0, rel=1e-5)  # both logarithms, and their median
    confidence[20, 20] = 9.0
    assert fit_scale(depth, confidence, lidar, CAMERA)[20, 15] > 25
    assert fit_scale(depth, 7 * np.ones((HEIGHT, WIDTH)), lidar, CAMERA)[20, 15] == even


def test_without_lidar_nothing_changes():
    np.testing.assert_array_equal(fit_scale(SHAPE, None, np.zeros(SHAPE.shape), CAMERA), SHAPE)


def test_pixels_without_depth_stay_so():
    depth = SHAPE.copy()
    depth[12:20] = 0
    fitted = fit_scale(depth, None, sparse(2 * SHAPE), CAMERA)
    assert not fitted[12:20].any()
    np.testing.assert_allclose(fitted[20:], 2 * SHAPE[20:], rtol=1e-5)


def test_resolution_does_not_matter():
    lidar = sparse(SHAPE * (1 + RNG.random(SHAPE.shape)))
    double = fit_scale(
        SHAPE.repeat(2, 0).repeat(2, 1),
        None,
        np.kron(lidar, [[1, 0], [0, 0]]),
        CAMERA.resized(2 * HEIGHT, 2 * WIDTH),
    )
    fitted = fit_scale(SHAPE, None, lidar, CAMERA)
    np.testing.assert_allclose(double[::2, ::2], fitted, rtol=1e-5)
