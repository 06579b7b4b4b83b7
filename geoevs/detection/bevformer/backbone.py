"""What makes features of pictures: a small network of this package, or a pretrained one.

All have one interface: `channels`, and pictures (V, 3, H, W) in [0, 1] to features (V, channels,
H / 8, W / 8). Each view is seen by itself, so that features do not depend on what else there is.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from geoevs.core import efficientnet
from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import (
    built_as_described,
    load_weights,
    read_network,
    save_network,
    seeded,
)
from geoevs.core.optimising import fingerprint
from geoevs.detection.bevformer.settings import BACKBONES, GROUPS, STRIDE, Detector
from geoevs.geometry.vggt import VGGT_NANO, Aggregator, load_vggt

BLOCK = 4
"""Side of the blocks of pixels whose values become channels first, so that nothing is lost."""

MIDDLE, WIDTH = 0.45, 0.25
"""What pixels are shifted and divided by."""

ENLARGED = 2
"""EfficientNet sees pictures so many times larger: its places then are small enough for cars."""

REMAKE = "make it with train_backbone, or name another one"


class Cnn(nn.Module):
    """Residual stages at strides 8 and 16, summed from coarse to fine, as an FPN.

    Args:
        channels: of the features.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.channels = channels
        self.stem = nn.Conv2d(3 * BLOCK**2, 48, 3, padding=1)
        self.fine = _stage(48, 64)
        self.coarse = _stage(64, 96)
        self.lateral = nn.ModuleList([nn.Conv2d(64, channels, 1), nn.Conv2d(96, channels, 1)])
        self.out = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, images: Tensor) -> Tensor:
        """(V, channels, H / 8, W / 8) features."""
        blocks = functional.pixel_unshuffle((images - MIDDLE) / WIDTH, BLOCK)
        fine = self.fine(self.stem(blocks))
        coarse = self.lateral[1](self.coarse(fine))
        coarse = functional.interpolate(coarse, fine.shape[-2:])
        return self.out(self.lateral[0](fine) + coarse)


def _stage(before: int, channels: int) -> nn.Sequential:
    return nn.Sequential(_Residual(before, channels, 2), _Residual(channels, channels, 1))


