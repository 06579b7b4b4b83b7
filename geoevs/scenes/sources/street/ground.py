"""Roads, markings, kerbs, pavements and verges."""

import numpy as np

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


def add_ground(builder: MeshBuilder, street: Street, rng: np.random.Generator) -> None:
    """Add everything that lies flat, out to the horizon."""
    plane = np.array([[-FAR, -FAR], [FAR, -FAR], [FAR, FAR], [-FAR, FAR]])
    _flat(builder, "grass", plane[None], -0.05)
    half = street.half_width
    if street.crossing is None:
        _strip(builder, "asphalt", street.path, _whole(street.path), -half, half, 0.0)
        zebra = rng.uniform(11, 24)
        _mark_lanes(builder, street, street.path, (street.path.first, zebra - 2))
        _mark_lanes(builder, street, street.path, (zebra + 2, street.path.last))
        _mark_crosswalk(builder, street.path, zebra, half)
    else:
        _add_crossing(builder, street, street.crossing)
    _wear(builder, street, rng)
    for kerb in street.kerbs:
        _add_pavement(builder, street, kerb)


def _whole(path: Path) -> tuple[float, float]:
    return path.first, path.last


def _add_crossing(builder: MeshBuilder, street: Street, crossing: Crossing) -> None:
    half, at = street.half_width, crossing.at
    main, cross = street.path, crossing.path
    _strip(builder, "asphalt", main, _whole(main), -half, half, 0.0)
    for span in ((cross.first, -half), (half, cross.last)):
        _strip(builder, "asphalt", cross, span, -half, half, 0.0)
    # The rounded corners of the blocks leave road outside the two bands: asphalt lies a little
    # under everything there.
    wide = half + CORNER_RADIUS + 1
    _strip(builder, "asphalt", main, (at - wide, at + wide), -wide, wide, -0.02)
    walk, gap = CORNER_RADIUS + 0.2, 3.2  # from the junction to the zebra; length of a zebra
    arms = (
        (main, (main.first, at - half - walk - gap - 1.0), at - half - walk - gap / 2, -1),
        (main, (at + half + walk + gap + 1.0, main.last), at + half + walk + gap / 2, 1),
        (cross, (cross.first, -half - walk - gap - 1.0), -half - walk - gap / 2, -1),
        (cross, (half + walk + gap + 1.0, cross.last), half + walk + gap / 2, 1),
    )
    for path, span, zebra, side in arms:
        _mark_lanes(builder, street, path, span)
        _mark_crosswalk(builder, path, zebra, half)
        stop = zebra + side * (gap / 2 + 0.8)
        # Traffic keeps right, so those who come towards the junction have it on their right.
        low, high = (-half + street.parking, -0.2) if side < 0 else (0.2, half - street.parking)
        _strip(builder, "white", path, (stop - 0.2, stop + 0.2), low, high, PAINT_HEIGHT)


def _strip(
    builder: MeshBuilder,
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
    _flat(builder, finish, np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1), height)


def _flat(builder: MeshBuilder, finish: str, plan: np.ndarray, height: float) -> None:
    """(N, 4, 2) horizontal quads."""
    corners = np.concatenate([plan, np.full((*plan.shape[:2], 1), height)], axis=2)
    paint = {"white": WHITE, "yellow": YELLOW}
    if finish in paint:
        builder.quads("matte", corners, paint[finish])
    else:
        builder.quads(finish, corners, (1, 1, 1), uv=plan)


def _mark_lanes(
    builder: MeshBuilder, street: Street, path: Path, span: tuple[float, float]
) -> None:
    def line(offset: float, colour: str, stretch: tuple[float, float] = span) -> None:
        low, high = offset - LINE / 2, offset + LINE / 2
        _strip(builder, colour, path, stretch, low, high, PAINT_HEIGHT)

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
                _strip(builder, "white", path, (s, s + 0.1), low, high, PAINT_HEIGHT)


