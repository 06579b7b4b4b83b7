"""The autoencoder between images and latents: diffusers' AutoencoderKL, behind a space-to-depth.

A small autoencoder keeps more of an image if its first layer loses nothing: the pixels of a block
become channels, and all convolutions run at latent resolution.
"""

import numpy as np
import torch
from diffusers import AutoencoderKL
from torch import Tensor, nn
from torch.nn import functional

NANO_BLOCK = 4


def nano_autoencoder() -> AutoencoderKL:
    """The untrained network of this suite's own autoencoder, over blocks of NANO_BLOCK pixels."""
    values = 3 * NANO_BLOCK**2
    return AutoencoderKL(
        in_channels=values,
        out_channels=values,
        down_block_types=("DownEncoderBlock2D",),
        up_block_types=("UpDecoderBlock2D",),
        block_out_channels=(128,),
        layers_per_block=2,
        latent_channels=8,
        norm_num_groups=16,
        mid_block_add_attention=False,
    )


class Autoencoder(nn.Module):
    """Images to normalised latents and back.

    `shift` and `scale` make latents zero-mean with unit variance per channel, as the diffusion
    process assumes; `fit_statistics` measures them.

    Args:
        network: of blocks of pixels.
        block: side of the blocks that become channels, lossless; 1 for public networks.
    """

    def __init__(self, network: AutoencoderKL, block: int = 1) -> None:
        super().__init__()
        self.network, self.block = network, block
        shape = 1, network.config.latent_channels, 1, 1
        self.register_buffer("shift", torch.zeros(shape))
        self.register_buffer("scale", torch.ones(shape))

    @property
    def factor(self) -> int:
        """Pixels of an image per latent pixel, each way."""
        return self.block * 2 ** (len(self.network.config.block_out_channels) - 1)

    @property
    def latent_channels(self) -> int:
        """Channels of a latent."""
        return self.shift.shape[1]

    def posterior(self, images: Tensor) -> torch.distributions.Distribution:
        """Diagonal Gaussian over raw latents of [B, 3, H, W] images in [0, 1]."""
        blocks = functional.pixel_unshuffle(images * 2 - 1, self.block)
        return self.network.encode(blocks).latent_dist

    def encode(
        self,
        images: Tensor,  # [B, 3, H, W] in [0, 1]
    ) -> Tensor:
        """[B, C, H / factor, W / factor] normalised latents, the posterior's mean."""
        return (self.posterior(images).mean - self.shift) / self.scale

    def decode(
        self,
        latents: Tensor,  # [B, C, h, w]
    ) -> Tensor:
        """[B, 3, h * factor, w * factor] images, in [0, 1] but for overshoots."""
        return self.decode_raw(latents * self.scale + self.shift)

    def decode_raw(self, latents: Tensor) -> Tensor:
        """Decode latents as the network has them, before normalisation."""
        blocks = self.network.decode(latents).sample
        return (functional.pixel_shuffle(blocks, self.block) + 1) / 2

    @torch.no_grad()
    def fit_statistics(
        self,
        images: Tensor,  # [B, 3, H, W] in [0, 1]
    ) -> None:
        """Measure `shift` and `scale` on images."""
        raw = self.posterior(images).mean
        self.shift.copy_(raw.mean(dim=(0, 2, 3), keepdim=True))
        self.scale.copy_(raw.std(dim=(0, 2, 3), keepdim=True))


def to_tensor(
    images: np.ndarray,  # [B, H, W, 3] uint8 or float in [0, 1]
) -> Tensor:
    """[B, 3, H, W] float32 in [0, 1]."""
    scale = 255.0 if images.dtype == np.uint8 else 1.0
    return torch.from_numpy(np.ascontiguousarray(images.transpose(0, 3, 1, 2))).float() / scale


def to_arrays(
    images: Tensor,  # [B, 3, H, W]
) -> np.ndarray:
    """(B, H, W, 3) float32 clipped to [0, 1]."""
    return images.float().clamp(0, 1).permute(0, 2, 3, 1).cpu().numpy()
