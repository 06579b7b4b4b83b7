import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity

from geoevs.protocol.metrics import GMS, MAE, METRICS, PSNR, RMSE, SSIM, PSNRSum, SSIMZeroFill

KINDS = [PSNR, PSNRSum, MAE, RMSE, SSIM, SSIMZeroFill, GMS]


def score(kind, preds, target, mask):
    metric = kind()
    metric.update(preds, target, mask)
    return metric.compute()


@pytest.fixture
def images():
    rng = np.random.default_rng(0)
    target = rng.random((40, 56, 3))
    return np.clip(target + 0.1 * rng.standard_normal(target.shape), 0, 1), target


def full(image):
    return np.ones(image.shape[:2], bool)


def test_full_mask_equals_scikit_image(images):
    preds, target = images
    mask = full(target)
    psnr = peak_signal_noise_ratio(target, preds, data_range=1.0)
    ssim = structural_similarity(
        target,
        preds,
        gaussian_weights=True,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
    )
    assert score(PSNR, preds, target, mask) == pytest.approx(psnr, abs=1e-9)
    assert score(SSIM, preds, target, mask) == pytest.approx(ssim, abs=1e-9)
    assert score(SSIMZeroFill, preds, target, mask) == pytest.approx(ssim, abs=1e-9)
    assert score(RMSE, preds, target, mask) ** 2 == pytest.approx(mean_squared_error(preds, target))
    assert score(MAE, preds, target, mask) == pytest.approx(np.abs(preds - target).mean())


@pytest.mark.parametrize("kind", KINDS)
def test_single_precision_images_score_as_double_ones(kind, images):
    preds, target = (image.astype(np.float32) for image in images)
    mask = np.random.default_rng(4).random(target.shape[:2]) < 0.8
    mask[:12, :12] = True
    double = score(kind, preds.astype(np.float64), target.astype(np.float64), mask)
    assert score(kind, preds, target, mask) == pytest.approx(double, rel=2e-6)


def test_values_by_hand():
    target = np.zeros((1, 3, 3))
    preds = np.array([[[0.3, 0.0, 0.0], [0.1, 0.1, 0.1], [9.0, 9.0, 9.0]]])
    mask = np.array([[True, True, False]])
    # Squared errors summed over channels: 0.09 and 0.03; over two pixels and three channels.
    assert score(PSNR, preds, target, mask) == pytest.approx(10 * math.log10(6 / 0.12))
    assert score(PSNRSum, preds, target, mask) == pytest.approx(10 * math.log10(2 / 0.12))
    assert score(RMSE, preds, target, mask) == pytest.approx(math.sqrt(0.12 / 6))
    assert score(MAE, preds, target, mask) == pytest.approx(0.6 / 6)


def test_the_papers_formula_is_lower_by_the_number_of_channels(images):
    preds, target = images
    gap = score(PSNR, preds, target, full(target)) - score(PSNRSum, preds, target, full(target))
    assert gap == pytest.approx(10 * math.log10(3))


def test_ssim_of_a_constant_shift_by_hand():
    # No variance on either side: only the luminance term is left, whatever the support.
    target, preds = np.full((21, 21, 3), 0.5), np.full((21, 21, 3), 0.6)
    luminance = (2 * 0.5 * 0.6 + 1e-4) / (0.5**2 + 0.6**2 + 1e-4)
    mask = np.random.default_rng(0).random((21, 21)) < 0.3
    assert score(SSIM, preds, target, mask) == pytest.approx(luminance, abs=1e-9)


def test_zero_fill_inflates_as_support_shrinks_and_normalisation_does_not():
    # Unrelated noise: no structure in common, whatever part of it is seen.
    preds, target = np.random.default_rng(0).random((2, 64, 64, 3))
    rank = np.random.default_rng(1).random((64, 64))
    dense = score(SSIM, preds, target, full(target))
    naive = [score(SSIMZeroFill, preds, target, rank < keep) for keep in (1.0, 0.3, 0.05)]
    assert naive == sorted(naive)
    assert naive[-1] > dense + 0.5
    assert score(SSIM, preds, target, rank < 0.3) == pytest.approx(dense, abs=0.1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("junk", [math.nan, math.inf, -1e30])
def test_invalid_pixels_can_hold_anything(kind, junk, images):
    preds, target = images
    mask = np.random.default_rng(2).random(target.shape[:2]) < 0.5
    mask[:12, :12] = True  # room for whole neighbourhoods
    hole = ~mask[..., None]
    spoiled = score(kind, np.where(hole, junk, preds), np.where(hole, -junk, target), mask)
    assert spoiled == score(kind, preds, target, mask)


@pytest.mark.parametrize("kind", KINDS)
def test_no_valid_pixel_is_nan(kind, images):
    preds, target = images
    assert math.isnan(score(kind, preds, target, np.zeros(target.shape[:2], bool)))


@pytest.mark.parametrize("kind", KINDS)
def test_updates_pool_their_sums(kind, images):
    preds, target = images
    mask = np.random.default_rng(3).random(target.shape[:2]) < 0.7
    mask[:12, :12] = True
    pooled = kind()
    pooled.update(preds, target, mask)
    pooled.update(preds, target, mask)
    assert pooled.compute() == pytest.approx(score(kind, preds, target, mask))


def test_exact_copies_score_perfectly(images):
    _, target = images
    assert score(PSNR, target, target, full(target)) == math.inf
    assert score(SSIM, target, target, full(target)) == pytest.approx(1.0)


def test_isolated_pixels_have_no_structure_to_compare():
    mask = np.zeros((33, 33), bool)
    mask[::12, ::12] = True
    image = np.random.default_rng(0).random((33, 33, 3))
    assert math.isnan(score(SSIM, image, image, mask))


@given(seed=st.integers(0, 2**32 - 1), support=st.floats(0.05, 1.0))
@settings(max_examples=30, deadline=None)
def test_swapping_pixels_of_both_images_changes_no_pixel_metric(seed, support):
    rng = np.random.default_rng(seed)
    preds, target = rng.random((2, 60, 3))
    mask = rng.random(60) < support
    order = rng.permutation(60)
    for kind in (PSNR, MAE, RMSE):
        before = score(kind, preds[None], target[None], mask[None])
        after = score(kind, preds[None, order], target[None, order], mask[None, order])
        assert after == pytest.approx(before, nan_ok=True)


@given(seed=st.integers(0, 2**32 - 1), support=st.floats(0.02, 1.0))
@settings(max_examples=30, deadline=None)
def test_ssim_stays_within_its_range(seed, support):
    rng = np.random.default_rng(seed)
    preds, target = rng.random((2, 24, 24, 3))
    mask = rng.random((24, 24)) < support
    value = score(SSIM, preds, target, mask)
    assert math.isnan(value) or -1 <= value <= 1


def test_every_metric_declares_its_better_direction():
    worse_is_more = {name for name, spec in METRICS.items() if not spec.higher_is_better}
    assert worse_is_more == {"sparse_mae", "sparse_rmse", "mae", "lpips", "efficientnet_layers"}


def test_gradient_similarity_by_hand():
    # A vertical step of 0.3 in one image alone: its Prewitt gradients are 0.3 in the two columns
    # of the halved image beside it, all others are zero.
    target, preds = np.zeros((16, 16, 3)), np.zeros((16, 16, 3))
    preds[:, 8:] = 0.3
    beside = 0.0026 / (0.3**2 + 0.0026)
    # Of the 6 x 6 inner pixels, two columns lie beside the step.
    assert score(GMS, preds, target, full(target)) == pytest.approx((2 * beside + 4) / 6, rel=1e-5)
