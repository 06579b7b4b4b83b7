"""PandaSet's road map: what the labels of LiDAR points say of the ground, from above.

A map must not tell methods where the points lie that score them. Of the scene's own frames it is
made of PandarGT's points alone, which may condition methods. Frames of the sequence that the scene
leaves out give the points of both LiDARs.
"""

from collections.abc import Collection, Iterator
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.road_map import Polygon, RoadMap
from geoevs.scenes.sources.pandaset.unpickle import check_numbers, read_table

LABELS = {"drivable": (7, 8, 9, 10, 12), "marking": (8, 9, 10), "sidewalk": (11,)}
"""Classes of `annotations/semseg/classes.json` that each surface is made of: road, lane line, stop
line, other marking, sidewalk and driveway. A zebra is among the other markings."""

FRONT_LIDAR = 1
"""`d` of PandarGT's points, which score nothing."""

CELL = 0.25
"""Metres of the grid that points fall into."""

REACH = 150.0
"""Metres of the map to each side of where the scene begins."""

GAPS = {"drivable": 7, "marking": 3, "sidewalk": 7}
"""Cells without a point that a surface closes: LiDAR's rings are metres apart on the ground."""


def read_road_map(
    folder: Path, frames: Collection[int], centre: np.ndarray, origin: tuple[float, float, float]
) -> RoadMap | None:
    """The map of a sequence, less `origin`; None where nobody labelled its ground.

    Args:
        folder: of the sequence.
        frames: the scene's.
        centre: (3,) metres in PandaSet's world, where the scene begins.
        origin: (3,) metres that are subtracted.

    Raises:
        GeoEvsError: a table is unreadable, lacks a column, or has not one label a point.
    """
    count = round(2 * REACH / CELL)
    hits = {surface: np.zeros((count, count), np.uint8) for surface in LABELS}
    heights, points = np.zeros(count**2), np.zeros(count**2)
    corner = centre[:2] - REACH
    for xyz, labels in _labelled(folder, frames):
        near = (np.abs(xyz[:, :2] - centre[:2]) < REACH).all(axis=1) & np.isfinite(xyz[:, 2])
        ground = near & np.isin(labels, sum(LABELS.values(), ()))
        column, row = ((xyz[ground, :2] - corner) / CELL).astype(int).T
        cells = row * count + column
        heights += np.bincount(cells, xyz[ground, 2], minlength=count**2)
        points += np.bincount(cells, minlength=count**2)
        for surface, wanted in LABELS.items():
            hits[surface].ravel()[cells[np.isin(labels[ground], wanted)]] = 1
    if not points.any():
        return None
    height = (heights / np.maximum(points, 1)).reshape(count, count)
    nearest = distance_transform_edt(
        (points == 0).reshape(count, count), return_distances=False, return_indices=True
    )
    start = np.append(corner, 0.0) - origin
    polygons = [
        Polygon(surface, [start + ring for ring in rings])
        for surface, grid in hits.items()
        for rings in _outlines(grid, GAPS[surface], height[tuple(nearest)])
    ]
    return RoadMap(polygons) if polygons else None


def _labelled(folder: Path, frames: Collection[int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(N, 3) points in PandaSet's world and their (N,) labels, of each frame that has some."""
    for path in sorted((folder / "annotations/semseg").glob("[0-9][0-9].pkl.gz")):
        sweep = folder / "lidar" / path.name
        if not sweep.exists():
            continue
        table, labels = read_table(sweep), read_table(path)
        for file, columns, found in ((sweep, "xyzd", table), (path, ("class",), labels)):
            for column in columns:
                if column not in found:
                    raise GeoEvsError(f"{file} has no column '{column}'; download it again")
            check_numbers(found, columns, file)
        if len(table) != len(labels):
            raise GeoEvsError(
                f"{path} has {len(labels)} labels for the {len(table)} points of {sweep.name} in "
                "lidar; download both again"
            )
        xyz = table[["x", "y", "z"]].to_numpy(np.float64)
        may = (table["d"] == FRONT_LIDAR).to_numpy() | (int(path.name[:2]) not in frames)
        yield xyz[may], labels["class"].to_numpy()[may]


def _outlines(grid: np.ndarray, gap: int, height: np.ndarray) -> Iterator[list[np.ndarray]]:
    """The outline and holes, (N, 3) each, of every piece of a surface, from the grid's corner."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap, gap))
    closed = cv2.morphologyEx(grid, cv2.MORPH_CLOSE, kernel)
    # Contours run through the middles of pixels: with two a cell, a lone cell encloses something.
    fine = closed.repeat(2, axis=0).repeat(2, axis=1)
    contours, tree = cv2.findContours(fine, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    pieces: dict[int, list[np.ndarray]] = {}
    for number, contour in enumerate(contours):
        outline = tree[0, number, 3]  # of a hole; -1 of an outline
        places = contour[:, 0]
        column, row = (places // 2).T
        ring = np.column_stack([(places + 0.5) * CELL / 2, height[row, column]])
        pieces.setdefault(number if outline < 0 else outline, []).append(ring)
    yield from pieces.values()