class _Residual(nn.Module):
    def __init__(self, before: int, channels: int, stride: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(before, channels, 3, stride, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        self.norms = nn.ModuleList([nn.GroupNorm(GROUPS, before), nn.GroupNorm(GROUPS, channels)])
        self.skip = nn.Conv2d(before, channels, 1, stride) if stride > 1 else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        y = self.first(functional.relu(self.norms[0](x)))
        return self.skip(x) + self.second(functional.relu(self.norms[1](y)))


class VggtTokens(nn.Module):
    """The last tokens of this suite's depth network, of each view by itself."""

    def __init__(self) -> None:
        super().__init__()
        self.channels = 2 * VGGT_NANO.dim
        self.aggregator = Aggregator(VGGT_NANO)

    def forward(self, images: Tensor) -> Tensor:
        """(V, channels, H / 8, W / 8) tokens, after attention within the view and once more."""
        rows = images.shape[-2] // VGGT_NANO.patch_size
        return self.aggregator(images[:, None])[-1].transpose(1, 2).unflatten(-1, (rows, -1))


class AutoencoderMaps(nn.Module):
    """What this suite's autoencoder has before its latents, averaged over 2 x 2 places."""

    def __init__(self) -> None:
        from geoevs.diffusion.autoencoder import nano_autoencoder  # which takes seconds

        super().__init__()
        network = nano_autoencoder()
        self.block, self.channels = BLOCK, network.config.block_out_channels[-1]
        self.encoder = network.encoder

    def forward(self, images: Tensor) -> Tensor:
        """(V, channels, H / 8, W / 8) features."""
        x = self.encoder.conv_in(functional.pixel_unshuffle(images * 2 - 1, self.block))
        for block in self.encoder.down_blocks:
            x = block(x)
        return functional.avg_pool2d(self.encoder.mid_block(x), STRIDE // self.block)


class EfficientNetMaps(nn.Module):
    """Maps of EfficientNet-Lite0 at three strides, of pictures that are enlarged."""

    LAYERS = (2, 4, 5)
    """Of `efficientnet.LAYERS`: 40 channels at stride 8, 112 at 16 and 192 at 32."""

    def __init__(self) -> None:
        super().__init__()
        self.channels = 40 + 112 + 192

    def forward(self, images: Tensor) -> Tensor:
        """(V, channels, H / 8, W / 8) features, on the device of the pictures."""
        size = images.shape[-2] // STRIDE, images.shape[-1] // STRIDE
        enlarged = functional.interpolate(images.cpu(), scale_factor=ENLARGED, mode="bilinear")
        maps, _ = efficientnet.published()(enlarged)
        parts = [
            functional.interpolate(maps[layer].clone(), size, mode="bilinear", antialias=True)
            for layer in self.LAYERS
        ]
        return torch.cat(parts, dim=1).to(images.device)


KINDS: dict[str, Callable[[], nn.Module]] = {
    "vggt-nano": VggtTokens,
    "autoencoder": AutoencoderMaps,
    "efficientnet": EfficientNetMaps,
}
"""Pretrained ones."""

assert set(BACKBONES) == {"cnn", *KINDS}


class Backbone(nn.Module):
    """A network of one of BACKBONES.

    Args:
        kind: of BACKBONES.
        channels: of the features, where the kind does not fix them.
    """

    def __init__(self, kind: str, channels: int) -> None:
        super().__init__()
        self.kind = kind
        self.network = Cnn(channels) if kind == "cnn" else KINDS[kind]()
        self.channels: int = self.network.channels

    def forward(self, images: Tensor) -> Tensor:  # [V, 3, H, W] in [0, 1]
        """(V, channels, H / 8, W / 8) features."""
        return self.network(images)

    @property
    def settings(self) -> dict[str, Any]:
        """What it was made with."""
        return {"kind": self.kind, "channels": self.channels}

    @property
    def identity(self) -> str:
        """A fingerprint of its weights: features of another one are others."""
        # Averages of weights have 0 where these have -0.
        weights = {name: value + 0 for name, value in self.state_dict().items()}
        return fingerprint(self.kind, *(part for pair in weights.items() for part in pair))


def new_backbone(detector: Detector, seed: int) -> Backbone:
    """An untrained backbone of the kind `cnn`."""
    with seeded(seed, "detector", "backbone"):
        return Backbone("cnn", detector.channels)


def pretrained_backbone(kind: str, weights: Path) -> Backbone:
    """A pretrained network.

    Args:
        kind: of KINDS.
        weights: the folder of this suite's pretrained weights.

    Raises:
        GeoEvsError: its weights are not on this machine.
    """
    try:
        backbone = Backbone(kind, 0)
        if kind == "vggt-nano":
            trained = load_vggt(weights / "vggt-nano.safetensors").aggregator
            backbone.network.aggregator.load_state_dict(trained.state_dict())
        elif kind == "autoencoder":
            from geoevs.diffusion.prior import load_autoencoder

            encoder = load_autoencoder(weights / "autoencoder.safetensors").network.encoder
            backbone.network.encoder.load_state_dict(encoder.state_dict())
        else:
            efficientnet.published()
    except (GeoEvsError, RuntimeError) as error:
        raise GeoEvsError(
            f"the backbone '{kind}' of detectors has no weights here: {error} (the backbone 'cnn' "
            "needs none)"
        ) from error
    return backbone.eval()


def save_backbone(path: Path, backbone: Backbone) -> None:
    """Write a backbone, whole or not at all."""
    save_network(path, backbone, backbone.settings)


def load_backbone(path: Path) -> Backbone:
    """Read what `save_backbone` wrote, on the CPU, in evaluation mode.

    Raises:
        GeoEvsError: the file is missing, damaged, or no backbone.
    """
    settings, weights = read_network(path)
    backbone = described_backbone(path, settings)
    load_weights(backbone, weights, path, REMAKE)
    return backbone.eval()


def described_backbone(path: Path, settings: Any) -> Backbone:
    """A backbone without weights, of what a file says.

    Raises:
        GeoEvsError: the file says something else.
    """
    if not isinstance(settings, dict) or settings.get("kind") not in BACKBONES:
        raise GeoEvsError(f"{path} holds no backbone of a detector; {REMAKE}")
    with built_as_described(path, REMAKE):
        return Backbone(settings["kind"], settings["channels"])
