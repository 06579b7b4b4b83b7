"""Pseudo-images: coloured LiDAR points of neighbouring frames as a camera would see them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import cv2
import numpy as np

from geoevs.methods.contract import Views
from geoevs.projection import Raster, rasterize_points
from geoevs.scenes.boxes import Box, moving_boxes
from geoevs.scenes.camera import Camera

NEIGHBOURS = 2
"""Frames before and after one whose points are accumulated, as published."""

OCCUPIED_RADIUS = 4 / 960
"""Radius around its points in which an object hides what is projected after it: the published 4
pixels, as a share of the image's width."""


class Points(NamedTuple):
    """Points with their colours; the owner says in which coordinates."""

    xyz: np.ndarray  # [N, 3] metres
    rgb: np.ndarray  # [N, 3] in [0, 1]


@dataclass(frozen=True)
class Sweeps:
    """A scene's coloured LiDAR points, those of moving boxes apart, in the boxes' coordinates.

    Points without a colour are left out: they would be black, and hide others that have one.
    """

    background: dict[int, Points]
    objects: dict[int, dict[str, Points]]
    boxes: dict[int, list[Box]]

    @classmethod
    def read(cls, views: Views) -> Self:
        """The points of all frames that may condition a method (see `Views.lidar`)."""
        boxes: dict[int, list[Box]] = {frame: [] for frame in views.frames}
        for box in moving_boxes(views.tracks, views.frames):
            boxes[box.frame].append(box)
        background, objects = {}, {}
        for frame in views.frames:
            cloud = views.lidar(frame)
            cloud = cloud.select(cloud.camera >= 0)
            still = np.ones(len(cloud), bool)
            objects[frame] = {}
            for box in boxes[frame]:
                inside = box.holds(cloud.xyz) & still
                if inside.any():
                    local = box.local(cloud.xyz[inside])
                    objects[frame][box.track] = Points(local, cloud.rgb[inside])
                    still &= ~inside
            background[frame] = Points(cloud.xyz[still], cloud.rgb[still])
        return cls(background, objects, boxes)

    @property
    def count(self) -> int:
        """The number of points, of all frames and boxes."""
        parts = [points for frame in self.objects.values() for points in frame.values()]
        return sum(len(points.xyz) for points in (*self.background.values(), *parts))

    def pseudo_image(self, camera: Camera, frame: int, shift: int = 0) -> Raster:
        """Rasterise the points of the frames around one, as a camera would see them at its instant.

        Objects are projected from near to far, each but where nearer ones and the pixels around
        them are, then the background; of each the front-most point of a pixel counts.

        Args:
            camera: the view.
            frame: the instant, at which moving boxes stand where their tracks say.
            shift: the points are of the frames around this many later, or of the scene's end: the
                published simulation of a viewpoint that the points were not measured for.
        """
        window = self._window(frame + shift)
        objects = [
            part for box in self.boxes[frame] if (part := self._object(box, window)) is not None
        ]
        objects.sort(key=lambda points: np.linalg.norm(points.xyz - camera.centre, axis=1).min())
        background = [self.background[neighbour] for neighbour in window]
        layers = [rasterize_points(*points, camera) for points in (*objects, _join(background))]
        return _stack(layers, round(OCCUPIED_RADIUS * camera.width))

    def _window(self, centre: int) -> list[int]:
        """The frames within NEIGHBOURS of one, or of the scene's first or last."""
        frames = list(self.background)
        centre = min(max(centre, frames[0]), frames[-1])
        return [frame for frame in frames if abs(frame - centre) <= NEIGHBOURS]

    def _object(self, box: Box, window: Sequence[int]) -> Points | None:
        """What was measured of a box's track, moved to where the box is."""
        parts = [self.objects[frame].get(box.track) for frame in window]
        parts = [part for part in parts if part is not None]
        if not parts:
            return None
        local, rgb = _join(parts)
        return Points(box.world(local), rgb)


def _join(parts: Sequence[Points]) -> Points:
    return Points(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _stack(layers: Sequence[Raster], radius: int) -> Raster:
    """Layers in one image: earlier ones hide later ones, also `radius` pixels around themselves."""
    first = layers[0]
    image, mask, depth = np.zeros_like(first.image), np.zeros_like(first.mask), 0 * first.depth
    occupied = np.zeros(mask.shape, np.uint8)
    around = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    for layer in layers:
        new = layer.mask & (occupied == 0)
        image[new], depth[new] = layer.image[new], layer.depth[new]
        mask |= new
        occupied |= cv2.dilate(layer.mask.astype(np.uint8), around)
    return Raster(image, mask, depth)
