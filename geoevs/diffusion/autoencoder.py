"""The autoencoder between images and latents: diffusers' AutoencoderKL, behind a space-to-depth.

A small autoencoder keeps more of an image if its first layer loses nothing: the pixels of a block
become channels, and all convolutions run at latent resolution.
"""

import numpy as np
import torch
from diffusers import AutoencoderKL
from diffusers.models.autoencoders.vae import DiagonalGaussianDistribution
from torch import Tensor, nn
from torch.nn import functional

from geoevs.core.errors import GeoEvsError

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
        latent_channels=12,  # with 8, one axis of colour is lost: green cars turn grey
        norm_num_groups=16,
        mid_block_add_attention=False,
    )


class Autoencoder(nn.Module):
    """A code of images: it encodes them as normalised latents, and decodes these.

    Over blocks of pixels a linear code stands beside the network, which only adds to it: the
    principal components of the blocks (`fit_linear`) already keep more than a small network learns
    in many minutes. `shift` and `scale` make latents zero-mean with unit variance per channel, as
    the diffusion process assumes; `fit_statistics` measures them.

    Args:
        network: of blocks of pixels.
        block: side of the blocks that become channels, lossless; 1 for public networks, which have
            no linear code.
    """

    def __init__(self, network: AutoencoderKL, block: int = 1) -> None:
        super().__init__()
        self.network, self.block = network, block
        channels = network.config.latent_channels
        self.register_buffer("shift", torch.zeros(1, channels, 1, 1))
        self.register_buffer("scale", torch.ones(1, channels, 1, 1))
        self.linear = LinearCode(3 * block**2, channels) if block > 1 else None

    @property
    def factor(self) -> int:
        """Pixels of an image per latent pixel, each way."""
        return self.block * 2 ** (len(self.network.config.block_out_channels) - 1)

    @property
    def latent_channels(self) -> int:
        """The number of channels that a latent has."""
        return self.shift.shape[1]

    def posterior(
        self,
        images: Tensor,  # [B, 3, H, W] in [0, 1]
    ) -> DiagonalGaussianDistribution:
        """Distribution of latents before normalisation.

        Raises:
            GeoEvsError: the images do not divide into latents.
        """
        blocks = self._blocks(images)
        posterior = self.network.encode(blocks).latent_dist
        if self.linear is None:
            return posterior
        moments = torch.cat([posterior.mean + self.linear.encode(blocks), posterior.logvar], dim=1)
        return DiagonalGaussianDistribution(moments)

    def encode(
        self,
        images: Tensor,  # [B, 3, H, W] in [0, 1]
    ) -> Tensor:
        """[B, C, H / factor, W / factor] normalised latents, the posterior's mean.

        Raises:
            GeoEvsError: the images do not divide into latents.
        """
        return (self.posterior(images).mean - self.shift) / self.scale

    def decode(
        self,
        latents: Tensor,  # [B, C, h, w]
    ) -> Tensor:
        """[B, 3, h * factor, w * factor] images, in [0, 1] but for overshoots."""
        return self.decode_raw(latents * self.scale + self.shift)

    def decode_raw(self, latents: Tensor) -> Tensor:
        """Decode latents that are not normalised."""
        blocks = self.network.decode(latents).sample
        if self.linear is not None:
            blocks = blocks + self.linear.decode(latents)
        return (functional.pixel_shuffle(blocks, self.block) + 1) / 2

    @torch.no_grad()
    def fit_linear(
        self,
        images: Tensor,  # [B, 3, H, W] in [0, 1]
    ) -> None:
        """Set the linear code to the blocks' principal components; the network adds nothing yet.

        Raises:
            GeoEvsError: the images do not divide into latents.
        """
        blocks = self._blocks(images)
        self.linear.fit(blocks.movedim(1, -1).flatten(0, -2))
        mean, _ = self.network.quant_conv.weight.chunk(2)
        for weight in (mean, self.network.decoder.conv_out.weight):
            weight.zero_()
        mean, _ = self.network.quant_conv.bias.chunk(2)
        for bias in (mean, self.network.decoder.conv_out.bias):
            bias.zero_()

    @torch.no_grad()
    def fit_statistics(
        self,
        images: Tensor,  # [B, 3, H, W] in [0, 1]
    ) -> None:
        """Measure `shift` and `scale` on images."""
        raw = self.posterior(images).mean
        self.shift.copy_(raw.mean(dim=(0, 2, 3), keepdim=True))
        self.scale.copy_(raw.std(dim=(0, 2, 3), keepdim=True))

    def _blocks(self, images: Tensor) -> Tensor:
        """[B, 3 block^2, H / block, W / block] in [-1, 1] of [B, 3, H, W] in [0, 1]."""
        height, width = images.shape[2:]
        if height % self.factor or width % self.factor:
            raise GeoEvsError(
                f"images of {height} x {width} do not divide into latents; choose sides that are "
                f"multiples of {self.factor}"
            )
        return functional.pixel_unshuffle(images * 2 - 1, self.block)


