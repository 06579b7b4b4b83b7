import numpy as np
import pytest
import torch
from torch.nn import functional

from geoevs.diffusion.condition_encoder import ConditionEncoder, FrozenEncoder
from geoevs.diffusion.push_pull import push_pull


@pytest.fixture
def condition():
    """X and its validity; the colours include black and the grey that encodes as zero."""
    rng = np.random.default_rng(0)
    valid = torch.from_numpy(rng.random((2, 1, 8, 12)) < 0.5)
    colours = torch.from_numpy(rng.choice([0, 0.25, 0.5, 1], (2, 3, 8, 12)).astype(np.float32))
    return colours * valid, valid


@pytest.fixture
def make(networks):
    """Makes a trained encoder of a tiny autoencoder's factor."""

    def make(factor=2, **options):
        return ConditionEncoder(networks.autoencoder(factor), **options)

    return make


def first_input(encoder, condition):
    seen = []
    encoder.layers[0].register_forward_pre_hook(lambda layer, inputs: seen.append(inputs[0]))
    encoder(*condition)
    return seen[0]


@pytest.mark.parametrize("factor", [2, 4])
def test_the_first_step_loses_nothing(make, condition, factor):
    encoder = make(factor)
    pixels = functional.pixel_shuffle(first_input(encoder, condition), factor)
    x, valid = condition
    found = pixels[:, 3:] == 1
    assert torch.equal(found, valid)
    assert torch.equal((pixels[:, :3] + 1) / 2 * found, x)


def test_without_validity_the_trained_part_sees_black_holes(make, condition):
    encoder = make(validity=False)
    pixels = functional.pixel_shuffle(first_input(encoder, condition), 2)
    assert pixels.shape[1] == 3
    assert torch.equal((pixels + 1) / 2, condition[0])
    x, valid = torch.zeros(1, 3, 4, 4), torch.zeros(1, 1, 4, 4, dtype=bool)
    assert torch.equal(encoder(x, valid), encoder(x, ~valid))
    assert not torch.equal(*(make()(x, mask) for mask in (valid, ~valid)))


def test_features_lie_on_the_latents_grid(make, condition):
    encoder = make(4, channels=5)
    assert encoder(*condition).shape == (2, encoder.channels, 2, 3)
    assert encoder.channels == encoder.latent_channels + 5
    assert make(4).channels == encoder.latent_channels + 24


@pytest.mark.parametrize("filled", [True, False])
def test_the_latent_of_the_map_comes_first(networks, make, condition, filled):
    x, valid = condition
    encoder = make(filled=filled)
    autoencoder = networks.autoencoder()
    latent = encoder(x, valid)[:, : encoder.latent_channels]
    assert torch.equal(latent, autoencoder.encode(push_pull(x, valid) if filled else x))
    everywhere = torch.ones_like(valid)
    assert torch.equal(encoder(x, everywhere)[:, : latent.shape[1]], autoencoder.encode(x))
    # The autoencoder is no part of what is trained or stored.
    assert all(name.startswith("layers.") for name in encoder.state_dict())


def test_what_is_invalid_is_not_seen(make, condition):
    x, valid = condition
    encoder = make()
    assert torch.equal(encoder(x, valid), encoder(torch.where(valid, x, 0.7), valid))


def test_the_frozen_reading_is_the_autoencoders_own_code(networks, condition):
    autoencoder = networks.autoencoder()
    encoder = FrozenEncoder(autoencoder)
    x, valid = condition
    features = encoder(x, valid)
    assert features.shape == (2, encoder.channels, 4, 6)
    assert torch.equal(features[:, :4], autoencoder.encode(x))
    share = valid.float().unflatten(2, (4, 2)).unflatten(4, (6, 2)).mean(dim=(3, 5))
    torch.testing.assert_close(features[:, 4:], share)
    # It is no part of what is trained or stored.
    assert list(encoder.parameters()) == []
    assert encoder.state_dict() == {}
    assert not features.requires_grad
