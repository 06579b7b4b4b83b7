"""E_geo: from a condition map to condition features at latent resolution (paper section 3.3)."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from geoevs.generator.autoencoder import Autoencoder


class ConditionEncoder(nn.Module):
    """A small encoder trained with the denoiser; its first step, space-to-depth, loses nothing.

    Args:
        factor: pixels per latent pixel, each way.
        channels: of the features.
        validity: whether the mask beside the condition map is encoded too; without it holes are
            black, as in the paper, and so are some surfaces.
    """

    def __init__(self, factor: int, channels: int = 24, validity: bool = True) -> None:
        super().__init__()
        self.factor, self.channels, self.validity = factor, channels, validity
        values = (3 + validity) * factor**2
        self.layers = nn.Sequential(
            nn.Conv2d(values, 96, 1),
            nn.SiLU(),
            nn.Conv2d(96, 64, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(64, channels, 3, padding=1),
        )

    def forward(
        self,
        condition: Tensor,  # [B, 3, H, W] in [0, 1], zero where invalid
        valid: Tensor,  # [B, 1, H, W] bool
    ) -> Tensor:
        """[B, channels, H / factor, W / factor] features."""
        shown = condition * 2 - 1
        if self.validity:
            mask = valid.to(shown.dtype)
            shown = torch.cat([shown * mask, mask], dim=1)
        return self.layers(functional.pixel_unshuffle(shown, self.factor))


class FrozenEncoder(nn.Module):
    """The other reading of E_geo: the frozen autoencoder's own code of the zero-filled map."""

    def __init__(self, autoencoder: Autoencoder) -> None:
        super().__init__()
        self._autoencoder = (autoencoder,)  # in a tuple, so that it is no part of this module
        self.channels = autoencoder.latent_channels + 1

    @torch.no_grad()
    def forward(
        self,
        condition: Tensor,  # [B, 3, H, W] in [0, 1], zero where invalid
        valid: Tensor,  # [B, 1, H, W] bool
    ) -> Tensor:
        """[B, latent channels + 1, h, w] latents, and the share of valid pixels."""
        (autoencoder,) = self._autoencoder
        share = functional.avg_pool2d(valid.to(condition.dtype), autoencoder.factor)
        return torch.cat([autoencoder.encode(condition), share], dim=1)
