"""The layout of a street around a car: images, corners and numbers that hold no recorded pixel.

What methods are given that paint a street from its layout: BEVGen, MagicDrive, Panacea,
DrivingDiffusion and Drive-WM each take some of these (docs/layouts.md).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import cv2
import numpy as np

from geoevs.methods.contract import Views
from geoevs.scenes.boxes import EDGES, Box
from geoevs.scenes.camera import Camera
from geoevs.scenes.road_map import SURFACES, RoadMap, fill_cells

CAR, PEDESTRIAN, NEARNESS, DRIVABLE, MARKING, SIDEWALK, RAY = range(7)
"""Channels of a layout image, from RAY on the three of a direction."""

CHANNELS = RAY + 3

CAR_WORDS = {
    *("bicycle", "bus", "car", "cyclist", "mobility", "motorcycle", "pedicab", "scooter", "towed"),
    *("trailer", "train", "tram", "trolley", "truck", "vehicle"),
}
PERSON_WORDS = {"human", "pedestrian", "person"}
STILL_WORDS = {"rack", "static"}
"""Words of boxes' labels, of all data sources. What has one of STILL_WORDS is neither, as a rack of
bicycles; so is what has none of the others, as a cone."""

NEAR, FAR = 0.5, 80.0
"""Metres before the camera at which boxes are cut, and beyond which they are left out."""

NEARNESS_AT = 4.0
"""Metres at which a box is as near as can be told: nearness is NEARNESS_AT / depth, at most 1."""

REACH = 120.0
"""Metres of map to each side of the car."""

CELL = 0.2
"""Metres of a cell of the raster that layout images look their map up in."""

CROSSING = 0.5
"""Marking of a crossing where nothing is painted: maps of stripes and maps of outlines meet."""

FINE = 16
"""Parts of a pixel that OpenCV is given."""

MOST_PIXELS = 2**15
"""Farthest that a corner may lie outside an image; what OpenCV draws is exact up to here."""


def kind_of(label: str) -> str:
    """`car` for all that drives or rides, `pedestrian`, or nothing for what is neither.

    >>> kind_of("human.pedestrian.adult"), kind_of("Pickup Truck"), kind_of("Cones")
    ('pedestrian', 'car', '')
    """
    words = set(re.split(r"[^a-z]+", label.lower()))
    if words & STILL_WORDS:
        return ""
    if words & PERSON_WORDS:
        return "pedestrian"
    return "car" if words & CAR_WORDS else ""


@dataclass(frozen=True)
class Layout:
    """What lies around a car at one instant.

    Args:
        road_map: the ground; None where nobody knows it.
        boxes: of the instant.
        place: (3,) metres in the world, where the car's camera is.
        yaw: degrees of its heading.
    """

    road_map: RoadMap | None
    boxes: Sequence[Box]
    place: np.ndarray
    yaw: float

    @classmethod
    def of(cls, views: Views, frame: int) -> Self:
        """The layout of a frame, of the map and boxes that a method declared.

        The heading is that of the rig's front camera, or of what both sides look at between them
        where the split withholds it, or else of the first camera.
        """
        rig = views.rig
        roles = [(rig.front,), (rig.front_left, rig.front_right), views.cameras[:1]]
        names = next(names for names in roles if set(names) <= set(views.cameras))
        cameras = [views.camera(name, frame) for name in names]
        ahead = np.sum([camera.optical_axis for camera in cameras], axis=0)
        boxes = []
        if views.has("tracks"):
            boxes = Box.rows(views.tracks[views.tracks["frame"] == frame])
        return cls(
            views.road_map if views.has("map") else None,
            [box for box in boxes if kind_of(box.label)],
            np.mean([camera.centre for camera in cameras], axis=0),
            float(np.degrees(np.arctan2(ahead[1], ahead[0]))),
        )

    @property
    def turn(self) -> np.ndarray:
        """(3, 3) world from ego: x along the heading, y to the left, z up."""
        cos, sin = np.cos(np.radians(self.yaw)), np.sin(np.radians(self.yaw))
        return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])

    def corners(self) -> np.ndarray:
        """(N, 8, 3) metres: the boxes' corners from `place`, forward, to the left, up."""
        corners = np.array([box.corners for box in self.boxes]).reshape(-1, 8, 3)
        return (corners - self.place) @ self.turn

    def camera_numbers(self, camera: Camera) -> np.ndarray:
        """(3, 7): K in sides of the image, and the camera from the ego, [R | t]."""
        size = np.array([[camera.width], [camera.height], [1.0]])
        rotation = camera.camera_from_world[:3, :3]
        moved = rotation @ (self.place - camera.centre)
        return np.column_stack([camera.K / size, rotation @ self.turn, moved])

    def bev(self, metres: float, cells: int) -> np.ndarray:
        """(cells, cells, 6) bool from above: SURFACES, cars, pedestrians (see RoadMap.raster)."""
        seen = np.zeros((cells, cells, len(SURFACES) + 2), bool)
        where = (self.place[:2], self.yaw, metres)
        if self.road_map is not None:
            seen[..., : len(SURFACES)] = self.road_map.raster(*where, cells)
        for channel, kind in enumerate(("car", "pedestrian"), start=len(SURFACES)):
            mine = [
                cv2.convexHull(box.corners[:, :2].astype(np.float32))[:, 0]
                for box in self.boxes
                if kind_of(box.label) == kind
            ]
            seen[..., channel] = fill_cells([[ring] for ring in mine], *where, cells)
        return seen

    def image(self, camera: Camera) -> np.ndarray:
        """(H, W, 9) float32 in [0, 1]: what the layout looks like from a camera.

        The map is looked up where the pixels' rays meet the plane of the road. Boxes cover it and
        each other, from far to near, as the hulls of their corners.
        """
        rays = _rays(camera)
        picture = np.zeros((camera.height, camera.width, CHANNELS), np.float32)
        ahead = rays @ self.turn
        picture[..., RAY:] = (ahead / np.linalg.norm(ahead, axis=-1, keepdims=True) + 1) / 2
        if self.road_map is not None:
            surfaces = self._ground(camera, rays)
            picture[..., DRIVABLE] = surfaces[..., 0]
            picture[..., MARKING] = np.maximum(surfaces[..., 1], CROSSING * surfaces[..., 2])
            picture[..., SIDEWALK] = surfaces[..., 3]
        for depth, box in sorted(self._before(camera), key=lambda pair: -pair[0]):
            hull = np.zeros((camera.height, camera.width), np.uint8)
            cv2.fillConvexPoly(hull, _outline(box, camera), 1, cv2.LINE_8, FINE.bit_length() - 1)
            covered = hull.astype(bool)
            picture[covered, :RAY] = 0
            picture[covered, CAR if kind_of(box.label) == "car" else PEDESTRIAN] = 1
            picture[covered, NEARNESS] = min(NEARNESS_AT / depth, 1.0)
        return picture

    def _before(self, camera: Camera) -> list[tuple[float, Box]]:
        """The boxes that reach before a camera, with the depth of their middles, NEAR at least."""
        found = []
        for box in self.boxes:
            depths = (box.corners - camera.centre) @ camera.optical_axis
            if depths.max() > NEAR and depths.mean() < FAR:
                found.append((max(float(depths.mean()), NEAR), box))
        return found

    def _ground(self, camera: Camera, rays: np.ndarray) -> np.ndarray:
        """(H, W, 4) bool: the surfaces that rays (H, W, 3) from a camera meet."""
        a, b, c = self._plane
        x, y, z = camera.centre
        falls = rays @ np.array([a, b, -1.0])
        height = z - a * x - b * y - c
        # A ray that does not fall towards the plane never meets it.
        length = np.divide(height, falls, out=np.full(falls.shape, np.inf), where=falls > 0)
        met = np.where(length < 1e6, length, 0)[..., None] * rays[..., :2] + camera.centre[:2]
        ahead, left = np.moveaxis((met - self.place[:2]) @ self.turn[:2, :2], -1, 0)
        row, column = (np.floor((REACH - way) / CELL).astype(int) for way in (ahead, left))
        count = len(self._raster)
        inside = (length < 1e6) & (row >= 0) & (row < count) & (column >= 0) & (column < count)
        return (
            self._raster[np.where(inside, row, 0), np.where(inside, column, 0)] & inside[..., None]
        )

    @cached_property
    def _plane(self) -> np.ndarray:
        return self.road_map.ground(self.place[:2])

    @cached_property
    def _raster(self) -> np.ndarray:
        return self.road_map.raster(self.place[:2], self.yaw, 2 * REACH, round(2 * REACH / CELL))


def _rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) directions through the pixels' centres in the world, of depth 1."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    return pixels @ np.linalg.inv(camera.K).T @ camera.world_from_camera[:3, :3].T


def _outline(box: Box, camera: Camera) -> np.ndarray:
    """(N, 2) int32 in 1 / FINE pixels: the hull of the part of a box that lies before a camera."""
    local = box.corners @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    depth = local[:, 2]
    cut = EDGES[(depth[EDGES[:, 0]] > NEAR) != (depth[EDGES[:, 1]] > NEAR)]
    one, other = local[cut[:, 0]], local[cut[:, 1]]
    share = (NEAR - one[:, 2]) / (other[:, 2] - one[:, 2])
    seen = np.concatenate([local[depth > NEAR], one + share[:, None] * (other - one)]) @ camera.K.T
    pixels = np.clip(seen[:, :2] / seen[:, 2:], -MOST_PIXELS, MOST_PIXELS)
    hull = cv2.convexHull(pixels.astype(np.float32))[:, 0]
    # OpenCV counts a pixel's centre as a whole number.
    return np.rint((hull - 0.5) * FINE).astype(np.int32)
