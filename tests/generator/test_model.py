import numpy as np
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.diffusion.process import Diffusion
from geoevs.diffusion.sampling import PREDICTIONS, SAMPLERS, Sampling
from geoevs.generator.geo_evs.model import Generator

FAST = Sampling(steps=2)


def random(seed=0):
    return torch.Generator().manual_seed(seed)


def condition(count=1, height=16, width=24):
    rng = np.random.default_rng(0)
    valid = rng.random((count, height, width)) < 0.6
    return rng.random((count, height, width, 3), np.float32) * valid[..., None], valid


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("prediction", PREDICTIONS)
@pytest.mark.parametrize("guidance", [1.0, 1.5])
def test_it_gives_images_in_range(networks, prediction, sampler, guidance):
    generator = networks.generator(Diffusion(prediction))
    images = generator.generate(*condition(2), Sampling(3, guidance, sampler), random())
    assert images.shape == (2, 16, 24, 3)
    assert images.dtype == np.float32
    assert np.isfinite(images).all()
    assert images.min() >= 0
    assert images.max() <= 1
    assert images.std() > 0.01


# Blocks of four pixels: 16 and 24 divide, the others do not; a latent of one pixel is enough.
@pytest.mark.parametrize("size", [(16, 24), (17, 24), (16, 27), (13, 21), (3, 2), (1, 1)])
def test_images_may_have_any_size(networks, size):
    images = networks.generator(block=4).generate(*condition(1, *size), FAST, random())
    assert images.shape == (1, *size, 3)


def test_what_is_added_to_an_image_is_without_support(networks):
    generator = networks.generator(block=4)
    seen = []
    generator.denoiser.encoder.register_forward_pre_hook(lambda _, inputs: seen.append(inputs))
    shown, valid = condition(1, 13, 22)
    small = generator.generate(shown, valid, FAST, random())
    ((x, mask, _),) = seen
    assert x.shape == (1, 3, 16, 24)
    np.testing.assert_array_equal(mask[0, 0, :13, :22], valid[0])
    np.testing.assert_array_equal(x[0, :, :13, :22], shown[0].transpose(2, 0, 1))
    for added in (x[..., 13:, :], x[..., 22:], mask[..., 13:, :], mask[..., 22:]):
        assert not added.any()
    # The same as by hand.
    padded = np.zeros((1, 16, 24, 3), np.float32)
    padded[:, :13, :22] = shown
    large = generator.generate(padded, padded.any(axis=-1), FAST, random())
    np.testing.assert_array_equal(small, large[:, :13, :22])


def test_the_same_randomness_gives_the_same_bytes(networks):
    generator = networks.generator()
    first, again, other = (
        generator.generate(*condition(), FAST, random(seed)) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


def test_the_condition_matters_and_so_does_guidance(networks):
    generator = networks.generator()
    shown, valid = condition()
    first = generator.generate(shown, valid, FAST, random())
    inverted = (1 - shown) * valid[..., None]
    assert np.abs(generator.generate(inverted, valid, FAST, random()) - first).max() > 0.01
    stronger = generator.generate(shown, valid, Sampling(2, guidance=4.0), random())
    assert np.abs(stronger - first).max() > 0.01


def test_the_mean_of_several_is_that_of_each(networks, monkeypatch):
    generator = networks.generator()
    shown, valid = condition(2)
    draws = torch.randn((6, 4, 8, 12), generator=random())
    mean = generator.generate(shown, valid, Sampling(2, average=3), random())
    each = []
    for part in draws.chunk(3):
        monkeypatch.setattr(torch, "randn", lambda *_, part=part, **__: part)
        each.append(generator.generate(shown, valid, FAST, random()))
    assert np.abs(each[0] - each[1]).max() > 0.01
    np.testing.assert_allclose(mean, np.mean(each, axis=0), atol=0.05)  # bfloat16, clipped


def test_a_generator_comes_back(networks, tmp_path):
    generator = networks.generator(Diffusion("sample"))
    generator.save(tmp_path)
    loaded = Generator.load(tmp_path)
    assert loaded.diffusion == generator.diffusion
    np.testing.assert_array_equal(
        loaded.generate(*condition(), FAST, random()),
        generator.generate(*condition(), FAST, random()),
    )


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"steps": 0}, "sampling cannot have 0 for its option 'steps'; choose from 1 to 1000"),
        ({"steps": 1001}, "sampling cannot have 1001 for its option 'steps'; choose from 1 to"),
        ({"average": 0}, "sampling cannot have 0 for its option 'average'; make it 1 or more"),
        (
            {"sampler": "ddpm"},
            r"sampling cannot have 'ddpm' for .* did you mean 'ddim'\?",
        ),
    ],
)
def test_wrong_sampling_is_one_sentence(settings, sentence):
    with pytest.raises(GeoEvsError, match=f"^{sentence}"):
        Sampling(**settings)
