"""Roads, markings, kerbs, pavements and verges, and the map of them."""

from typing import NamedTuple

import numpy as np

from geoevs.scenes.road_map import Polygon, RoadMap
from geoevs.scenes.sources.street.layout import (
    CORNER_RADIUS,
    KERB_HEIGHT,
    Crossing,
    KerbLine,
    Path,
    Street,
)
from geoevs.scenes.sources.street.mesh import MeshBuilder

WHITE, YELLOW = (0.62, 0.62, 0.60), (0.62, 0.43, 0.07)
LINE = 0.12  # width of a marking
# Thin layers must stay apart for the ray caster.
WORN_HEIGHT, PATCH_HEIGHT, PAINT_HEIGHT = 0.002, 0.004, 0.008
FAR = 400.0
SURFACE_OF = {
    "asphalt": "drivable",
    "white": "marking",
    "yellow": "marking",
    "paving": "sidewalk",
}
"""What a map calls a finish."""


class _Ground(NamedTuple):
    """Where everything that lies flat goes."""

    builder: MeshBuilder
    polygons: list[Polygon]


def add_ground(builder: MeshBuilder, street: Street, rng: np.random.Generator) -> RoadMap:
    """Add everything that lies flat, out to the horizon; the map of it comes back."""
    ground = _Ground(builder, [])
    _add_ground(ground, street, rng)
    return RoadMap(ground.polygons)


def _add_ground(ground: _Ground, street: Street, rng: np.random.Generator) -> None:
    plane = np.array([[-FAR, -FAR], [FAR, -FAR], [FAR, FAR], [-FAR, FAR]])
    _flat(ground, "grass", plane[None], -0.05)
    half = street.half_width
    if street.crossing is None:
        _strip(ground, "asphalt", street.path, _whole(street.path), -half, half, 0.0)
        zebra = rng.uniform(11, 24)
        _mark_lanes(ground, street, street.path, (street.path.first, zebra - 2))
        _mark_lanes(ground, street, street.path, (zebra + 2, street.path.last))
        _mark_crosswalk(ground, street.path, zebra, half)
    else:
        _add_crossing(ground, street, street.crossing)
    _wear(ground, street, rng)
    for kerb in street.kerbs:
        _add_pavement(ground, street, kerb)


def _whole(path: Path) -> tuple[float, float]:
    return path.first, path.last


def _add_crossing(ground: _Ground, street: Street, crossing: Crossing) -> None:
    half, at = street.half_width, crossing.at
    main, cross = street.path, crossing.path
    _strip(ground, "asphalt", main, _whole(main), -half, half, 0.0)
    for span in ((cross.first, -half), (half, cross.last)):
        _strip(ground, "asphalt", cross, span, -half, half, 0.0)
    # The rounded corners of the blocks leave road outside the two bands: asphalt lies a little
    # under everything there.
    wide = half + CORNER_RADIUS + 1
    _strip(ground, "asphalt", main, (at - wide, at + wide), -wide, wide, -0.02)
    ground.polygons.append(Polygon("drivable", [_rise(_junction(street, crossing), 0.0)]))
    walk, gap = CORNER_RADIUS + 0.2, 3.2  # from the junction to the zebra; length of a zebra
    arms = (
        (main, (main.first, at - half - walk - gap - 1.0), at - half - walk - gap / 2, -1),
        (main, (at + half + walk + gap + 1.0, main.last), at + half + walk + gap / 2, 1),
        (cross, (cross.first, -half - walk - gap - 1.0), -half - walk - gap / 2, -1),
        (cross, (half + walk + gap + 1.0, cross.last), half + walk + gap / 2, 1),
    )
    for path, span, zebra, side in arms:
        _mark_lanes(ground, street, path, span)
        _mark_crosswalk(ground, path, zebra, half)
        stop = zebra + side * (gap / 2 + 0.8)
        # Traffic keeps right, so those who come towards the junction have it on their right.
        low, high = (-half + street.parking, -0.2) if side < 0 else (0.2, half - street.parking)
        _strip(ground, "white", path, (stop - 0.2, stop + 0.2), low, high, PAINT_HEIGHT)


def _strip(
    ground: _Ground,
    finish: str,
    path: Path,
    span: tuple[float, float],
    low: float,
    high: float,
    height: float,
) -> None:
    """A band along a path between two offsets; `white` and `yellow` are paint."""
    pieces = max(int(np.ceil((span[1] - span[0]) / 2.0)), 1)
    s = np.linspace(*span, pieces + 1)
    right, left = path.at(s, low), path.at(s, high)
    _flat(ground, finish, np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1), height)


def _flat(ground: _Ground, finish: str, plan: np.ndarray, height: float) -> None:
    """(N, 4, 2) horizontal quads in a row; the map has them, unless something lies over them."""
    corners = _rise(plan, height)
    if finish in SURFACE_OF and height >= 0:
        ring = np.concatenate([corners[:, 0], corners[-1:, 1], corners[-1:, 2], corners[::-1, 3]])
        ground.polygons.append(Polygon(SURFACE_OF[finish], [ring]))
    paint = {"white": WHITE, "yellow": YELLOW}
    if finish in paint:
        ground.builder.quads("matte", corners, paint[finish])
    else:
        ground.builder.quads(finish, corners, (1, 1, 1), uv=plan)


def _rise(plan: np.ndarray, height: float) -> np.ndarray:
    """(..., 3) points of a plan (..., 2) at a height."""
    return np.concatenate([plan, np.full((*plan.shape[:-1], 1), height)], axis=-1)


