"""Scale fitting where the right factors are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.geometry.scale import fit_scale, frame_factor
from geoevs.scenes.camera import Camera

HEIGHT, WIDTH = 40, 60
CAMERA = Camera([[60, 0, 30], [0, 60, 20], [0, 0, 1]], np.eye(4), HEIGHT, WIDTH, "test")
RNG = np.random.default_rng(0)
SHAPE = np.exp(RNG.normal(2.5, 0.5, (HEIGHT, WIDTH))).astype(np.float32)
EVERY_FOURTH = np.zeros((HEIGHT, WIDTH), bool)
EVERY_FOURTH[12::4, ::4] = True  # none above, as with a real LiDAR


def sparse(depth, mask=EVERY_FOURTH):
    return np.where(mask, depth, 0).astype(np.float64)


def fit_frame(depth, confidence, lidar, camera):
    """`fit_scale` for a frame of one view."""
    return fit_scale(depth, confidence, lidar, camera, frame_factor([(depth, lidar)]))


@given(st.floats(0.01, 100.0))
def test_a_global_factor_is_recovered_everywhere(factor):
    fitted = fit_frame(SHAPE, None, sparse(SHAPE * factor), CAMERA)
    assert fitted.dtype == np.float32
    np.testing.assert_allclose(fitted, SHAPE * np.float32(factor), rtol=1e-5)


def test_lidar_is_kept_exactly():
    lidar = sparse(np.exp(RNG.normal(2.5, 0.5, (HEIGHT, WIDTH))))
    fitted = fit_frame(SHAPE, 1 + RNG.random((HEIGHT, WIDTH)), lidar, CAMERA)
    np.testing.assert_allclose(fitted[lidar > 0], lidar[lidar > 0], rtol=1e-5)


def test_two_planes_with_factors_of_their_own():
    truth = np.full((HEIGHT, WIDTH), 20.0, np.float32)
    truth[:, :28] = 5.0
    predicted = np.where(truth == 5.0, truth / 1.3, truth / 0.8).astype(np.float32)
    everywhere = np.zeros_like(EVERY_FOURTH)
    everywhere[2::4, 2::4] = True  # the columns beside the edge have none
    fitted = fit_frame(predicted, None, sparse(truth, everywhere), CAMERA)
    np.testing.assert_allclose(fitted, truth, rtol=0.02)


def test_the_frames_factor_is_the_median_of_all_its_views():
    ones = np.ones((4, 5), np.float32)
    no_depth, no_lidar = 0 * ones, np.zeros(ones.shape)
    thrice, twice = np.where(np.eye(4, 5), 3.0, 0), np.full(ones.shape, 2.0)
    pairs = [(ones, thrice), (ones, twice), (no_depth, twice), (ones, no_lidar)]
    assert frame_factor(pairs) == pytest.approx(2.0)
    assert frame_factor([(ones, no_lidar)]) == 1.0


def test_where_lidar_does_not_reach_it_is_the_frames_factor():
    depth, lidar = np.full((HEIGHT, WIDTH), 10.0, np.float32), np.zeros((HEIGHT, WIDTH))
    lidar[10:30:2, :5] = 50.0  # an obstacle at the view's rim
    fitted = fit_scale(depth, None, lidar, CAMERA, 2.0)
    np.testing.assert_allclose(fitted[:, 12:], 20.0, rtol=1e-6)
    np.testing.assert_allclose(fitted[36:], 20.0, rtol=1e-6)
    np.testing.assert_allclose(fitted[10:29, :4], 50.0, rtol=0.02)
    assert (np.diff(fitted[20, 4:12]) < 0).all()
    np.testing.assert_allclose(fit_scale(depth, None, 0 * lidar, CAMERA, 2.0), 20.0)


def test_where_the_network_is_unsure_lidar_spreads_less():
    depth = np.full((HEIGHT, WIDTH), 10.0, np.float32)
    lidar = np.zeros((HEIGHT, WIDTH))
    lidar[20, 10], lidar[20, 20] = 10.0, 40.0
    confidence = np.ones((HEIGHT, WIDTH))
    even = fit_frame(depth, None, lidar, CAMERA)[20, 15]
    assert even == pytest.approx(20.0, rel=1e-5)  # both logarithms, and the factor
    confidence[20, 20] = 9.0
    assert fit_frame(depth, confidence, lidar, CAMERA)[20, 15] > 25
    assert fit_frame(depth, 7 * np.ones((HEIGHT, WIDTH)), lidar, CAMERA)[20, 15] == even


def test_without_lidar_nothing_changes():
    np.testing.assert_array_equal(fit_frame(SHAPE, None, np.zeros(SHAPE.shape), CAMERA), SHAPE)


def test_pixels_without_depth_stay_so():
    depth = SHAPE.copy()
    depth[12:20] = 0
    fitted = fit_frame(depth, None, sparse(2 * SHAPE), CAMERA)
    assert not fitted[12:20].any()
    np.testing.assert_allclose(fitted[20:], 2 * SHAPE[20:], rtol=1e-5)


def test_resolution_does_not_matter():
    lidar = sparse(SHAPE * (1 + RNG.random(SHAPE.shape)))
    double = fit_frame(
        SHAPE.repeat(2, 0).repeat(2, 1),
        None,
        np.kron(lidar, [[1, 0], [0, 0]]),
        CAMERA.resized(2 * HEIGHT, 2 * WIDTH),
    )
    fitted = fit_frame(SHAPE, None, lidar, CAMERA)
    within = np.s_[:37, :57]  # LiDAR to the right and below has another rim
    np.testing.assert_allclose(double[::2, ::2][within], fitted[within], rtol=1e-5)
