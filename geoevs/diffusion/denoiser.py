"""The denoiser: a UNet that sees [z_t, c], and a null condition for guidance (section 3.3)."""

import torch
from diffusers import UNet2DConditionModel
from torch import Tensor, nn

from geoevs.diffusion.condition_encoder import ConditionEncoder


def nano_unet(latent_channels: int) -> UNet2DConditionModel:
    """The untrained UNet of this suite's own prior, in the layout of Stable Diffusion's.

    Only its lowest resolution attends, also to the one token in a text prompt's place.
    """
    return UNet2DConditionModel(
        in_channels=latent_channels,
        out_channels=latent_channels,
        block_out_channels=(64, 96, 128),
        layers_per_block=1,
        norm_num_groups=16,
        down_block_types=("DownBlock2D", "DownBlock2D", "CrossAttnDownBlock2D"),
        up_block_types=("CrossAttnUpBlock2D", "UpBlock2D", "UpBlock2D"),
        mid_block_type="UNetMidBlock2DCrossAttn",
        cross_attention_dim=32,
        attention_head_dim=4,  # diffusers' name for the number of heads
    )


class Denoiser(nn.Module):
    """Predicts from [z_t, c] and t what the schedule asks for: noise, velocity or the clean latent.

    The null condition and the token in a text prompt's place are learned.

    Args:
        unet: reads the latents' channels, then the encoder's (see `conditioned`).
        encoder: E_geo, or None for an unconditional prior.
        prediction: one of `diffusion.PREDICTIONS`. Where that is the clean latent and the encoder
            has the condition's own, the UNet predicts what that lacks.
    """

    def __init__(
        self,
        unet: UNet2DConditionModel,
        encoder: nn.Module | None,
        prediction: str = "v_prediction",
    ) -> None:
        super().__init__()
        self.unet, self.encoder = unet, encoder
        self.residual = isinstance(encoder, ConditionEncoder) and prediction == "sample"
        self.prompt = nn.Parameter(torch.zeros(1, 1, unet.config.cross_attention_dim))
        if encoder is not None:
            self.null = nn.Parameter(torch.zeros(1, encoder.channels, 1, 1))

    def features(
        self,
        condition: Tensor,  # [B, 3, H, W] in [0, 1]
        valid: Tensor,  # [B, 1, H, W] bool
        dropped: Tensor | None = None,  # [B] bool
        latent: Tensor | None = None,  # [B, L, h, w] the encoder's `latent`, if it is known
    ) -> Tensor:
        """[B, C, h, w] condition features; the null condition for the dropped samples."""
        features = self.encoder(condition, valid, latent)
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
        inputs = noisy if features is None else torch.cat([noisy, features.to(noisy.dtype)], dim=1)
        prompt = self.prompt.expand(len(noisy), -1, -1)
        predicted = self.unet(inputs, timesteps, encoder_hidden_states=prompt).sample
        return predicted + features[:, : noisy.shape[1]] if self.residual else predicted


def conditioned(prior: Denoiser, encoder: nn.Module, prediction: str = "v_prediction") -> Denoiser:
    """A denoiser of [z_t, c] that takes over an unconditional one's parts.

    It starts as the unconditional one; or, if it predicts residuals, as the condition's own latent.
    Then the UNet's first layer reads that latent as the prior reads its own, and other features at
    random: were they zero too, beside a last layer of zeros, nothing would be learned for long.
    """
    denoiser = Denoiser(prior.unet, encoder, prediction)
    denoiser.prompt = prior.prompt
    widen(prior.unet, encoder.channels, zero=not denoiser.residual)
    if denoiser.residual:
        start_from_latent(prior.unet)
    return denoiser


@torch.no_grad()
def start_from_latent(unet: UNet2DConditionModel) -> None:
    """Let a widened UNet read the condition's latent as it reads its own, and add nothing yet."""
    latents = unet.config.out_channels
    weight = unet.conv_in.weight
    weight[:, latents : 2 * latents] = weight[:, :latents]
    unet.conv_out.weight.zero_()
    unet.conv_out.bias.zero_()


def widen(unet: UNet2DConditionModel, channels: int, zero: bool) -> None:
    """Let a UNet's first layer read `channels` more, by weights that are zero or random."""
    old = unet.conv_in
    new = nn.Conv2d(
        old.in_channels + channels, old.out_channels, old.kernel_size, padding=old.padding
    )
    with torch.no_grad():
        if zero:
            new.weight.zero_()
        new.weight[:, : old.in_channels] = old.weight
        new.bias.copy_(old.bias)
    unet.conv_in = new
    unet.register_to_config(in_channels=new.in_channels)
