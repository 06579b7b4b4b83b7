"""Networks so small that they run in milliseconds, and pairs to train them on."""

import numpy as np
import pytest
import torch
from diffusers import AutoencoderKL, UNet2DConditionModel

from geoevs.conditions.bits import pack_masks
from geoevs.conditions.masks import MaskLibrary
from geoevs.conditions.pairs import Pairs
from geoevs.generator.autoencoder import Autoencoder, to_tensor
from geoevs.generator.condition import ConditionEncoder
from geoevs.generator.denoiser import Denoiser, conditioned
from geoevs.generator.diffusion import Diffusion
from geoevs.generator.generator import Generator
from geoevs.generator.prior import (
    AUTOENCODER_FILE,
    PRIOR_FILE,
    Prior,
    save_autoencoder,
    save_denoiser,
)
from geoevs.training import seeded

HEIGHT, WIDTH = 16, 24
LATENT = 4


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def tiny_network(values, latent=LATENT, levels=1):
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


def tiny_unet(latent=LATENT):
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


def smooth_images(count, height=HEIGHT, width=WIDTH, seed=0):
    """(N, H, W, 3) uint8: images of a few colours each."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(30, 225, (count, 2, 2, 3))
    down, across = np.linspace(0, 1, height)[:, None, None], np.linspace(0, 1, width)[:, None]
    left, right = (
        corners[:, 0, None, None, k] * (1 - down) + corners[:, 1, None, None, k] * down
        for k in (0, 1)
    )
    return np.rint(left * (1 - across) + right * across).astype(np.uint8)


@pytest.fixture
def networks():
    """Makers of the parts that the packages' own are too large for."""

    class Makers:
        network, unet, images = map(staticmethod, (tiny_network, tiny_unet, smooth_images))

        @staticmethod
        def autoencoder(block=2, latent=LATENT):
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
def pairs():
    """Eight pairs; of pair n, the n first of 16 rows are unknown."""
    target = smooth_images(8)
    valid = np.arange(HEIGHT)[:, None] >= np.arange(8)[:, None, None]
    valid = np.broadcast_to(valid, (8, HEIGHT, WIDTH)).copy()
    names = np.array([f"scene-{n // 4}" for n in range(8)]), np.array(["front", "left"] * 4)
    return Pairs(target * valid[..., None], valid, target, *names, np.arange(8) // 2)


@pytest.fixture
def library():
    """Masks that hide the 6, 12 or 18 rightmost of 24 columns."""
    masks = np.arange(WIDTH) < WIDTH - 6 * np.arange(1, 4)[:, None, None]
    masks = np.broadcast_to(masks, (3, HEIGHT, WIDTH))
    labels = {"scene": np.full(3, "s"), "frame": np.arange(3)}
    labels |= {name: np.zeros(3) for name in ("yaw", "lateral")}
    return MaskLibrary(HEIGHT, WIDTH, pack_masks(masks), **labels, support=masks.mean(axis=(1, 2)))


@pytest.fixture
def weights(networks, tmp_path):
    """A folder of pretrained weights, as `snakemake pretrain` makes it."""
    prior = networks.prior()
    save_autoencoder(tmp_path / "weights" / AUTOENCODER_FILE, prior.autoencoder)
    save_denoiser(tmp_path / "weights" / PRIOR_FILE, prior.denoiser, prior.diffusion)
    return tmp_path / "weights"
