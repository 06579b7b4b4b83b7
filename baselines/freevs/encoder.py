"""The condition encoder: a small ConvNeXt from pseudo-images to latent channels."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from geoevs.diffusion.autoencoder import Autoencoder
from geoevs.diffusion.push_pull import push_pull


class ConvNextBlock(nn.Module):
    """A block of Liu et al., A ConvNet for the 2020s (2022): 7 x 7 per channel, then a wide MLP."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.across = nn.Conv2d(width, width, 7, padding=3, groups=width)
        self.norm = nn.LayerNorm(width)
        self.layers = nn.Sequential(
            nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width)
        )

    def forward(
        self,
        features: Tensor,  # [B, C, h, w]
    ) -> Tensor:
        """Add the block's correction to the features; the shape stays."""
        hidden = self.norm(self.across(features).movedim(1, -1))
        return features + self.layers(hidden).movedim(-1, 1)


class PseudoImageEncoder(nn.Module):
    """A learned correction of a pseudo-image's latent, zero before the first step.

    Args:
        factor: pixels per latent pixel each way; the stem reads blocks of them, so that all that
            follows is at latent resolution.
        channels: of the latents.
        width: of the blocks.
        depth: their number.
    """

    def __init__(self, factor: int, channels: int, width: int = 96, depth: int = 4) -> None:
        super().__init__()
        self.factor, self.channels, self.width, self.depth = factor, channels, width, depth
        self.stem = nn.Conv2d(4, width, factor, stride=factor)
        self.blocks = nn.Sequential(*(ConvNextBlock(width) for _ in range(depth)))
        self.norm = nn.GroupNorm(1, width)
        self.head = nn.Conv2d(width, channels, 1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(
        self,
        images: Tensor,  # [B, 3, H, W] in [0, 1]
        valid: Tensor,  # [B, 1, H, W] bool
    ) -> Tensor:
        """[B, channels, H / factor, W / factor] correction of pseudo-images' latents."""
        occupied = valid.to(images.dtype)
        inputs = torch.cat([(images * 2 - 1) * occupied, occupied], dim=1)
        return self.head(functional.gelu(self.norm(self.blocks(self.stem(inputs)))))


@torch.no_grad()
def filled_latents(
    autoencoder: Autoencoder,
    images: Tensor,  # [B, 3, H, W] in [0, 1], zero where invalid
    valid: Tensor,  # [B, 1, H, W] bool
) -> Tensor:
    """[B, L, h, w] latents of pseudo-images whose holes are filled smoothly."""
    return autoencoder.encode(push_pull(images, valid)).float()
