"""What tests of several packages share."""

import os

import pytest
from hypothesis import settings

from geoevs.protocol.isolate import THREAD_VARIABLES

# The same examples each time, however busy the machine: what passed once passes again, until
# somebody changes the code.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes():
    """Processes that share the files get one thread each: idle ones spin, and slow the others."""
    os.environ |= dict.fromkeys(THREAD_VARIABLES, "1")


def pytest_configure(config):
    """Hide GPUs from all tests but theirs: the same bytes are promised on the CPU alone."""
    if config.option.markexpr != "cuda":
        os.environ["CUDA_VISIBLE_DEVICES"] = ""


def pytest_collection_modifyitems(items):
    """The smoke run's tests take longest: where two processes share the files, one begins there."""
    items.sort(key=lambda item: item.path.name != "test_smoke.py")


def pytest_runtest_setup(item):
    """Skip what needs a GPU where none is, or where it is hidden."""
    if item.get_closest_marker("cuda"):
        import torch

        if not torch.cuda.is_available():
            pytest.skip("tests on a GPU run by themselves, with `pytest -m cuda`, where one is")


@pytest.fixture
def networks():
    """Makers of networks so small that they run in milliseconds, and of images for them."""
    import numpy as np
    import torch
    from diffusers import AutoencoderKL, UNet2DConditionModel

    from geoevs.generator.autoencoder import Autoencoder, to_tensor
    from geoevs.generator.condition import ConditionEncoder
    from geoevs.generator.denoiser import Denoiser, conditioned
    from geoevs.generator.diffusion import Diffusion
    from geoevs.generator.generator import Generator
    from geoevs.generator.prior import Prior
    from geoevs.training import seeded

    def tiny_network(values, latent=4, levels=1):
        return AutoencoderKL(
            in_channels=values,
            out_channels=values,
            down_block_types=("DownEncoderBlock2D",) * levels,
            up_block_types=("UpDecoderBlock2D",) * levels,
            block_out_channels=(8,) * levels,
            layers_per_block=1,
            latent_channels=latent,
            norm_num_groups=4,
            mid_block_add_attention=False,
        )

    def tiny_unet(latent=4):
        return UNet2DConditionModel(
            in_channels=latent,
            out_channels=latent,
            block_out_channels=(8, 16),
            layers_per_block=1,
            norm_num_groups=4,
            down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"),
            up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
            cross_attention_dim=8,
            attention_head_dim=2,
        )

    def smooth_images(count, height=16, width=24, seed=0):
        """(N, H, W, 3) uint8: images of a few colours each."""
        rng = np.random.default_rng(seed)
        corners = rng.uniform(30, 225, (count, 2, 2, 3))
        down, across = np.linspace(0, 1, height)[:, None, None], np.linspace(0, 1, width)[:, None]
        left, right = (
            corners[:, 0, None, None, k] * (1 - down) + corners[:, 1, None, None, k] * down
            for k in (0, 1)
        )
        return np.rint(left * (1 - across) + right * across).astype(np.uint8)

    class Makers:
        network, unet, images = map(staticmethod, (tiny_network, tiny_unet, smooth_images))

        @staticmethod
        def autoencoder(block=2, latent=4):
            with seeded(0, "autoencoder"):
                made = Autoencoder(tiny_network(3 * block**2, latent), block)
            if block > 1:
                made.fit_linear(to_tensor(smooth_images(8, 8 * block, 8 * block)))
            made.fit_statistics(to_tensor(smooth_images(8, 8 * block, 8 * block)))
            return made.eval()

        @classmethod
        def prior(cls, diffusion=None, block=2):
            autoencoder = cls.autoencoder(block)
            with seeded(0, "prior"):
                denoiser = Denoiser(tiny_unet(), None)
                torch.nn.init.normal_(denoiser.prompt)
            return Prior(autoencoder, denoiser.eval(), diffusion or Diffusion())

        @classmethod
        def generator(cls, diffusion=None, block=2, **encoder):
            """Untrained, but one that looks at its condition."""
            prior = cls.prior(diffusion, block)
            with seeded(0, "encoder"):
                made = ConditionEncoder(prior.autoencoder, channels=6, **encoder)
                denoiser = conditioned(prior.denoiser, made, prior.diffusion.prediction)
                torch.nn.init.normal_(denoiser.unet.conv_in.weight, std=0.3)
                torch.nn.init.normal_(denoiser.null)
            return Generator(prior.autoencoder, denoiser.eval(), prior.diffusion)

    return Makers


@pytest.fixture
def weights(networks, tmp_path):
    """A folder of pretrained weights, as `snakemake pretrain` makes it."""
    from geoevs.generator.prior import (
        AUTOENCODER_FILE,
        PRIOR_FILE,
        save_autoencoder,
        save_denoiser,
    )

    prior = networks.prior()
    save_autoencoder(tmp_path / "weights" / AUTOENCODER_FILE, prior.autoencoder)
    save_denoiser(tmp_path / "weights" / PRIOR_FILE, prior.denoiser, prior.diffusion)
    return tmp_path / "weights"
