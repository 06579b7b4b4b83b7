import numpy as np
import pytest
import torch

from geoevs.diffusion.push_pull import push_pull
from geoevs.generator.geo_evs_support.support import keep_support


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
    missing = torch.from_numpy(truth - generated).permute(2, 0, 1)[None]
    residual = push_pull(missing, torch.from_numpy(valid)[None, None])[0].permute(1, 2, 0).numpy()
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
