"""Houses with real openings: facades, windows, doors, shop fronts, cornices, balconies, roofs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoevs.scenes.sources.street.finishes import WALLS
from geoevs.scenes.sources.street.layout import KERB_HEIGHT, Street, is_near
from geoevs.scenes.sources.street.mesh import MeshBuilder, boxes

DEPTH = 12.0  # of a building
RECESS = 0.16  # of the glass behind the facade
WOOD = ((0.30, 0.13, 0.07), (0.08, 0.16, 0.12), (0.10, 0.12, 0.22), (0.35, 0.06, 0.05))
FRAMES = ((0.72, 0.72, 0.70), (0.10, 0.10, 0.11), (0.26, 0.15, 0.08), (0.60, 0.62, 0.60))
SHOP_SIGNS = ((0.5, 0.04, 0.04), (0.03, 0.12, 0.35), (0.02, 0.22, 0.12), (0.6, 0.42, 0.03))


class Wall:
    """A vertical rectangle's own axes: u along it, v up, n outward, in metres.

    `start` to `end` runs with the outside on the right.
    """

    def __init__(self, start: np.ndarray, end: np.ndarray, foot: float) -> None:
        along = np.append(end - start, 0.0)
        self.width = float(np.linalg.norm(along))
        self._along = along / self.width
        self._out = np.array([self._along[1], -self._along[0], 0.0])
        self._origin = np.append(start, foot)
        self.near = is_near((start + end) / 2)

    def world(self, local: np.ndarray) -> np.ndarray:
        """World points of (..., 3) local (u, v, n) points."""
        up = np.array([0.0, 0.0, 1.0])
        return self._origin + local @ np.stack([self._along, up, self._out])

    def panels(
        self,
        builder: MeshBuilder,
        finish: str,
        spans: ArrayLike,  # [N, 4] or [4]
        depth: float,
        colour: ArrayLike,  # [3] or [N, 3]
    ) -> None:
        """Add (N, 4) rectangles (u0, u1, v0, v1) that face outward at `depth`."""
        edges = np.atleast_2d(spans).astype(float)
        u, v = edges[:, [0, 1, 1, 0]], edges[:, [2, 2, 3, 3]]
        local = np.stack([u, v, np.full_like(u, depth)], axis=-1)
        builder.quads(finish, self.world(local), colour, uv=local[..., :2])

    def bars(
        self,
        builder: MeshBuilder,
        finish: str,
        low: ArrayLike,  # [N, 3]
        high: ArrayLike,  # [N, 3]
        colour: ArrayLike,  # [3] or [N, 3]
    ) -> None:
        """Add boxes between (N, 3) local corners."""
        if np.size(low):
            builder.quads(finish, self.world(boxes(low, high)), colour)


@dataclass(frozen=True)
class Style:
    """The looks of one building's facades; lengths in metres, colours in linear RGB."""

    finish: str
    floors: int
    floor_height: float
    bay: float
    window: tuple[float, float, float]  # width, height, sill above the floor
    frame: tuple[float, ...]
    trim: tuple[float, ...]
    shop: bool
    balconies: bool
    pitched: bool

    @property
    def height(self) -> float:
        """The height in metres from the pavement to the top of the wall."""
        return self.floors * self.floor_height + 0.5


def make_style(rng: np.random.Generator, corner: bool) -> Style:
    """A random building style; corner buildings are larger."""
    floors = int(rng.integers(3, 6) if corner else rng.integers(2, 6))
    pitched = floors < 4 and rng.random() < 0.6
    window = (rng.uniform(1.0, 1.5), rng.uniform(1.4, 1.8), rng.uniform(0.7, 0.95))
    trim = np.array([0.62, 0.60, 0.55]) * rng.uniform(0.5, 1.15)
    return Style(
        finish=f"wall-{rng.integers(WALLS)}",
        floors=floors,
        floor_height=rng.uniform(2.9, 3.4),
        bay=rng.uniform(2.3, 3.1),
        window=window,
        frame=FRAMES[rng.integers(len(FRAMES))],
        trim=tuple(trim),
        shop=floors > 2 and rng.random() < 0.45,
        balconies=floors > 2 and rng.random() < 0.35,
        pitched=pitched,
    )


