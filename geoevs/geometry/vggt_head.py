"""The dense prediction head of VGGT (DPT): tokens of four depths to maps of the image's size."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

HIDDEN = 32  # channels of the last hidden layer
POSITION_GAIN = 0.1
POSITION_BASE = 100.0


class DepthHead(nn.Module):
    """Log-depth and confidence of every pixel, as the public checkpoint's `depth_head`.

    Args:
        dim: channels of the tokens it reads.
        channels: of the four levels, the finest first, multiples of 4; the finest has eight times
            the coarsest's resolution.
        features: channels in which they are fused, a multiple of 8.
        initial: what the untrained head gives, about, an output each.
    """

    def __init__(
        self, dim: int, channels: Sequence[int], features: int, initial: Sequence[float]
    ) -> None:
        super().__init__()
        finest, fine, _, coarse = channels
        self.norm = nn.LayerNorm(dim)
        self.projects = nn.ModuleList(nn.Conv2d(dim, count, 1) for count in channels)
        self.resize_layers = nn.ModuleList(
            [
                nn.ConvTranspose2d(finest, finest, 4, 4),
                nn.ConvTranspose2d(fine, fine, 2, 2),
                nn.Identity(),
                nn.Conv2d(coarse, coarse, 3, 2, 1),
            ]
        )
        scratch: dict[str, nn.Module] = {
            f"layer{level}_rn": nn.Conv2d(count, features, 3, padding=1, bias=False)
            for level, count in enumerate(channels, 1)
        }
        scratch |= {f"refinenet{level}": Fusion(features, level < 4) for level in range(1, 5)}
        scratch["output_conv1"] = nn.Conv2d(features, features // 2, 3, padding=1)
        last = nn.Conv2d(HIDDEN, len(initial), 1)
        with torch.no_grad():
            last.bias.copy_(torch.tensor(initial))
        scratch["output_conv2"] = nn.Sequential(
            nn.Conv2d(features // 2, HIDDEN, 3, padding=1), nn.ReLU(), last
        )
        self.scratch = nn.ModuleDict(scratch)

    def forward(
        self,
        tokens: Sequence[Tensor],  # four of [B, h * w, C]
        grid: tuple[int, int],
        size: tuple[int, int],
    ) -> Tensor:
        """Predict log-depth and confidence from the tokens of four blocks.

        Args:
            tokens: the patches' tokens after four of the blocks, earliest first.
            grid: patches down and across, h and w.
            size: height and width of the images.

        Returns:
            (B, outputs, H, W).
        """
        aspect = size[1] / size[0]
        levels = []
        for level, (project, resize) in enumerate(
            zip(self.projects, self.resize_layers, strict=True)
        ):
            image = self.norm(tokens[level]).transpose(1, 2).unflatten(2, grid)
            image = resize(_add_positions(project(image), aspect))
            levels.append(self.scratch[f"layer{level + 1}_rn"](image))
        fused = None
        for level in (4, 3, 2, 1):
            height, width = levels[level - 1].shape[-2:]
            target = levels[level - 2].shape[-2:] if level > 1 else (2 * height, 2 * width)
            fused = self.scratch[f"refinenet{level}"](fused, levels[level - 1], target)
        fused = _resize(self.scratch["output_conv1"](fused), size)
        return self.scratch["output_conv2"](_add_positions(fused, aspect))


class ResidualUnit(nn.Module):
    """Two convolutions, added to the *rectified* input.

    The published code rectifies in place, so that its skip connection carries no negative values.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(features, features, 3, padding=1)
        self.conv2 = nn.Conv2d(features, features, 3, padding=1)

    def forward(self, image: Tensor) -> Tensor:  # [B, C, h, w] to the same
        """Rectify the map, and add the two convolutions of it; the shape (B, C, h, w) stays."""
        image = functional.relu(image)
        return image + self.conv2(functional.relu(self.conv1(image)))


class Fusion(nn.Module):
    """Adds a level to the coarser ones; the coarsest has nothing to be added to."""

    def __init__(self, features: int, has_coarser: bool) -> None:
        super().__init__()
        self.out_conv = nn.Conv2d(features, features, 1)
        if has_coarser:
            self.resConfUnit1 = ResidualUnit(features)
        self.resConfUnit2 = ResidualUnit(features)

    def forward(
        self,
        coarser: Tensor | None,  # [B, C, h, w]
        level: Tensor,  # [B, C, h, w]
        size: tuple[int, int],
    ) -> Tensor:
        """(B, C, *size) map: the level, added to the coarser ones and resized."""
        if coarser is not None:
            level = coarser + self.resConfUnit1(level)
        # Published the other way round; weights that sum to 1 commute with a 1 x 1 convolution,
        # and this order has a quarter of the products.
        return _resize(self.out_conv(self.resConfUnit2(level)), size)


def _resize(image: Tensor, size: tuple[int, int]) -> Tensor:
    if tuple(image.shape[-2:]) == tuple(size):
        return image
    return functional.interpolate(image, size, mode="bilinear", align_corners=True)


def _add_positions(
    image: Tensor,  # [B, C, h, w]
    aspect: float,
) -> Tensor:
    """Add sines and cosines of the pixels' places, in units of half the image's diagonal.

    The first half of the channels tells of the column, the second of the row.
    """
    channels, height, width = image.shape[1:]
    quarter = channels // 4
    frequencies = POSITION_BASE ** -(
        torch.arange(quarter, device=image.device, dtype=torch.float64) / quarter
    )
    waves = []
    for count, span in ((width, aspect), (height, 1.0)):
        reach = span / math.hypot(aspect, 1.0) * (count - 1) / count
        places = torch.linspace(-reach, reach, count, device=image.device, dtype=torch.float64)
        angles = frequencies[:, None] * places
        waves.append(torch.cat([angles.sin(), angles.cos()]).to(image.dtype) * POSITION_GAIN)
    across, down = waves
    across = across[:, None, :].expand(-1, height, -1)
    return image + torch.cat([across, down[:, :, None].expand(-1, -1, width)])
