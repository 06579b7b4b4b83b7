import numpy as np
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.diffusion.autoencoder import (
    NANO_BLOCK,
    Autoencoder,
    nano_autoencoder,
    to_arrays,
    to_tensor,
)


def test_the_nano_autoencoder_keeps_its_shapes():
    nano = Autoencoder(nano_autoencoder(), NANO_BLOCK)
    assert nano.factor == 4
    assert nano.latent_channels == 12
    assert nano.encode(torch.rand(1, 3, 8, 12)).shape == (1, 12, 2, 3)
    assert nano.decode(torch.randn(1, 12, 2, 3)).shape == (1, 3, 8, 12)


# A public autoencoder halves where it has levels; blocks divide besides.
@pytest.mark.parametrize(("block", "levels", "factor"), [(1, 3, 4), (4, 1, 4)])
def test_blocks_and_levels_divide(networks, block, levels, factor):
    autoencoder = Autoencoder(networks.network(3 * block**2, levels=levels), block)
    assert autoencoder.factor == factor
    latents = autoencoder.encode(torch.rand(2, 3, 16, 24))
    assert latents.shape == (2, 4, 16 // factor, 24 // factor)
    assert autoencoder.decode(latents).shape == (2, 3, 16, 24)
    assert (autoencoder.linear is None) == (block == 1)


def test_images_that_do_not_divide_are_refused(networks):
    autoencoder = networks.autoencoder(block=4)
    sentence = "images of 16 x 22 do not divide into latents; choose sides that are multiples of 4"
    for method in (autoencoder.encode, autoencoder.fit_linear, autoencoder.fit_statistics):
        with pytest.raises(GeoEvsError, match=f"^{sentence}$"):
            method(torch.rand(1, 3, 16, 22))


def test_statistics_make_latents_standard(networks):
    autoencoder = networks.autoencoder()
    images = to_tensor(networks.images(6, seed=1))
    before = autoencoder.encode(images)
    assert before.mean().abs() + (before.std() - 1).abs() > 0.01  # of other images
    autoencoder.fit_statistics(images)
    latents = autoencoder.encode(images)
    torch.testing.assert_close(latents.mean(dim=(0, 2, 3)), torch.zeros(4), atol=1e-5, rtol=0)
    torch.testing.assert_close(latents.std(dim=(0, 2, 3)), torch.ones(4), atol=1e-5, rtol=0)


def test_normalising_is_undone_by_decoding(networks):
    autoencoder = networks.autoencoder()
    images = to_tensor(networks.images(3, seed=1))
    plain = autoencoder.decode_raw(autoencoder.posterior(images).mean)
    torch.testing.assert_close(autoencoder.decode(autoencoder.encode(images)), plain)


def test_the_linear_code_is_the_principal_components(networks):
    autoencoder = networks.autoencoder(latent=5)
    rng = np.random.default_rng(0)
    images = torch.from_numpy(rng.random((4, 3, 16, 16), np.float32))
    autoencoder.fit_linear(images)
    autoencoder.shift.zero_()
    autoencoder.scale.fill_(1)
    # An untrained network adds nothing, so the error is that of NumPy's own decomposition.
    blocks = images.numpy().reshape(4, 3, 8, 2, 8, 2).transpose(0, 2, 4, 1, 3, 5).reshape(-1, 12)
    values = np.linalg.svd(blocks - blocks.mean(axis=0), compute_uv=False)
    decoded = autoencoder.decode(autoencoder.encode(images))
    error = float((decoded - images).square().sum().detach())
    assert error == pytest.approx((values[5:] ** 2).sum(), rel=1e-4)


def test_arrays_become_tensors_and_back():
    images = np.random.default_rng(0).integers(0, 256, (2, 3, 4, 3), np.uint8)
    tensor = to_tensor(images)
    assert tensor.shape == (2, 3, 3, 4)
    assert tensor[1, 2, 0, 3].item() == pytest.approx(images[1, 0, 3, 2] / 255)
    np.testing.assert_allclose(to_arrays(tensor), images / 255, atol=1e-7)
    np.testing.assert_array_equal(
        to_tensor(images[:, ::-1] / 255.0).numpy()[0, 0, 0, 0], tensor[0, 0, 2, 0]
    )
    overshoot = to_arrays(torch.tensor([-0.5, 0.25, 1.5]).reshape(1, 3, 1, 1))
    assert overshoot.ravel().tolist() == [0.0, 0.25, 1.0]
