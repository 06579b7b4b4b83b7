"""Waymo's map features (v1.4.2 and later) as polygons: its lanes and lines become bands."""

from collections.abc import Sequence

import numpy as np

from geoevs.scenes.road_map import Polygon, RoadMap
from geoevs.scenes.sources.waymo.segment import MapFeature

AREAS = {"crosswalk": "crossing", "driveway": "drivable"}
"""The surface of features that are outlines."""

BANDS = {"lane": ("drivable", 3.6), "road_line": ("marking", 0.15)}
"""The surface of features that are lines along the middle, and the metres across that they get: the
map has no widths. A lane of 12 feet is usual in the United States, and a line of 6 inches."""


def road_map(features: Sequence[MapFeature]) -> RoadMap | None:
    """A map of the features that enclose something; None if none does."""
    polygons = []
    for kind, points in features:
        surface, width = BANDS[kind] if kind in BANDS else (AREAS[kind], 0.0)
        ring = band(points, width) if width else points
        if len(ring) > 2:
            polygons.append(Polygon(surface, [ring]))
    return RoadMap(polygons) if polygons else None


def band(line: np.ndarray, width: float) -> np.ndarray:
    """(2 N, 3) the outline of a band along (N, 3) points; none where these are one place."""
    steps = np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1)
    line = line[np.append(True, steps > 0)]
    if len(line) < 2:
        return np.zeros((0, 3))
    along = np.gradient(line[:, :2], axis=0)
    lengths = np.linalg.norm(along, axis=1, keepdims=True)
    # A line that turns back on itself has no direction there.
    x, y = (along / np.where(lengths > 0, lengths, 1)).T
    aside = np.stack([-y, x, np.zeros_like(x)], axis=1) * width / 2
    return np.concatenate([line + aside, (line - aside)[::-1]])
