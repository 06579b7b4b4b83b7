"""From a BEV to boxes: queries that refine their places, as in Deformable DETR."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from geoevs.detection.bevformer.attention import BevAttention
from geoevs.detection.bevformer.boxes import CENTRE, CODE, first_code
from geoevs.detection.bevformer.encoder import Grid, feed_forward
from geoevs.detection.bevformer.settings import HEADS, Detector

RARE = -4.595
"""-log 99: a class's logit at first, as most queries find nothing."""

INNERMOST = 1e-5
"""From 0 and 1, within which places are turned into logits."""


class Found(NamedTuple):
    """What every decoder layer finds."""

    logits: Tensor  # [L, B, N, K] of the classes
    codes: Tensor  # [L, B, N, 8] boxes (see `boxes`)


class DecoderLayer(nn.Module):
    """Self-attention among queries, a look into the BEV, a feed-forward, each added and normed."""

    def __init__(self, channels: int, size: tuple[int, int]) -> None:
        super().__init__()
        self.among = nn.MultiheadAttention(channels, HEADS, batch_first=True)
        self.look = BevAttention(channels, size)
        self.forward_ = feed_forward(channels)
        self.norms = nn.ModuleList(nn.LayerNorm(channels) for _ in range(3))

    def forward(
        self,
        query: Tensor,  # [B, N, C]
        position: Tensor,  # [N, C]
        reference: Tensor,  # [B, N, 2]
        bev: Tensor,  # [B, Q, C]
    ) -> Tensor:
        """(B, N, C) the queries after one more look."""
        asked = query + position
        query = self.norms[0](query + self.among(asked, asked, query, need_weights=False)[0])
        query = self.norms[1](query + self.look(query + position, reference, bev))
        return self.norms[2](query + self.forward_(query))


class Decoder(nn.Module):
    """A BEV to class logits and boxes of every layer.

    Args:
        detector: its sizes.
        classes: how many.
    """

    def __init__(self, detector: Detector, classes: int) -> None:
        super().__init__()
        channels, grid = detector.channels, Grid(detector)
        self.content = nn.Parameter(torch.randn(detector.queries, channels))
        self.position = nn.Parameter(torch.randn(detector.queries, channels))
        self.reference = nn.Linear(channels, 3)
        self.layers = nn.ModuleList(
            DecoderLayer(channels, grid.size) for _ in range(detector.decoder)
        )
        self.classes = nn.ModuleList(_class_head(channels, classes) for _ in self.layers)
        self.boxes = nn.ModuleList(_box_head(channels) for _ in self.layers)
        self.register_buffer("low", torch.from_numpy(grid.low).float(), persistent=False)
        self.register_buffer("extent", torch.from_numpy(grid.extent).float(), persistent=False)

    def forward(self, bev: Tensor) -> Found:  # [B, Q, C]
        """What each layer finds; places are refined from layer to layer, without a gradient."""
        query = self.content.expand(len(bev), -1, -1)
        reference = self.reference(self.position).sigmoid().expand(len(bev), -1, -1)
        logits, codes = [], []
        for layer, classes, boxes in zip(self.layers, self.classes, self.boxes, strict=True):
            query = layer(query, self.position, reference[..., :2], bev)
            code = boxes(query)
            place = (code[..., CENTRE] + torch.logit(reference, INNERMOST)).sigmoid()
            x, y, z = (self.low + place * self.extent).unbind(-1)
            _, _, width, length, _, height, sin, cos = code.unbind(-1)
            logits.append(classes(query))
            codes.append(torch.stack([x, y, width, length, z, height, sin, cos], dim=-1))
            reference = place.detach()
        return Found(torch.stack(logits), torch.stack(codes))


def _class_head(channels: int, classes: int) -> nn.Sequential:
    head = nn.Sequential(
        nn.Linear(channels, channels),
        nn.LayerNorm(channels),
        nn.ReLU(),
        nn.Linear(channels, classes),
    )
    nn.init.constant_(head[-1].bias, RARE)
    return head


def _box_head(channels: int) -> nn.Sequential:
    head = nn.Sequential(nn.Linear(channels, channels), nn.ReLU(), nn.Linear(channels, CODE))
    nn.init.zeros_(head[-1].weight)
    with torch.no_grad():
        head[-1].bias.copy_(first_code())
    return head


class HeatMap(nn.Module):
    """Where in a BEV centres lie, by class: an auxiliary task of the training alone."""

    def __init__(self, channels: int, classes: int, size: tuple[int, int]) -> None:
        super().__init__()
        self._size = size
        self.inner = nn.Conv2d(channels, channels, 3, padding=1)
        self.outer = nn.Conv2d(channels, classes, 1)
        nn.init.constant_(self.outer.bias, -4.0)

    def forward(self, bev: Tensor) -> Tensor:  # [B, Q, C]
        """(B, K, rows, columns) logits."""
        image = bev.transpose(1, 2).unflatten(-1, self._size)
        return self.outer(functional.relu(self.inner(image)))
