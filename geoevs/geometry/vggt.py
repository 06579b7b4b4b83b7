"""VGGT: depth of all views of a frame, jointly, from their images alone (paper section 3.2).

One network from a few million parameters, trained here, to the 1.2 billion of the public weights
(github.com/facebookresearch/vggt), of which the parts that predict depth are kept.
"""

import dataclasses
import math
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import whole_file
from geoevs.core.networks import load_weights, read_network, save_network
from geoevs.geometry.network_input import Window, public_input
from geoevs.geometry.refinement import DepthRefiner
from geoevs.geometry.vggt_head import DepthHead
from geoevs.geometry.vggt_layers import Block, DinoEncoder, PatchEmbedding, rotary_tables
from geoevs.scenes.camera import Camera

# Of the images' colours, as DINOv2 was trained.
COLOUR_MEAN = (0.485, 0.456, 0.406)
COLOUR_STD = (0.229, 0.224, 0.225)

# Metres: what an untrained network says everywhere, about the median depth of a street.
INITIAL_DEPTH = 10.0

# Of the public checkpoint: heads for other quantities, and a token of DINOv2's own training.
UNUSED = ("camera_head.", "point_head.", "track_head.", "aggregator.patch_embed.mask_token")


@dataclass(frozen=True)
class VggtConfig:
    """Sizes of a VGGT.

    Args:
        patch_size: pixels a side of a patch; images are multiples of it.
        dim: channels of a token.
        depth: pairs of frame and global attention.
        heads: of every attention.
        registers: register tokens of a view.
        layer_scale: initial gain of every residual branch.
        dino_depth: blocks of the DINOv2 encoder that embeds the patches; 0 is one linear map.
        dino_grid: patches a side of its learned positions.
        head_layers: the four pairs whose tokens the depth head reads.
        head_channels: channels of its levels, the finest first, multiples of 4.
        head_features: channels in which it fuses them, a multiple of 8.
        refiner: channels of the levels of what refines its depth by LiDAR (see `DepthRefiner`);
            none has no such part, as published.
        longest: pixels of the longer side of the images that it is trained on; larger ones are
            shown to it at this size, which is right sooner and in a fraction of the time. A public
            network is shown smaller ones enlarged to it, too (see `shown`).
    """

    patch_size: int
    dim: int
    depth: int
    heads: int
    head_layers: tuple[int, int, int, int]
    head_channels: tuple[int, int, int, int]
    head_features: int
    registers: int = 4
    layer_scale: float = 0.01
    dino_depth: int = 0
    dino_grid: int = 37
    refiner: tuple[int, ...] = ()
    longest: int = 192

    @property
    def public(self) -> bool:
        """Whether it is built as the published ones are, on DINOv2's encoder."""
        return self.dino_depth > 0

    def nearest_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width that divide into patches, in about this ratio, up to `longest`."""
        patch, scale = self.patch_size, min(1.0, self.longest / max(height, width))
        rows, columns = (max(1, round(scale * side / patch)) for side in (height, width))
        return rows * patch, columns * patch

    def shown(
        self,
        images: Sequence[np.ndarray],  # each [H, W, 3] uint8, or float32 in [0, 1]
        cameras: Sequence[Camera],
    ) -> tuple[np.ndarray, list[Window]]:
        """The views of a frame as the network was trained to see them.

        A public network, and one that was fine-tuned from it, sees what its own loader makes of
        the recorded images (see `public_input`). The suite's own sees the run's images.

        Returns:
            (V, h, w, 3) in the images' own type, and where each view lies in it.
        """
        if self.public:
            return public_input(images, cameras, self.longest, self.patch_size)
        shown = [resize_image(image, self.nearest_size(*image.shape[:2])) for image in images]
        return np.stack(shown), [(slice(None), slice(None))] * len(shown)


# At the published gain of 0.01 the loss of so few blocks rose before it fell (Adam at 1e-3).
VGGT_NANO = VggtConfig(
    patch_size=8,
    dim=192,
    depth=4,
    heads=3,
    head_layers=(0, 1, 2, 3),
    head_channels=(32, 48, 64, 64),
    head_features=32,
    layer_scale=0.1,
)
VGGT_1B = VggtConfig(
    patch_size=14,
    dim=1024,
    depth=24,
    heads=16,
    head_layers=(4, 11, 17, 23),
    head_channels=(256, 512, 1024, 1024),
    head_features=256,
    dino_depth=24,
    longest=518,
)


def resize_image(
    image: np.ndarray,  # [H, W, 3] uint8 or float
    size: tuple[int, int],
) -> np.ndarray:
    """(h, w, 3) the image at height and width `size`, in its own type."""
    shrinks = size[0] < image.shape[0] or size[1] < image.shape[1]
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR  # the former does not alias
    return cv2.resize(image, size[::-1], interpolation=interpolation)


class DepthPrediction(NamedTuple):
    """Depth of every pixel, and how sure it is."""

    depth: Tensor  # [B, V, H, W] positive; metres where trained on metres
    confidence: Tensor  # [B, V, H, W] at least 1


class Vggt(nn.Module):
    """The network. Initial weights come from torch's global generator; see `new_vggt`."""

    def __init__(self, config: VggtConfig) -> None:
        super().__init__()
        self.config = config
        self.aggregator = Aggregator(config)
        self.depth_head = DepthHead(
            2 * config.dim,
            config.head_channels,
            config.head_features,
            initial=(math.log(INITIAL_DEPTH), 0.0),
        )
        self.refiner = DepthRefiner(config.refiner) if config.refiner else None

    def set_refiner(self, refiner: DepthRefiner, channels: tuple[int, ...]) -> None:
        """Give it a trained refiner of these channels, which is stored with it."""
        self.refiner = refiner
        self.config = dataclasses.replace(self.config, refiner=channels)

    def forward(self, images: Tensor) -> DepthPrediction:  # [B, V, 3, H, W] in [0, 1]
        """Predict the depth of views that see one scene at one time.

        Args:
            images: of B scenes with V views each; the first view's tokens differ from the others'.

        Returns:
            Depth and confidence, (B, V, H, W).

        Raises:
            GeoEvsError: height or width is no multiple of the patch size.
        """
        height, width = size = images.shape[-2:]
        patch = self.config.patch_size
        if height % patch or width % patch:
            nearest = self.config.nearest_size(height, width)
            raise GeoEvsError(
                f"images of {height} x {width} do not divide into patches of {patch} x {patch}; "
                f"resize them to {nearest[0]} x {nearest[1]}"
            )
        tokens = self.aggregator(images)
        out = self.depth_head(tokens, (height // patch, width // patch), size)
        log_depth, log_excess = out.unflatten(0, images.shape[:2]).unbind(2)
        return DepthPrediction(log_depth.exp(), 1 + log_excess.exp())


class Aggregator(nn.Module):
    """Attention in turn within every view and over all views of a scene."""

    def __init__(self, config: VggtConfig) -> None:
        super().__init__()
        self.config = config
        dim, heads = config.dim, config.heads
        if config.dino_depth:
            self.patch_embed = DinoEncoder(
                config.patch_size,
                dim,
                config.dino_depth,
                heads,
                config.registers,
                config.dino_grid,
            )
        else:
            self.patch_embed = PatchEmbedding(config.patch_size, dim)
        self.frame_blocks = nn.ModuleList(
            Block(dim, heads, config.layer_scale) for _ in range(config.depth)
        )
        self.global_blocks = nn.ModuleList(
            Block(dim, heads, config.layer_scale) for _ in range(config.depth)
        )
        # Of the first view and of all others.
        self.camera_token = nn.Parameter(1e-6 * torch.randn(1, 2, 1, dim))
        self.register_token = nn.Parameter(1e-6 * torch.randn(1, 2, config.registers, dim))

    def forward(self, images: Tensor) -> list[Tensor]:  # [B, V, 3, H, W] in [0, 1]
        """Four of (B * V, patches, 2 C): `head_layers`' tokens after frame and global attention."""
        scenes, views = images.shape[:2]
        mean, std = (images.new_tensor(of)[:, None, None] for of in (COLOUR_MEAN, COLOUR_STD))
        patches = self.patch_embed(((images - mean) / std).flatten(0, 1))
        specials = torch.cat([self.camera_token, self.register_token], dim=2)
        first = torch.arange(views, device=images.device).clamp(max=1)  # 0, 1, 1, ...
        specials = specials[:, first].expand(scenes, -1, -1, -1).flatten(0, 1)
        tokens = torch.cat([specials, patches], dim=1)

        patch, count = self.config.patch_size, specials.shape[1]
        rows, columns = images.shape[-2] // patch, images.shape[-1] // patch
        head_dim = self.config.dim // self.config.heads
        within = rotary_tables(rows, columns, count, head_dim, tokens)
        across = tuple(table.repeat(views, 1) for table in within)

        kept = []
        for layer, (frame_block, global_block) in enumerate(
            zip(self.frame_blocks, self.global_blocks, strict=True)
        ):
            framed = frame_block(tokens, within)
            joint = global_block(framed.view(scenes, -1, self.config.dim), across)
            tokens = joint.view_as(framed)
            if layer in self.config.head_layers:
                kept.append(torch.cat([framed, tokens], dim=-1)[:, count:])
        return kept


def new_vggt(config: VggtConfig, generator: torch.Generator) -> Vggt:
    """An untrained network whose weights depend on nothing but `generator`."""
    seed = int(torch.randint(2**62, (), generator=generator))
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(seed)
        return Vggt(config)


def save_vggt(model: Vggt, path: Path, dtype: torch.dtype = torch.float32) -> None:
    """Write a network's weights and config as safetensors, whole or not at all.

    Args:
        model: on any device.
        path: the .safetensors file.
        dtype: what the weights are stored as; float16 halves the file.
    """
    save_network(path, model, dataclasses.asdict(model.config), dtype)


def load_vggt(path: Path) -> Vggt:
    """Read what `save_vggt` wrote, or the public 1.2 B checkpoint (.safetensors or .pt).

    Returns:
        The network in float32 on the CPU, in evaluation mode.

    Raises:
        GeoEvsError: the file is missing, damaged or holds more than tensors, or its weights do
            not fit the network.
    """
    path = Path(path)
    config, weights = _read_safetensors(path) if path.suffix == ".safetensors" else _read_pt(path)
    weights = {name: value for name, value in weights.items() if not name.startswith(UNUSED)}
    with torch.device("meta"):  # 1.2 billion random numbers would be made in vain
        model = Vggt(config)
    advice = "use a file written by save_vggt, or the public VGGT-1B checkpoint"
    load_weights(model, weights, path, advice)
    return model.eval()


def _read_safetensors(path: Path) -> tuple[VggtConfig, dict[str, Tensor]]:
    stored, weights = read_network(path)
    if stored is None:
        return VGGT_1B, weights
    try:
        return VggtConfig(
            **{k: tuple(v) if isinstance(v, list) else v for k, v in stored.items()}
        ), weights
    except TypeError as error:
        raise GeoEvsError(f"{path} holds another network ({error}); name a VGGT") from error


def _read_pt(path: Path) -> tuple[VggtConfig, dict[str, Tensor]]:
    with whole_file(path):
        try:
            return VGGT_1B, dict(torch.load(path, map_location="cpu", weights_only=True))
        except pickle.UnpicklingError:  # its own text is a page
            raise ValueError("it holds more than plain tensors") from None
