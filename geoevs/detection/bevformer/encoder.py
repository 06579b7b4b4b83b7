"""From views to a BEV: learned queries that look into the past and into the pictures."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.detection.bevformer.attention import (
    Past,
    Seen,
    SpatialCrossAttention,
    TemporalSelfAttention,
    look_up,
)
from geoevs.detection.bevformer.settings import GROUPS, Detector

NEAREST = 0.1
"""Metres before a camera from which on a point is visible."""

BEYOND = -1.0
"""A place outside every picture, for points behind its camera."""

MOTION = 4
"""Numbers of a motion (see `Past`)."""


def feed_forward(channels: int) -> nn.Sequential:
    """Two linear maps of every token, twice as wide between."""
    return nn.Sequential(
        nn.Linear(channels, 2 * channels), nn.ReLU(), nn.Linear(2 * channels, channels)
    )


def _middles(count: int) -> np.ndarray:
    return (np.arange(count) + 0.5) / count


class Grid:
    """The cells of a BEV, row by row: x rises along a row, y from row to row."""

    def __init__(self, detector: Detector) -> None:
        columns, rows = detector.grid
        self.size = rows, columns
        self.low, high = np.array(detector.range).reshape(2, 3)
        self.extent = high - self.low
        y, x = np.meshgrid(_middles(rows), _middles(columns), indexing="ij")
        self.places = np.stack([x, y], axis=-1).reshape(-1, 2)  # [Q, 2] of cells in the BEV
        shares = np.empty((rows * columns, detector.heights, 3))
        shares[..., :2], shares[..., 2] = self.places[:, None], _middles(detector.heights)
        self.pillars = self.low + shares * self.extent  # [Q, Z, 3] metres

    def project(
        self,
        image_from_vehicle: Tensor,  # [V, 3, 4] float64
        size: tuple[int, int],
    ) -> tuple[Tensor, Tensor]:
        """Where the pillars' points fall in pictures of height and width `size`.

        Returns:
            Places, (V, Q, Z, 2) float64 in [0, 1] within a picture, and (V, Q, Z) bool: whether
            they are before the camera and within the picture.
        """
        points = torch.from_numpy(self.pillars).to(image_from_vehicle.device)
        turn, shift = (
            image_from_vehicle[:, None, None, :, :3],
            image_from_vehicle[:, None, None, :, 3],
        )
        pixels = (turn @ points[..., None])[..., 0] + shift
        ahead = pixels[..., 2] > NEAREST
        places = pixels[..., :2] / pixels[..., 2:].clamp(min=NEAREST)
        places = places / places.new_tensor([size[1], size[0]])
        places = torch.where(ahead[..., None], places, BEYOND).clamp(-1, 2)
        return places, ahead & ((places >= 0) & (places < 1)).all(dim=-1)

    def from_here(
        self,
        past_from_here: np.ndarray,  # [4, 4] of the vehicle's frames
    ) -> tuple[np.ndarray, np.ndarray]:
        """The move of a vehicle as BEVs have it.

        Returns:
            (2, 3) affine map of places in the present BEV to places in the earlier one, and (3,)
            the present vehicle in the earlier frame: metres ahead and to the left, radians.
        """
        yaw = np.arctan2(past_from_here[1, 0], past_from_here[0, 0])
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        shift, low, extent = past_from_here[:2, 3], self.low[:2], self.extent[:2]
        places = np.empty((2, 3))
        places[:, :2] = turn * extent / extent[:, None]
        places[:, 2] = (turn @ low + shift - low) / extent
        return places, np.append(shift, yaw)


class Views(NamedTuple):
    """All views of a batch, those of one item behind those of another."""

    features: Tensor  # [V, F, h, w] of a backbone
    item: Tensor  # [V] int64
    recorded: Tensor  # [V] bool
    places: Tensor  # [V, Q, Z, 2] (see `Grid.project`)
    visible: Tensor  # [V, Q, Z] bool
    items: int


class EncoderLayer(nn.Module):
    """Looks into the past and the pictures, and a feed-forward, each added and normed."""

    def __init__(self, detector: Detector, size: tuple[int, int]) -> None:
        super().__init__()
        channels = detector.channels
        self.temporal = TemporalSelfAttention(channels, size)
        self.spatial = SpatialCrossAttention(channels, detector.points, detector.heights)
        self.forward_ = feed_forward(channels)
        self.norms = nn.ModuleList(nn.LayerNorm(channels) for _ in range(3))

    def forward(
        self, query: Tensor, position: Tensor, reference: Tensor, views: Seen, past: Past
    ) -> Tensor:
        """(B, Q, C) the cells after one more look into the past and the pictures."""
        query = self.norms[0](query + self.temporal(query, position, reference, past))
        query = self.norms[1](query + self.spatial(query, views))
        return self.norms[2](query + self.forward_(query))


class Encoder(nn.Module):
    """Features of any number of views, and an earlier BEV, to the present BEV.

    Args:
        detector: its sizes.
        features: channels of the backbone's features.
    """

    def __init__(self, detector: Detector, features: int) -> None:
        super().__init__()
        channels, grid = detector.channels, Grid(detector)
        rows, columns = grid.size
        self.neck = nn.Sequential(
            nn.Conv2d(features, channels, 1),
            nn.GroupNorm(GROUPS, channels),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
        )
        self.recorded = nn.Parameter(0.02 * torch.randn(2, channels))  # of generated and recorded
        self.queries = nn.Parameter(torch.randn(rows * columns, channels))
        self.row = nn.Parameter(torch.rand(rows, channels // 2))
        self.column = nn.Parameter(torch.rand(columns, channels // 2))
        self.motion = nn.Sequential(
            nn.Linear(MOTION, channels // 2),
            nn.ReLU(),
            nn.Linear(channels // 2, channels),
            nn.ReLU(),
            nn.LayerNorm(channels),
        )
        self.layers = nn.ModuleList(
            EncoderLayer(detector, grid.size) for _ in range(detector.encoder)
        )
        self.register_buffer("reference", torch.from_numpy(grid.places).float(), persistent=False)

    @property
    def position(self) -> Tensor:
        """(Q, C) learned positions of the cells."""
        rows, columns = len(self.row), len(self.column)
        parts = (
            self.column.expand(rows, -1, -1),
            self.row[:, None].expand(-1, columns, -1),
        )
        return torch.cat(parts, dim=-1).flatten(0, 1)

    def no_past(self, items: int) -> Past:
        """What there is before the first frames of scenes."""
        like = self.queries
        return Past(
            bev=like.new_zeros(items, *like.shape),
            present=torch.zeros(items, dtype=torch.bool, device=like.device),
            from_here=like.new_zeros(items, 2, 3),
            motion=like.new_zeros(items, MOTION),
        )

    def forward(self, views: Views, past: Past) -> Tensor:
        """(B, Q, C) the BEV of every item."""
        features = self.neck(views.features)
        features = features + self.recorded[views.recorded.long()][:, :, None, None]
        seen = look_up(features, views.item, views.places, views.visible, views.items)
        moved = self.motion(past.motion) * past.present[:, None]
        query = self.queries + moved[:, None]
        position = self.position
        for layer in self.layers:
            query = layer(query, position, self.reference, seen, past)
        return query
