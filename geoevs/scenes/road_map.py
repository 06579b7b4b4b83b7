"""The road map of a scene: polygons of what the ground is, and rasters of them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.text import clean
from geoevs.scenes.camera import WORLD_LIMIT

SURFACES = ("drivable", "marking", "crossing", "sidewalk")
"""What a polygon may be: road, paint on it, a place where pedestrians cross, and a sidewalk."""

MOST_CORNERS = 4_000_000
"""Of a map at most; that of a Waymo segment has some ten thousand."""

FRACTION_BITS = 6
"""Of the cells that OpenCV is given: corners are rounded to 1/64 cell."""

ARRAYS = (
    ("corners", np.float64, (3,)),
    ("lengths", np.int64, ()),
    ("rings", np.int64, ()),
    ("surfaces", np.uint8, ()),
)
"""Of a map's file: the corners of all rings in a row, how many each ring has, how many rings each
polygon has, and its surface. Their types, and their shapes after the first axis."""

MARGIN = 2
"""Cells around a raster that are drawn and cut off: OpenCV draws on its border what lies beyond."""

NEAR_GROUND = 20.0
"""Metres at which a corner counts half for the plane of the ground."""


class Polygon(NamedTuple):
    """A piece of ground.

    Args:
        surface: of SURFACES.
        rings: its outline and its holes, (N, 3) float64 metres in the world each; a ring's last
            corner joins its first. Seen from above, a point is inside if a ray from it crosses
            the rings an odd number of times.
    """

    surface: str
    rings: Sequence[np.ndarray]

    @property
    def corners(self) -> np.ndarray:
        """(N, 3) those of all rings."""
        return np.concatenate(self.rings)


@dataclass(frozen=True)
class RoadMap:
    """The ground around a scene, as polygons that may overlap.

    Where a sidewalk lies over something else, it hides that.
    """

    polygons: Sequence[Polygon]

    def raster(
        self,
        centre: np.ndarray,  # [2]
        yaw: float,
        metres: float,
        cells: int,
    ) -> np.ndarray:
        """A square of the map from above.

        Args:
            centre: of the square, in the world.
            yaw: degrees of the direction that its rows count from, about z from the world's x.
            metres: of a side.
            cells: of a side.

        Returns:
            (cells, cells, 4) bool by SURFACES; row 0 is farthest ahead, column 0 farthest to the
            left. Cells on a polygon's edge are set too, so that thin lines have no gaps; edges are
            true to about a cell.
        """
        reach = self._halves + metres * np.sqrt(0.5)
        near = np.flatnonzero((np.abs(self._middles - centre) <= reach).all(axis=1))
        drawn = [self.polygons[number] for number in near.tolist()]
        grids = [
            fill_cells(
                [polygon.rings for polygon in drawn if polygon.surface == surface],
                centre,
                yaw,
                metres,
                cells,
            )
            for surface in SURFACES
        ]
        return _topmost(np.stack(grids, axis=-1))

    def at(
        self,
        xy: np.ndarray,  # [N, 2] in the world
    ) -> np.ndarray:
        """(N, 4) bool: the SURFACES of places, exactly and slowly; see `raster` for many."""
        found = np.zeros((len(xy), len(SURFACES)), bool)
        for polygon, middle, half in zip(self.polygons, self._middles, self._halves, strict=True):
            near = np.flatnonzero((np.abs(xy - middle) <= half).all(axis=1))
            count = sum(_crossings(xy[near], ring[:, :2]) for ring in polygon.rings)
            found[near[count % 2 == 1], SURFACES.index(polygon.surface)] = True
        return _topmost(found)

    def ground(
        self,
        centre: np.ndarray,  # [2]
    ) -> np.ndarray:
        """(3,) a, b, c of the plane z = a x + b y + c of the road around a place, least squares.

        Corners count the less the farther they are. A map of nothing but sidewalks has theirs.
        """
        roads = [polygon for polygon in self.polygons if polygon.surface != SURFACES[-1]]
        corners = np.concatenate([polygon.corners for polygon in roads or self.polygons])
        away = corners[:, :2] - centre
        weight = 1 / (1 + (away**2).sum(axis=1) / NEAR_GROUND**2)
        mean = np.average(corners, axis=0, weights=weight)
        system = (corners[:, :2] - mean[:2]) * np.sqrt(weight)[:, None]
        # Of the shortest slope where the corners lie on a line.
        slope, *_ = np.linalg.lstsq(system, (corners[:, 2] - mean[2]) * np.sqrt(weight), rcond=1e-6)
        return np.append(slope, mean[2] - slope @ mean[:2])

    @cached_property
    def _bounds(self) -> np.ndarray:
        """(2, M, 2) the lowest and the highest x and y of each polygon."""
        corners = [polygon.corners[:, :2] for polygon in self.polygons]
        return np.array([[c.min(axis=0) for c in corners], [c.max(axis=0) for c in corners]])

    @property
    def _middles(self) -> np.ndarray:
        return self._bounds.mean(axis=0)

    @property
    def _halves(self) -> np.ndarray:
        return (self._bounds[1] - self._bounds[0]) / 2


def fill_cells(
    polygons: Iterable[Sequence[np.ndarray]],
    centre: np.ndarray,  # [2]
    yaw: float,
    metres: float,
    cells: int,
) -> np.ndarray:
    """(cells, cells) bool: the cells of a square (see `RoadMap.raster`) that polygons fill.

    Args:
        polygons: each its rings, (N, 2 or 3) metres in the world.
        centre: see `RoadMap.raster`, as for the others.
        yaw: in degrees.
        metres: of a side.
        cells: of a side.
    """
    grid = np.zeros((cells + 2 * MARGIN, cells + 2 * MARGIN), np.uint8)
    cos, sin = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    to_left_and_ahead = np.array([[-sin, cos], [cos, sin]]).T
    for rings in polygons:
        corners = []
        for ring in rings:
            away = (ring[:, :2] - centre) @ to_left_and_ahead
            # OpenCV counts from the middle of the first cell.
            places = (metres / 2 - away) * (cells / metres) + MARGIN - 0.5
            corners.append(np.rint(places * 2**FRACTION_BITS).astype(np.int32))
        cv2.fillPoly(grid, corners, 1, cv2.LINE_8, FRACTION_BITS)
    return grid[MARGIN:-MARGIN, MARGIN:-MARGIN].astype(bool)


def _topmost(surfaces: np.ndarray) -> np.ndarray:
    """(..., 4) bool: surfaces without those that a sidewalk hides."""
    surfaces[..., :-1] &= ~surfaces[..., -1:]
    return surfaces


def _crossings(points: np.ndarray, ring: np.ndarray) -> np.ndarray:
    """(N,) how often a ray along x from each of (N, 2) points crosses a (M, 2) ring."""
    count = np.zeros(len(points), int)
    x, y = points.T
    for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        spans = (y0 <= y) != (y1 <= y)
        count += spans & (x < x0 + (y - y0) / np.where(spans, y1 - y0, 1) * (x1 - x0))
    return count


def check_road_map(road_map: RoadMap, where: Path | str) -> None:
    """Check a map as it was read or made.

    Raises:
        GeoEvsError: it has no polygon or too many corners; or a polygon is of no known surface, has
            a ring that is none, or corners that are NaN or beyond WORLD_LIMIT.
    """
    if not road_map.polygons:
        raise GeoEvsError(f"{where}: the road map has no polygon; leave it out")
    if sum(len(ring) for polygon in road_map.polygons for ring in polygon.rings) > MOST_CORNERS:
        raise GeoEvsError(f"{where}: the road map has more than {MOST_CORNERS} corners; cut it")
    for number, (surface, rings) in enumerate(road_map.polygons):
        who = f"{where}: polygon {number} of the road map"
        if surface not in SURFACES:
            hint = did_you_mean(str(surface), SURFACES)
            raise GeoEvsError(f"{who} is no '{clean(str(surface), 40)}'; {hint}")
        if not rings or not all(map(_is_ring, rings)):
            raise GeoEvsError(
                f"{who} has a ring without three corners of 3 metres each; correct it"
            )
        # NaN is not within the world either.
        if not all((np.abs(ring) <= WORLD_LIMIT).all() for ring in rings):
            raise GeoEvsError(
                f"{who} has corners that are NaN or beyond {WORLD_LIMIT / 1000:g} km; subtract the "
                "scene's origin"
            )


def _is_ring(ring: np.ndarray) -> bool:
    return ring.ndim == 2 and ring.shape[1] == 3 and len(ring) > 2 and ring.dtype.kind == "f"


def map_arrays(road_map: RoadMap) -> dict[str, np.ndarray]:
    """A map as the ARRAYS of its file."""
    rings = [ring for polygon in road_map.polygons for ring in polygon.rings]
    values = (
        np.concatenate(rings),
        [len(ring) for ring in rings],
        [len(polygon.rings) for polygon in road_map.polygons],
        [SURFACES.index(polygon.surface) for polygon in road_map.polygons],
    )
    return {
        name: np.asarray(value, kind) for (name, kind, _), value in zip(ARRAYS, values, strict=True)
    }


def map_from_arrays(arrays: dict[str, np.ndarray], where: Path | str) -> RoadMap:
    """The inverse of `map_arrays`, of a stranger's arrays.

    Raises:
        GeoEvsError: one is missing or of another type or shape, the lengths do not add up, or the
            map cannot be (see `check_road_map`).
    """
    for name, kind, shape in ARRAYS:
        found = arrays.get(name, np.zeros(()))
        if found.dtype != kind or found.shape[1:] != shape or not found.ndim:
            raise GeoEvsError(f"{where} has no '{name}' of a road map; remake the store")
    corners, lengths, counts, numbers = (arrays[name] for name, *_ in ARRAYS)
    if len(corners) > MOST_CORNERS:
        raise GeoEvsError(f"{where} has more than {MOST_CORNERS} corners; cut the map")
    if len(counts) != len(numbers) or (numbers >= len(SURFACES)).any():
        raise GeoEvsError(f"{where} has a polygon of no known surface; remake the store")
    surfaces = [SURFACES[number] for number in numbers]
    rings = _parts(corners, lengths, f"{where}: 'lengths'")
    parts = _parts(rings, counts, f"{where}: 'rings'")
    road_map = RoadMap([Polygon(*pair) for pair in zip(surfaces, parts, strict=True)])
    check_road_map(road_map, where)
    return road_map


def _parts(whole: Any, lengths: np.ndarray, who: str) -> list[Any]:
    """What stands in a row, cut into pieces of these lengths."""
    # Each by itself first: the sum of huge ones wraps around.
    if ((lengths <= 0) | (lengths > len(whole))).any() or lengths.sum() != len(whole):
        raise GeoEvsError(
            f"{who} do not add up to the {len(whole)} that there are; remake the store"
        )
    return [whole[start:end] for start, end in pairwise([0, *np.cumsum(lengths).tolist()])]