def add_buildings(
    builder: MeshBuilder, street: Street, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Line every kerb with buildings; returns the (start, end) of the gaps left for gardens."""
    gardens = []
    for kerb in street.kerbs:
        line = kerb.offset(street.facade)
        corner = len(kerb.legs) == 2
        for number, leg in enumerate(kerb.legs):
            points = line[leg]
            if number == 0 and corner:
                gardens += _fill(builder, points[::-1], 0.0, True, True, rng)
            else:
                begin = DEPTH if corner else 0.0
                gardens += _fill(builder, points, begin, False, corner, rng)
    return gardens


def _fill(
    builder: MeshBuilder,
    points: np.ndarray,  # [N, 2]
    begin: float,
    backwards: bool,
    corner: bool,
    rng: np.random.Generator,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Buildings along a line; `backwards` where the block lies on the right of the points."""
    gardens = []
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    place = begin
    first = True
    while place < length[-1] - 6:
        width = DEPTH if corner and backwards and first else rng.uniform(8, 15)
        ends = np.stack(
            [np.interp([place, place + width], length, points[:, axis]) for axis in (0, 1)], axis=1
        )
        start, end = ends[::-1] if backwards else ends
        if not first and rng.random() < 0.08:
            gardens.append((start, end))
        else:
            _add_building(builder, start, end, make_style(rng, corner and first), rng)
        place += width + (rng.uniform(1.5, 3) if rng.random() < 0.12 else 0.0)
        first = False
    return gardens


def _add_building(
    builder: MeshBuilder,
    start: np.ndarray,
    end: np.ndarray,
    style: Style,
    rng: np.random.Generator,
) -> None:
    along = (end - start) / np.linalg.norm(end - start)
    inward = np.array([-along[1], along[0]]) * DEPTH
    ring = [start, end, end + inward, start + inward]
    for side in range(4):
        wall = Wall(ring[side], ring[(side + 1) % 4], KERB_HEIGHT)
        if side == 2:
            wall.panels(builder, style.finish, [0, wall.width, 0, style.height], 0.0, (1, 1, 1))
        else:
            _add_facade(builder, wall, style, side == 0, rng)
    front = Wall(start, end, KERB_HEIGHT)
    if style.pitched:
        _add_gable_roof(builder, front, style)
    else:
        _add_flat_roof(builder, front, style)


def _add_facade(
    builder: MeshBuilder, wall: Wall, style: Style, front: bool, rng: np.random.Generator
) -> None:
    bays = max(int(wall.width / style.bay), 1)
    centres = (np.arange(bays) + 0.5) * wall.width / bays
    width, height, sill = style.window
    door_bay = int(rng.integers(bays)) if front else -1
    for floor in range(style.floors):
        foot = floor * style.floor_height
        top = foot + style.floor_height + (0.5 if floor == style.floors - 1 else 0.0)
        half = np.full(bays, width / 2)
        low, high = np.full(bays, foot + sill), np.full(bays, foot + sill + height)
        if floor == 0 and front and style.shop:
            half[:] = wall.width / bays / 2 - 0.22
            low[:], high[:] = foot + 0.45, foot + 2.55
            _add_shop_sign(builder, wall, foot + 2.62, rng)
        elif floor == 0 and not front:
            low[:] = high[:] = foot  # blank: side walls have no windows at street level
        if floor == 0 and front:
            half[door_bay], low[door_bay], high[door_bay] = 0.55, foot, foot + 2.2
        spans = np.stack([centres - half, centres + half, low, high], axis=1)
        open_ = high > low
        _add_pierced_band(builder, wall, style.finish, spans[open_], foot, top)
        doors = np.arange(bays) == (door_bay if floor == 0 else -1)
        _add_windows(builder, wall, spans[open_ & ~doors], style, rng)
        _add_doors(builder, wall, spans[doors], rng)
        if floor and front and style.balconies and wall.near:
            chosen = np.arange(bays) % 2 == (door_bay % 2)
            _add_balconies(builder, wall, centres[chosen], foot, style)
    if front:
        _add_trim(builder, wall, style)


def _add_pierced_band(
    builder: MeshBuilder,
    wall: Wall,
    finish: str,
    openings: np.ndarray,  # [N, 4]
    foot: float,
    top: float,
) -> None:
    """Wall between two heights, around its openings, and their reveals."""
    left = np.concatenate([[0.0], openings[:, 1]])
    right = np.concatenate([openings[:, 0], [wall.width]])
    bands = [np.stack([left, right, np.full_like(left, foot), np.full_like(left, top)], axis=1)]
    for low, high in ((foot, openings[:, 2]), (openings[:, 3], top)):
        pair = np.broadcast_arrays(openings[:, 0], openings[:, 1], low, high)
        bands.append(np.stack(pair, axis=1))
    solid = np.concatenate(bands)
    solid = solid[(solid[:, 1] > solid[:, 0]) & (solid[:, 3] > solid[:, 2])]
    wall.panels(builder, finish, solid, 0.0, (1, 1, 1))
    if len(openings) == 0:
        return
    u0, u1, v0, v1 = openings.T
    out, deep = np.zeros_like(u0), np.full_like(u0, -RECESS)
    jambs = (
        ((u0, v0, deep), (u0, v1, deep), (u0, v1, out), (u0, v0, out)),
        ((u1, v0, deep), (u1, v0, out), (u1, v1, out), (u1, v1, deep)),
        ((u0, v0, deep), (u0, v0, out), (u1, v0, out), (u1, v0, deep)),
        ((u0, v1, deep), (u1, v1, deep), (u1, v1, out), (u0, v1, out)),
    )
    for jamb in jambs:
        local = np.stack([np.stack(corner, axis=1) for corner in jamb], axis=1)
        builder.quads("matte", wall.world(local), (0.34, 0.32, 0.30))


def _add_windows(
    builder: MeshBuilder,
    wall: Wall,
    spans: np.ndarray,  # [N, 4]
    style: Style,
    rng: np.random.Generator,
) -> None:
    if len(spans) == 0:
        return
    u0, u1, v0, v1 = spans.T
    # Blinds or curtains hide the upper part of some windows; the rest shows a dark room.
    blind = np.where(rng.random(len(spans)) < 0.4, rng.uniform(0.15, 0.7, len(spans)), 0.0)
    cut = v1 - blind * (v1 - v0)
    rooms = np.array([0.03, 0.034, 0.04]) * rng.uniform(0.5, 1.8, (len(spans), 1))
    cloth = np.array([0.46, 0.43, 0.37]) * rng.uniform(0.5, 1.0, (len(spans), 1))
    wall.panels(builder, "glass", np.stack([u0, u1, v0, cut], axis=1), -RECESS, rooms)
    hung = blind > 0
    upper = np.stack([u0, u1, cut, v1], axis=1)
    if hung.any():
        wall.panels(builder, "glass", upper[hung], -RECESS, cloth[hung])
    rail, back, face = 0.07, np.full_like(u0, -RECESS), np.full_like(u0, -RECESS + 0.05)
    middle, transom = (u0 + u1) / 2, v0 + 0.68 * (v1 - v0)
    sill_low = np.stack([u0 - 0.08, v0 - 0.09, back], axis=1)
    sill_high = np.stack([u1 + 0.08, v0, np.full_like(u0, 0.09)], axis=1)
    wall.bars(builder, "matte", sill_low, sill_high, style.trim)
    if not wall.near:
        return
    frames = (
        (u0, u0 + rail, v0, v1),
        (u1 - rail, u1, v0, v1),
        (u0, u1, v0, v0 + rail),
        (u0, u1, v1 - rail, v1),
        (middle - rail / 2, middle + rail / 2, v0, v1),
        (u0, u1, transom - rail / 2, transom + rail / 2),
    )
    for a, b, c, d in frames:
        low, high = np.stack([a, c, back], axis=1), np.stack([b, d, face], axis=1)
        wall.bars(builder, "matte", low, high, style.frame)
    head_low = np.stack([u0 - 0.1, v1, np.zeros_like(u0)], axis=1)
    head_high = np.stack([u1 + 0.1, v1 + 0.16, np.full_like(u0, 0.05)], axis=1)
    wall.bars(builder, "matte", head_low, head_high, style.trim)


def _add_doors(
    builder: MeshBuilder, wall: Wall, spans: np.ndarray, rng: np.random.Generator
) -> None:
    for u0, u1, v0, v1 in spans:
        colour = np.array(WOOD[rng.integers(len(WOOD))])
        wall.panels(builder, "matte", [u0, u1, v0, v1], -RECESS, colour)
        u = np.array([u0 + 0.12, (u0 + u1) / 2 + 0.06])
        low = np.array([[a, v0 + b, -RECESS] for a in u for b in (0.15, 1.0)])
        high = low + np.array([(u1 - u0) / 2 - 0.18, 0.7, 0.03])
        wall.bars(builder, "matte", low, high, colour * 0.7)
        wall.bars(
            builder, "matte", [[u0 - 0.1, v0 - 0.02, 0]], [[u1 + 0.1, v0 + 0.14, 0.5]], (0.4,) * 3
        )
        wall.bars(
            builder, "matte", [[u0 - 0.2, v1 + 0.1, 0]], [[u1 + 0.2, v1 + 0.2, 0.8]], (0.2,) * 3
        )
        wall.bars(builder, "matte", [[u1 - 0.12, v0 + 1.0, -RECESS]],
                  [[u1 - 0.08, v0 + 1.1, -RECESS + 0.08]], (0.6, 0.5, 0.2))  # fmt: skip


def _add_shop_sign(builder: MeshBuilder, wall: Wall, foot: float, rng: np.random.Generator) -> None:
    colour = np.array(SHOP_SIGNS[rng.integers(len(SHOP_SIGNS))])
    wall.bars(builder, "matte", [[0.2, foot, 0]], [[wall.width - 0.2, foot + 0.55, 0.12]], colour)
    letters = int(rng.integers(5, 11))
    u = wall.width / 2 + (np.arange(letters) - letters / 2) * 0.36
    tall = rng.uniform(0.2, 0.34, letters)
    low = np.stack([u, np.full(letters, foot + 0.12), np.full(letters, 0.12)], axis=1)
    high = low + np.stack([rng.uniform(0.1, 0.28, letters), tall, np.full(letters, 0.03)], axis=1)
    wall.bars(builder, "matte", low, high, (0.75, 0.73, 0.66))
    if rng.random() < 0.5:  # an awning
        v, out = foot, 1.3
        stripes = np.arange(0.3, wall.width - 0.3, 0.35)
        for number, u0 in enumerate(stripes):
            u1 = min(u0 + 0.35, wall.width - 0.3)
            local = np.array([[u0, v - 0.5, out], [u1, v - 0.5, out], [u1, v, 0.12], [u0, v, 0.12]])
            tone = colour if number % 2 else np.array([0.7, 0.68, 0.62])
            builder.quads("matte", wall.world(local)[None], tone)
            builder.quads("matte", wall.world(local[::-1] - [0, 0.01, 0])[None], tone * 0.6)


def _add_balconies(
    builder: MeshBuilder, wall: Wall, centres: np.ndarray, foot: float, style: Style
) -> None:
    half, out = style.window[0] / 2 + 0.35, 0.95
    count = len(centres)
    if count == 0:
        return

    def slab(
        u0: float, u1: float, v0: float, v1: float, n0: float, n1: float, colour: ArrayLike
    ) -> None:
        low = np.stack([centres + u0, np.full(count, foot + v0), np.full(count, n0)], axis=1)
        high = np.stack([centres + u1, np.full(count, foot + v1), np.full(count, n1)], axis=1)
        wall.bars(builder, "matte", low, high, colour)

    slab(-half, half, 0.12, 0.27, 0, out, style.trim)
    slab(-half, half, 1.18, 1.23, out - 0.05, out, (0.06,) * 3)
    for side in (-half, half - 0.05):
        slab(side, side + 0.05, 1.18, 1.23, 0, out, (0.06,) * 3)
    for u in np.linspace(-half, half - 0.03, 9):
        slab(u, u + 0.03, 0.27, 1.18, out - 0.04, out - 0.01, (0.06,) * 3)


def _add_trim(builder: MeshBuilder, wall: Wall, style: Style) -> None:
    width, top = wall.width, style.height
    base = style.floor_height
    low = [[-0.1, top - 0.35, 0], [0, base - 0.12, 0]]
    high = [[width + 0.1, top, 0.3], [width, base + 0.1, 0.08]]
    count = 1 if style.shop else 2  # a shop has its sign there
    wall.bars(builder, "matte", np.array(low[:count]), np.array(high[:count]), style.trim)
    # A gutter pipe at the joint of two houses.
    pipe_low, pipe_high = [[0.1, 0.1, 0.02]], [[0.2, top - 0.35, 0.12]]
    wall.bars(builder, "matte", pipe_low, pipe_high, (0.2, 0.2, 0.2))


def _add_flat_roof(builder: MeshBuilder, front: Wall, style: Style) -> None:
    top, width = style.height, front.width
    low = np.array([[0, top, -DEPTH]])
    high = np.array([[width, top + 0.25, 0.02]])
    front.bars(builder, "matte", low, high, (0.3, 0.3, 0.3))
    low = np.array([[width * 0.3, top + 0.25, -6.0], [width * 0.7, top + 0.25, -4.0]])
    high = low + np.array([[2.2, 1.6, 2.5], [0.7, 1.4, 0.7]])
    front.bars(builder, "matte", low, high, (0.38, 0.34, 0.32))


def _add_gable_roof(builder: MeshBuilder, front: Wall, style: Style) -> None:
    top, width, ridge, eave = style.height, front.width, 0.32 * DEPTH, 0.5
    drop = eave * ridge / (DEPTH / 2)
    middle = -DEPTH / 2
    slopes = (
        ((0, top - drop, eave), (width, top - drop, eave),
         (width, top + ridge, middle), (0, top + ridge, middle)),
        ((width, top - drop, -DEPTH - eave), (0, top - drop, -DEPTH - eave),
         (0, top + ridge, middle), (width, top + ridge, middle)),
    )  # fmt: skip
    run = float(np.hypot(DEPTH / 2 + eave, ridge + drop))
    uv = np.array([[0, 0], [width, 0], [width, run], [0, run]])
    for slope in slopes:
        local = np.array(slope)
        builder.quads("roof", front.world(local)[None], (1, 1, 1), uv=uv[None])
        lower = local[::-1] - np.array([0, 0.12, 0])
        builder.quads("matte", front.world(lower)[None], (0.25, 0.22, 0.2))
    edge = np.array([[0, top - drop - 0.12, eave - 0.04]])
    front.bars(builder, "matte", edge, edge + np.array([width, 0.14, 0.06]), (0.6, 0.58, 0.54))
    for u, order in ((0.0, 1), (width, -1)):
        gable = np.array([[u, top, 0], [u, top + ridge, middle], [u, top, -DEPTH]])
        uv = gable[:, [2, 1]][None]
        turned = gable[::order]
        builder.triangles(style.finish, front.world(turned)[None], (1, 1, 1), uv=uv[:, ::order])
    chimney = np.array([[width * 0.25, top + ridge * 0.5, middle - 0.4]])
    stack = chimney + np.array([0.7, ridge * 0.5 + 1.0, 0.8])
    front.bars(builder, "matte", chimney, stack, (0.3, 0.16, 0.12))