def _mark_crosswalk(builder: MeshBuilder, path: Path, at: float, half: float) -> None:
    for offset in np.arange(-half + 0.4, half - 0.4, 1.0):
        _strip(builder, "white", path, (at - 1.6, at + 1.6), offset, offset + 0.5, PAINT_HEIGHT)


def _wear(builder: MeshBuilder, street: Street, rng: np.random.Generator) -> None:
    """Wheel tracks, repaired patches, manholes, drains and cracks."""
    half = street.half_width
    for lane in np.arange(street.lanes) + 0.5:
        for track in (-0.75, 0.75):
            for side in (-1, 1):
                middle = side * lane * street.lane + track
                edges = middle - 0.3, middle + 0.3
                _strip(builder, "worn", street.path, _whole(street.path), *edges, WORN_HEIGHT)
    for _ in range(14):
        s, length = rng.uniform(-15, 70), rng.uniform(1.5, 9)
        low = rng.uniform(-half + 0.3, half - 1.5)
        high = min(low + rng.uniform(0.6, 2.2), half - 0.2)
        _strip(builder, "patch", street.path, (s, s + length), low, high, PATCH_HEIGHT)
    circle = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    ring = 0.34 * np.stack([np.cos(circle), np.sin(circle), 0 * circle], axis=1)
    for _ in range(8):
        centre = street.path.at(rng.uniform(-10, 60), rng.uniform(-0.6, 0.6) * half)
        lid = ring + np.append(centre, 0.006)
        middle = np.broadcast_to(lid.mean(axis=0), lid.shape)
        corners = np.stack([lid, np.roll(lid, -1, axis=0), middle], axis=1)
        builder.triangles("matte", corners, (0.06, 0.055, 0.05))
    for _ in range(24):
        steps = int(rng.integers(5, 14))
        places = rng.uniform(-10, 60) + np.cumsum(rng.uniform(0.1, 0.5, steps))
        offset = rng.uniform(-half, half) + np.cumsum(rng.normal(0, 0.13, steps))
        offset = np.clip(offset, -half + 0.2, half - 0.2)
        right, left = (street.path.at(places, offset + aside) for aside in (-0.012, 0.012))
        plan = np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1)
        corners = np.concatenate([plan, np.full((*plan.shape[:2], 1), 0.006)], axis=2)
        builder.quads("matte", corners, (0.035, 0.035, 0.035))


def _add_pavement(builder: MeshBuilder, street: Street, kerb: KerbLine) -> None:
    """Kerb stone, verge, sidewalk and the ground of the block behind, outward from a kerb line."""
    stone = 0.18
    foot, edge, back = kerb.offset(0.0), kerb.offset(0.02), kerb.offset(stone)

    def rise(line: np.ndarray, height: float) -> np.ndarray:
        return np.concatenate([line, np.full((len(line), 1), height)], axis=1)

    low, top, inner = rise(foot, 0.0), rise(edge, KERB_HEIGHT), rise(back, KERB_HEIGHT)
    shades = 0.36 + 0.05 * np.sin(np.arange(len(foot) - 1) * 2.4)[:, None] * np.ones(3)
    for outside, inside in ((low, top), (top, inner)):
        quads = np.stack([outside[:-1], outside[1:], inside[1:], inside[:-1]], axis=1)
        builder.quads("matte", quads, shades)
    behind = street.facade - street.setback
    bands = [(stone, stone + street.verge, "grass"), (stone + street.verge, behind, "paving")]
    bands.append((behind, street.facade + 0.3, "grass" if street.setback else "paving"))
    bands.append((street.facade + 0.3, 26.0, "grass"))
    for near, far, finish in bands:
        if far - near > 1e-6:
            inner, outer = kerb.offset(near), kerb.offset(far)
            plan = np.stack([inner[:-1], inner[1:], outer[1:], outer[:-1]], axis=1)
            _flat(builder, finish, plan, KERB_HEIGHT)
