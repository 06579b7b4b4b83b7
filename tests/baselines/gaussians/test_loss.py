"""The photometric loss against autograd, scikit-image, and values derived by hand."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from baselines.gaussians.loss import (
    C1,
    C2,
    SSIM_WEIGHT,
    photometric_loss,
    photometric_loss_reference,
)
from geoevs.core.errors import GeoEvsError


def pictures(height, width, dtype=torch.float64):
    generator = torch.Generator().manual_seed(0)
    image, target = torch.rand(2, height, width, 3, generator=generator, dtype=dtype)
    return image.requires_grad_(), target


# Smaller than the window, not square, and with an inner part that no border reaches.
@pytest.mark.parametrize("size", [(3, 4), (1, 13), (24, 17)])
def test_it_is_its_twin(size):
    image, target = pictures(*size)
    loss, twin = photometric_loss(image, target), photometric_loss_reference(image, target)
    torch.testing.assert_close(loss, twin, rtol=1e-12, atol=0)
    gradients = [torch.autograd.grad(value, image)[0] for value in (loss, twin)]
    torch.testing.assert_close(*gradients, rtol=1e-9, atol=1e-12)


def test_its_gradient_is_that_of_its_value():
    image, target = pictures(8, 7)
    assert torch.autograd.gradcheck(photometric_loss, (image, target))


def test_float32_is_close_to_float64():
    image, target = pictures(40, 50)
    exact = torch.autograd.grad(photometric_loss(image, target), image)[0]
    single = image.detach().float().requires_grad_()
    loss = photometric_loss(single, target.float())
    loss.backward()
    assert loss.dtype == torch.float32
    # Gradients are per pixel's share of the mean.
    np.testing.assert_allclose(single.grad * exact.numel(), exact * exact.numel(), atol=1e-4)


def test_ssim_is_that_of_scikit_image():
    # Black for more than the window around the middle: then no rule for the borders matters.
    image, target = (np.zeros((48, 40, 3)) for _ in range(2))
    inner = np.s_[12:-12, 12:-12]
    image[inner], target[inner] = (p.detach().numpy() for p in pictures(24, 16))
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, ssim = structural_similarity(
        image, target, channel_axis=2, data_range=1.0, full=True, **options
    )
    expected = (1 - SSIM_WEIGHT) * np.abs(image - target).mean() + SSIM_WEIGHT * (1 - ssim.mean())
    loss = photometric_loss(torch.from_numpy(image), torch.from_numpy(target))
    assert loss.item() == pytest.approx(expected, rel=1e-9)


def test_a_lone_pixel_by_hand():
    # All window means are the centre's weight w times the pixel's, so that with x = 0.5, y = 1:
    weights = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    w = (weights[5] / weights.sum()) ** 2
    x, y = 0.5, 1.0
    mean_x, mean_y = w * x, w * y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    covariance = w * x * y - mean_x * mean_y
    variances = w * x**2 - mean_x**2 + w * y**2 - mean_y**2
    ssim = luminance * (2 * covariance + C2) / (variances + C2)
    image, target = torch.full((2, 1, 1, 3), 1.0, dtype=torch.float64) * torch.tensor(
        [x, y], dtype=torch.float64
    ).view(2, 1, 1, 1)
    loss = photometric_loss(image, target)
    assert loss.item() == pytest.approx(0.8 * 0.5 + 0.2 * (1 - ssim), rel=1e-12)


def test_equal_pictures_cost_nothing():
    _, target = pictures(20, 20)
    image = target.clone().requires_grad_()
    loss = photometric_loss(image, target)
    loss.backward()
    assert loss.item() == pytest.approx(0, abs=1e-12)
    assert image.grad.abs().max() < 1e-12


def test_the_gradient_scales_with_what_follows():
    image, target = pictures(9, 9)
    once = torch.autograd.grad(photometric_loss(image, target), image)[0]
    thrice = torch.autograd.grad(3 * photometric_loss(image, target), image)[0]
    torch.testing.assert_close(thrice, 3 * once)


def test_pictures_of_two_sizes_are_refused():
    with pytest.raises(GeoEvsError, match=r"\(2, 3, 3\) but its target \(3, 2, 3\); render it"):
        photometric_loss(torch.zeros(2, 3, 3), torch.zeros(3, 2, 3))
