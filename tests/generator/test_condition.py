import numpy as np
import pytest
import torch
from torch.nn import functional

from geoevs.generator.condition import ConditionEncoder, FrozenEncoder


@pytest.fixture
def condition():
    """X and its validity; the colours include black and the grey that encodes as zero."""
    rng = np.random.default_rng(0)
    valid = torch.from_numpy(rng.random((2, 1, 8, 12)) < 0.5)
    colours = torch.from_numpy(rng.choice([0, 0.25, 0.5, 1], (2, 3, 8, 12)).astype(np.float32))
    return colours * valid, valid


def first_input(encoder, condition):
    seen = []
    encoder.layers[0].register_forward_pre_hook(lambda layer, inputs: seen.append(inputs[0]))
    encoder(*condition)
    return seen[0]


@pytest.mark.parametrize("factor", [2, 4])
def test_the_first_step_loses_nothing(condition, factor):
    encoder = ConditionEncoder(factor)
    pixels = functional.pixel_shuffle(first_input(encoder, condition), factor)
    x, valid = condition
    found = pixels[:, 3:] == 1
    assert torch.equal(found, valid)
    assert torch.equal((pixels[:, :3] + 1) / 2 * found, x)


def test_without_validity_holes_are_black(condition):
    encoder = ConditionEncoder(2, validity=False)
    pixels = functional.pixel_shuffle(first_input(encoder, condition), 2)
    assert pixels.shape[1] == 3
    assert torch.equal((pixels + 1) / 2, condition[0])
    x, valid = torch.zeros(1, 3, 4, 4), torch.zeros(1, 1, 4, 4, dtype=bool)
    assert torch.equal(encoder(x, valid), encoder(x, ~valid))
    assert not torch.equal(*(ConditionEncoder(2)(x, mask) for mask in (valid, ~valid)))


def test_features_lie_on_the_latents_grid(condition):
    assert ConditionEncoder(4, channels=5)(*condition).shape == (2, 5, 2, 3)
    assert ConditionEncoder(4).channels == 24


def test_what_is_invalid_is_not_seen(condition):
    x, valid = condition
    encoder = ConditionEncoder(2)
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
