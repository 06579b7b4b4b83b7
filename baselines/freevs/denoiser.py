"""The denoiser of clips: the prior's UNet with layers over time, preconditioned as in EDM."""

from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
import torch
from diffusers import UNet2DConditionModel
from torch import Tensor, nn
from torch.nn import functional

from baselines.freevs.encoder import PseudoImageEncoder
from geoevs.diffusion.denoiser import start_from_latent, widen
from geoevs.diffusion.prior import Prior
from geoevs.diffusion.process import Diffusion


class TemporalResnet(nn.Module):
    """A UNet's residual block, and one over the frames of a clip behind it.

    Args:
        spatial: the block, with its weights.
        channels: that it gives.
        frames: of a clip; they follow one another in the batch.
    """

    def __init__(self, spatial: nn.Module, channels: int, frames: int) -> None:
        super().__init__()
        self.spatial, self._frames = spatial, frames
        self.norm = nn.GroupNorm(spatial.norm2.num_groups, channels)
        # A convolution over three frames; torch's bfloat16 Conv3d was seen to give NaN gradients.
        self.over_time = nn.Conv2d(3 * channels, channels, 1)
        nn.init.zeros_(self.over_time.weight)  # it starts as the block alone
        nn.init.zeros_(self.over_time.bias)

    def forward(
        self,
        hidden: Tensor,  # [B * frames, C, h, w]
        embedding: Tensor,  # [B * frames, E]
    ) -> Tensor:
        """[B * frames, channels, h, w] features after both blocks."""
        hidden = self.spatial(hidden, embedding)
        clip = functional.silu(self.norm(hidden)).unflatten(0, (-1, self._frames))
        around = functional.pad(clip, (0, 0, 0, 0, 0, 0, 1, 1))
        three = torch.cat([around[:, :-2], clip, around[:, 2:]], dim=2)
        return hidden + self.over_time(three.flatten(0, 1))


class Preconditioning(NamedTuple):
    """Scales of EDM (Karras et al. 2022, table 1), [B, 1, 1, 1] each."""

    skip: Tensor
    out: Tensor
    weight: Tensor
    """Weight of the squared error; with it the network's own target of unit variance counts 1."""

    @classmethod
    def at(
        cls,
        sigma: Tensor,  # [B]
        spread: float,
    ) -> Self:
        """The scales for noise of standard deviation sigma on data of `spread`."""
        noise = sigma[:, None, None, None].square()
        total = noise + spread**2
        out = (noise / total).sqrt() * spread
        return cls(spread**2 / total, out, 1 / out.square())


class ClipDenoiser(nn.Module):
    """The clean latents of clips from noisy ones, D(x; sigma, c) of EDM.

    What is diffused is what the condition's latent c lacks: the network's output is added to c,
    not to zero, so that the prediction is c where the noise leaves nothing to see. The UNet reads
    [x, c], x scaled and the noise told as its prior knew them.

    Args:
        unet: reads twice the latents' channels; layers over time are added to it.
        encoder: of pseudo-images.
        prior: the process the UNet was pretrained on.
        frames: of a clip.
        spread: standard deviation of what c lacks, EDM's sigma_data.
    """

    def __init__(
        self,
        unet: UNet2DConditionModel,
        encoder: PseudoImageEncoder,
        prior: Diffusion,
        frames: int,
        spread: float,
    ) -> None:
        super().__init__()
        self.unet, self.encoder = unet, encoder
        self.prior, self.frames, self.spread = prior, frames, spread
        for block in (*unet.down_blocks, unet.mid_block, *unet.up_blocks):
            for position, resnet in enumerate(block.resnets):
                channels = resnet.conv2.out_channels
                block.resnets[position] = TemporalResnet(resnet, channels, frames)
        self.prompt = nn.Parameter(torch.zeros(1, 1, unet.config.cross_attention_dim))

    @classmethod
    def from_prior(cls, prior: Prior, frames: int, spread: float) -> Self:
        """Take over an unconditional denoiser's parts; the first prediction of pure noise is c."""
        unet, channels = prior.denoiser.unet, prior.autoencoder.latent_channels
        widen(unet, channels, zero=True)
        start_from_latent(unet)
        encoder = PseudoImageEncoder(prior.autoencoder.factor, channels)
        made = cls(unet, encoder, prior.diffusion, frames, spread)
        made.prompt = prior.denoiser.prompt
        return made

    def forward(
        self,
        noisy: Tensor,  # [B * frames, L, h, w]
        sigma: Tensor,  # [B * frames]
        condition: Tensor,  # [B * frames, L, h, w]; zero where dropped
    ) -> Tensor:
        """[B * frames, L, h, w] the clean latents, float32."""
        scales = Preconditioning.at(sigma, self.spread)
        unit = noisy / (1 + sigma[:, None, None, None].square()).sqrt()
        predicted = self.unet(
            torch.cat([unit, condition], dim=1),
            self._timesteps(sigma),
            encoder_hidden_states=self.prompt.expand(len(noisy), -1, -1),
        ).sample.float()
        return condition + scales.skip * (noisy - condition) + scales.out * predicted

    @cached_property
    def _log_sigmas(self) -> np.ndarray:
        """(TIMESTEPS,) the noise of the prior's process, its clean part scaled to one."""
        signal = self.prior.scheduler().alphas_cumprod.double().numpy()
        with np.errstate(divide="ignore"):  # the last one may be noise alone
            return np.log((1 - signal) / signal) / 2

    def _timesteps(self, sigma: Tensor) -> Tensor:
        """[B] float32 when the prior's process has as much noise."""
        wanted = np.log(sigma.double().cpu().numpy())
        place = np.interp(wanted, self._log_sigmas, np.arange(len(self._log_sigmas)))
        return torch.from_numpy(place).to(sigma.device, torch.float32)
