"""The denoiser: a UNet that sees [z_t, c], with a null condition for guidance (paper section 3.3)."""

from dataclasses import dataclass

import torch
from diffusers import UNet2DConditionModel
from torch import Tensor, nn


@dataclass(frozen=True)
class DenoiserConfig:
    """Shape of the UNet; the defaults are the nano one that this suite pretrains.

    Args:
        channels: of the convolutions at each resolution.
        layers: residual blocks at each resolution.
        groups: of the group normalisation.
        head: channels of an attention head; only the lowest resolution attends.
        context: channels of the token that stands in for a text prompt.
    """

    channels: tuple[int, ...] = (64, 96, 128)
    layers: int = 1
    groups: int = 16
    head: int = 32
    context: int = 32


def build_unet(config: DenoiserConfig, latent_channels: int) -> UNet2DConditionModel:
    """An unconditional UNet over latents, in the layout of Stable Diffusion's."""
    plain = len(config.channels) - 1
    return UNet2DConditionModel(
        in_channels=latent_channels,
        out_channels=latent_channels,
        block_out_channels=config.channels,
        layers_per_block=config.layers,
        norm_num_groups=config.groups,
        down_block_types=("DownBlock2D",) * plain + ("CrossAttnDownBlock2D",),
        up_block_types=("CrossAttnUpBlock2D",) + ("UpBlock2D",) * plain,
        mid_block_type="UNetMidBlock2DCrossAttn",
        cross_attention_dim=config.context,
        attention_head_dim=config.channels[-1] // config.head,
    )


class Denoiser(nn.Module):
    """Predicts from [z_t, c] and t what the schedule asks for: noise, velocity or the clean latent.

    The UNet keeps the weights that it had without a condition; its first layer is widened by
    zeros, so that training starts from the prior. The null condition and the token in the prompt's
    place are learned.

    Args:
        unet: over the latents alone.
        encoder: E_geo, or None for an unconditional prior.
    """

    def __init__(self, unet: UNet2DConditionModel, encoder: nn.Module | None) -> None:
        super().__init__()
        self.unet, self.encoder = unet, encoder
        self.prompt = nn.Parameter(torch.zeros(1, 1, unet.config.cross_attention_dim))
        if encoder is not None:
            _widen(unet, encoder.channels)
            self.null = nn.Parameter(torch.zeros(1, encoder.channels, 1, 1))

    def features(
        self,
        condition: Tensor,  # [B, 3, H, W] in [0, 1]
        valid: Tensor,  # [B, 1, H, W] bool
        dropped: Tensor | None = None,  # [B] bool
    ) -> Tensor:
        """[B, C, h, w] condition features; the null condition for the dropped samples."""
        features = self.encoder(condition, valid)
        if dropped is None:
            return features
        return torch.where(dropped[:, None, None, None], self.null.to(features.dtype), features)

    def forward(
        self,
        noisy: Tensor,  # [B, L, h, w]
        timesteps: Tensor,  # [B] int64
        features: Tensor | None = None,  # [B, C, h, w]
    ) -> Tensor:
        """[B, L, h, w] the prediction."""
        seen = noisy if features is None else torch.cat([noisy, features.to(noisy.dtype)], dim=1)
        prompt = self.prompt.expand(len(noisy), -1, -1)
        return self.unet(seen, timesteps, encoder_hidden_states=prompt).sample


def _widen(unet: UNet2DConditionModel, channels: int) -> None:
    """Let the UNet's first layer read `channels` more, which change nothing at first."""
    old = unet.conv_in
    new = nn.Conv2d(
        old.in_channels + channels, old.out_channels, old.kernel_size, padding=old.padding
    )
    with torch.no_grad():
        new.weight.zero_()
        new.weight[:, : old.in_channels] = old.weight
        new.bias.copy_(old.bias)
    unet.conv_in = new
    unet.register_to_config(in_channels=new.in_channels)