def _junction(street: Street, crossing: Crossing) -> np.ndarray:
    """(N, 2) the outline of a junction up to its kerbs' straight legs, counter-clockwise."""
    bends = [kerb.offset(0.0)[kerb.legs[0].stop : kerb.legs[1].start] for kerb in street.kerbs]
    corners = np.concatenate(bends)
    x, y = (corners - crossing.path.at(0.0)).T
    return corners[np.argsort(np.arctan2(y, x))]


def _mark_lanes(ground: _Ground, street: Street, path: Path, span: tuple[float, float]) -> None:
    def line(offset: float, colour: str, stretch: tuple[float, float] = span) -> None:
        low, high = offset - LINE / 2, offset + LINE / 2
        _strip(ground, colour, path, stretch, low, high, PAINT_HEIGHT)

    if street.lanes == 2:
        line(-0.14, "yellow")
        line(0.14, "yellow")
        for side in (-1, 1):
            for s in np.arange(span[0] + 1, span[1] - 3, 7.5):
                line(side * street.lane, "white", (s, s + 3))
    else:
        for s in np.arange(span[0] + 1, span[1] - 3, 6.0):
            line(0.0, "white", (s, s + 3))
    edge = street.lanes * street.lane
    for side in (-1, 1):
        line(side * (edge - (0.0 if street.parking else 0.25)), "white")
        if street.parking:
            for s in np.arange(span[0] + 2, span[1] - 2, 5.8):
                low, high = sorted((side * edge, side * (edge + street.parking - 0.1)))
                _strip(ground, "white", path, (s, s + 0.1), low, high, PAINT_HEIGHT)


def _mark_crosswalk(ground: _Ground, path: Path, at: float, half: float) -> None:
    for offset in np.arange(-half + 0.4, half - 0.4, 1.0):
        _strip(ground, "white", path, (at - 1.6, at + 1.6), offset, offset + 0.5, PAINT_HEIGHT)
    right, left = (path.at(np.array([at - 1.6, at + 1.6]), side) for side in (-half, half))
    outline = np.concatenate([right, left[::-1]])
    ground.polygons.append(Polygon("crossing", [_rise(outline, PAINT_HEIGHT)]))


def _wear(ground: _Ground, street: Street, rng: np.random.Generator) -> None:
    """Wheel tracks, repaired patches, manholes, drains and cracks."""
    half = street.half_width
    for lane in np.arange(street.lanes) + 0.5:
        for track in (-0.75, 0.75):
            for side in (-1, 1):
                middle = side * lane * street.lane + track
                edges = middle - 0.3, middle + 0.3
                _strip(ground, "worn", street.path, _whole(street.path), *edges, WORN_HEIGHT)
    for _ in range(14):
        s, length = rng.uniform(-15, 70), rng.uniform(1.5, 9)
        low = rng.uniform(-half + 0.3, half - 1.5)
        high = min(low + rng.uniform(0.6, 2.2), half - 0.2)
        _strip(ground, "patch", street.path, (s, s + length), low, high, PATCH_HEIGHT)
    circle = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    ring = 0.34 * np.stack([np.cos(circle), np.sin(circle), 0 * circle], axis=1)
    for _ in range(8):
        centre = street.path.at(rng.uniform(-10, 60), rng.uniform(-0.6, 0.6) * half)
        lid = ring + np.append(centre, 0.006)
        middle = np.broadcast_to(lid.mean(axis=0), lid.shape)
        corners = np.stack([lid, np.roll(lid, -1, axis=0), middle], axis=1)
        ground.builder.triangles("matte", corners, (0.06, 0.055, 0.05))
    for _ in range(24):
        steps = int(rng.integers(5, 14))
        places = rng.uniform(-10, 60) + np.cumsum(rng.uniform(0.1, 0.5, steps))
        offset = rng.uniform(-half, half) + np.cumsum(rng.normal(0, 0.13, steps))
        offset = np.clip(offset, -half + 0.2, half - 0.2)
        right, left = (street.path.at(places, offset + aside) for aside in (-0.012, 0.012))
        plan = np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1)
        corners = _rise(plan, 0.006)
        ground.builder.quads("matte", corners, (0.035, 0.035, 0.035))


def _add_pavement(ground: _Ground, street: Street, kerb: KerbLine) -> None:
    """Kerb stone, verge, sidewalk and the ground of the block behind, outward from a kerb line."""
    stone = 0.18
    foot, edge, back = kerb.offset(0.0), kerb.offset(0.02), kerb.offset(stone)

    low, top, inner = _rise(foot, 0.0), _rise(edge, KERB_HEIGHT), _rise(back, KERB_HEIGHT)
    shades = 0.36 + 0.05 * np.sin(np.arange(len(foot) - 1) * 2.4)[:, None] * np.ones(3)
    for outside, inside in ((low, top), (top, inner)):
        quads = np.stack([outside[:-1], outside[1:], inside[1:], inside[:-1]], axis=1)
        ground.builder.quads("matte", quads, shades)
    behind = street.facade - street.setback
    bands = [(stone, stone + street.verge, "grass"), (stone + street.verge, behind, "paving")]
    bands.append((behind, street.facade + 0.3, "grass" if street.setback else "paving"))
    bands.append((street.facade + 0.3, 26.0, "grass"))
    for near, far, finish in bands:
        if far - near > 1e-6:
            inner, outer = kerb.offset(near), kerb.offset(far)
            plan = np.stack([inner[:-1], inner[1:], outer[1:], outer[:-1]], axis=1)
            _flat(ground, finish, plan, KERB_HEIGHT)
