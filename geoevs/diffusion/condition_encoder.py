"""E_geo: from a condition map to condition features at latent resolution (paper section 3.3)."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from geoevs.diffusion.autoencoder import Autoencoder
from geoevs.diffusion.push_pull import push_pull


class ConditionEncoder(nn.Module):
    """A small encoder trained with the denoiser, beside the condition map's latent.

    The frozen autoencoder's own code of a map with black holes loses even what surrounds them; of
    a map whose holes are filled smoothly it is the target's latent already wherever the map is
    right. The trained part sees what was there: its first step, space-to-depth, loses nothing.

    Args:
        autoencoder: frozen, and no part of this module.
        channels: of the trained features, which follow the latent's.
        validity: whether the mask beside the condition map is encoded too; without it holes are
            black, as in the paper, and so are some surfaces.
        filled: whether the latent is that of the map with its holes filled, or left black.
    """

    def __init__(
        self,
        autoencoder: Autoencoder,
        channels: int = 24,
        validity: bool = True,
        filled: bool = True,
    ) -> None:
        super().__init__()
        self._autoencoder = (autoencoder,)  # in a tuple, so that it is no part of this module
        self.latent_channels = autoencoder.latent_channels
        self.trained_channels, self.validity, self.filled = channels, validity, filled
        self.channels = self.latent_channels + channels
        values = (3 + validity) * autoencoder.factor**2
        self.layers = nn.Sequential(
            nn.Conv2d(values, 96, 1),
            nn.SiLU(),
            nn.Conv2d(96, 64, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(64, channels, 3, padding=1),
        )

    @torch.no_grad()
    def latent(
        self,
        condition: Tensor,  # [B, 3, H, W] in [0, 1], zero where invalid
        valid: Tensor,  # [B, 1, H, W] bool
    ) -> Tensor:
        """[B, latent_channels, H / factor, W / factor]: the part that no training changes."""
        (autoencoder,) = self._autoencoder
        return autoencoder.encode(push_pull(condition, valid) if self.filled else condition)

    def forward(
        self,
        condition: Tensor,  # [B, 3, H, W] in [0, 1], zero where invalid
        valid: Tensor,  # [B, 1, H, W] bool
        latent: Tensor | None = None,  # what `latent` gave for them, if it is known
    ) -> Tensor:
        """[B, channels, H / factor, W / factor]: latents, then trained features."""
        (autoencoder,) = self._autoencoder
        if latent is None:
            latent = self.latent(condition, valid)
        shown = condition * 2 - 1
        if self.validity:
            mask = valid.to(shown.dtype)
            shown = torch.cat([shown * mask, mask], dim=1)
        trained = self.layers(functional.pixel_unshuffle(shown, autoencoder.factor))
        return torch.cat([latent.to(trained.dtype), trained], dim=1)


class FrozenEncoder(nn.Module):
    """The other reading of E_geo: the frozen autoencoder's own code of the zero-filled map."""

    latent_channels = 0  # none that an image's latent could start from

    def __init__(self, autoencoder: Autoencoder) -> None:
        super().__init__()
        self._autoencoder = (autoencoder,)  # in a tuple, so that it is no part of this module
        self.channels = autoencoder.latent_channels + 1

    @torch.no_grad()
    def latent(self, condition: Tensor, valid: Tensor) -> Tensor:
        """[B, latent channels, h, w] of [B, 3, H, W] and [B, 1, H, W]."""
        (autoencoder,) = self._autoencoder
        return autoencoder.encode(condition)

    @torch.no_grad()
    def forward(
        self,
        condition: Tensor,  # [B, 3, H, W] in [0, 1], zero where invalid
        valid: Tensor,  # [B, 1, H, W] bool
        latent: Tensor | None = None,  # what `latent` gave for them, if it is known
    ) -> Tensor:
        """[B, latent channels + 1, h, w] latents, and the share of valid pixels."""
        (autoencoder,) = self._autoencoder
        if latent is None:
            latent = self.latent(condition, valid)
        share = functional.avg_pool2d(valid.to(condition.dtype), autoencoder.factor)
        return torch.cat([latent, share], dim=1)