class LinearCode(nn.Module):
    """Blocks of pixels to a few numbers and back, each by one matrix; trained on with the network.

    Args:
        values: of a block.
        channels: of its code.
    """

    def __init__(self, values: int, channels: int) -> None:
        super().__init__()
        self.down = nn.Conv2d(values, channels, 1)
        self.up = nn.Conv2d(channels, values, 1)

    def encode(self, blocks: Tensor) -> Tensor:
        """[B, channels, h, w] code of [B, values, h, w] blocks."""
        return self.down(blocks)

    def decode(self, code: Tensor) -> Tensor:
        """[B, values, h, w] blocks of a [B, channels, h, w] code."""
        return self.up(code)

    def fit(
        self,
        blocks: Tensor,  # [N, values]
    ) -> None:
        """Take the blocks' principal components: no linear code of this size loses less."""
        mean = blocks.mean(dim=0)
        covariance = torch.cov((blocks - mean).double().T)
        axes = torch.linalg.eigh(covariance).eigenvectors.flip(1)[:, : self.down.out_channels]
        axes = axes.to(blocks.dtype)
        self.down.weight.copy_(axes.T[..., None, None])
        self.down.bias.copy_(-(axes.T @ mean))
        self.up.weight.copy_(axes[..., None, None])
        self.up.bias.copy_(mean)


def to_tensor(
    images: np.ndarray,  # [B, H, W, 3] uint8 or float in [0, 1]
) -> Tensor:
    """Images as a [B, 3, H, W] float32 tensor in [0, 1]."""
    scale = 255.0 if images.dtype == np.uint8 else 1.0
    return torch.from_numpy(np.ascontiguousarray(images.transpose(0, 3, 1, 2))).float() / scale


def to_conditions(
    images: np.ndarray,  # [B, H, W, 3] float32 in [0, 1], zero where invalid
    valid: np.ndarray,  # [B, H, W] bool
    autoencoder: Autoencoder,
) -> tuple[Tensor, Tensor]:
    """Condition maps of any size as tensors that divide into latents, on the network's device.

    Returns:
        [B, 3, H', W'] maps and [B, 1, H', W'] bool validity, with pixels without support added
        below and to the right.
    """
    device, factor = autoencoder.shift.device, autoencoder.factor
    height, width = valid.shape[1:]
    padding = (0, -width % factor, 0, -height % factor)
    mask = torch.from_numpy(valid)[:, None]
    return tuple(functional.pad(part, padding).to(device) for part in (to_tensor(images), mask))


def to_arrays(
    images: Tensor,  # [B, 3, H, W]
) -> np.ndarray:
    """Images as a (B, H, W, 3) float32 array, clipped to [0, 1]."""
    return images.float().clamp(0, 1).permute(0, 2, 3, 1).cpu().numpy()
