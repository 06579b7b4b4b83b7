"""Parked and moving cars: a lofted body, glass, wheels and lights, in several body styles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoevs.scenes.sources.street.mesh import MeshBuilder, add_tube, boxes, fan, loft

PAINTS = (
    (0.55, 0.55, 0.56), (0.03, 0.03, 0.035), (0.70, 0.70, 0.69), (0.22, 0.23, 0.25),
    (0.36, 0.02, 0.02), (0.03, 0.08, 0.28), (0.05, 0.16, 0.22), (0.10, 0.18, 0.08),
    (0.60, 0.30, 0.03), (0.30, 0.24, 0.16),
)  # fmt: skip
GLASS, RUBBER, BLACK = (0.025, 0.028, 0.032), (0.018, 0.018, 0.018), (0.012, 0.012, 0.012)


@dataclass(frozen=True)
class Body:
    """Proportions of a body style in metres; x forward from the middle of the car.

    `hood` and `deck` are belt heights at the front and the rear; the cabin's four x positions are
    where the rear window meets the deck, the roof's rear and front ends, and the windscreen's foot.
    `pillar` is the share of the side windows that the rear pillar takes.
    """

    length: float
    width: float
    height: float
    belt: float
    hood: float
    deck: float
    cabin: tuple[float, float, float, float]
    wheel: float
    pillar: float


BODIES = (
    Body(4.6, 1.82, 1.45, 0.92, 0.78, 0.90, (-1.75, -1.00, 0.35, 1.20), 0.33, 0.12),  # saloon
    Body(4.1, 1.78, 1.50, 0.94, 0.80, 0.92, (-1.98, -1.55, 0.25, 1.10), 0.32, 0.16),  # hatchback
    Body(4.7, 1.90, 1.72, 1.08, 0.96, 1.06, (-2.25, -1.80, 0.40, 1.15), 0.37, 0.2),  # SUV
    Body(5.0, 1.95, 2.00, 1.15, 1.02, 1.13, (-2.45, -2.30, 1.00, 1.85), 0.35, 0.3),  # van
)


def make_car(rng: np.random.Generator) -> tuple[MeshBuilder, Body]:
    """A car of random style and colour, standing at the origin and facing +x."""
    body = BODIES[rng.choice(len(BODIES), p=[0.4, 0.27, 0.23, 0.1])]
    paint = np.array(PAINTS[rng.integers(len(PAINTS))]) * rng.uniform(0.85, 1.1)
    car = MeshBuilder()
    _add_hull(car, body, paint)
    _add_cabin(car, body, paint)
    _add_wheels(car, body)
    _add_details(car, body)
    return car, body


def _add_hull(car: MeshBuilder, body: Body, paint: np.ndarray) -> None:
    half, rear, front = body.width / 2, -body.length / 2, body.length / 2
    stations = (rear, rear + 0.06, rear + 0.22, -0.9, body.cabin[3], front - 0.5, front - 0.12)
    x = np.array([*stations, front])
    narrow = np.array([0.86, 0.95, 1.0, 1.0, 1.0, 0.98, 0.90, 0.80])
    belt = np.array([body.deck - 0.12, body.deck - 0.03, body.deck, body.belt, body.belt,
                     body.hood, body.hood - 0.07, body.hood - 0.18])  # fmt: skip
    sill = np.array([0.42, 0.32, 0.24, 0.22, 0.22, 0.24, 0.30, 0.38])
    # A cross-section: the middle of the sill, up the left side, and down the right side.
    across = np.array([0.80, 0.97, 1.0, 0.985, 0.90, 0.55])
    raised = np.array([0.0, 0.12, 0.50, 0.85, 0.98, 1.01])
    across = np.concatenate([[0.0], across, -across[::-1]])
    raised = np.concatenate([[0.0], raised, raised[::-1]])
    rings = np.empty((len(x), len(across), 3))
    for number in range(len(x)):
        rings[number, :, 0] = x[number]
        rings[number, :, 1] = across * half * narrow[number]
        rings[number, :, 2] = sill[number] + raised * (belt[number] - sill[number])
    quads, normals = loft(rings)
    low = quads[:, :, 2].mean(axis=1) < 0.36
    car.quads("paint", quads[~low], paint, normals[~low])
    car.quads("matte", quads[low], BLACK)
    for ring in (rings[0][::-1], rings[-1]):
        car.triangles("paint", fan(ring), paint)


def _add_cabin(car: MeshBuilder, body: Body, paint: np.ndarray) -> None:
    half = body.width / 2
    foot, roof = body.belt - 0.03, body.height
    x_low = np.array([body.cabin[0], body.cabin[3]])
    x_top = np.array([body.cabin[1], body.cabin[2]])
    low, top = 0.90 * half, 0.72 * half
    base = np.array([[x_low[0], -low], [x_low[1], -low], [x_low[1], low], [x_low[0], low]])
    lid = np.array([[x_top[0], -top], [x_top[1], -top], [x_top[1], top], [x_top[0], top]])
    base = np.column_stack([base, np.full(4, foot)])
    lid = np.column_stack([lid, np.full(4, roof - 0.05)])
    sides = np.stack([base, np.roll(base, -1, 0), np.roll(lid, -1, 0), lid], axis=1)
    car.quads("glass", sides, GLASS)
    rear = body.pillar
    posts = ([(0.0, rear), (0.47, 0.51), (0.965, 1.0)], [(0.0, 0.05), (0.95, 1.0)])
    mirrored = [(1 - b, 1 - a) for a, b in posts[0]]
    # Right side, windscreen, left side, rear window: pillars lie a little above the glass.
    for quad, strips in zip(sides, (posts[0], posts[1], mirrored, posts[1]), strict=True):
        normal = np.cross(quad[1] - quad[0], quad[3] - quad[0])
        lift = 0.006 * normal / np.linalg.norm(normal)
        for a, b in strips:
            span = [(1 - t) * quad[0] + t * quad[1] for t in (a, b)]
            over = [(1 - t) * quad[3] + t * quad[2] for t in (b, a)]
            car.quads("paint", (np.array(span + over) + lift)[None], paint)
    crown = lid * [0.97, 0.9, 1] + [0, 0, 0.05]
    rings = np.stack([lid, crown])
    quads, _ = loft(rings)
    car.quads("paint", quads, paint)
    car.triangles("paint", fan(crown), paint)


def _add_wheels(car: MeshBuilder, body: Body) -> None:
    half, radius = body.width / 2, body.wheel
    for x in (-0.29 * body.length, 0.31 * body.length):
        for side in (-1, 1):
            inner, outer = (x, side * (half - 0.22), radius), (x, side * (half + 0.005), radius)
            arch_in = (x, side * (half - 0.24), radius + 0.02)
            arch_out = (x, side * (half + 0.002), radius + 0.02)
            add_tube(car, "matte", arch_in, arch_out, (radius + 0.08,) * 2, BLACK, 16)
            add_tube(car, "matte", inner, outer, (radius,) * 2, RUBBER, 16)
            hub = (x, side * (half + 0.012), radius)
            add_tube(car, "matte", outer, hub, (0.64 * radius,) * 2, (0.34, 0.34, 0.35), 10)


def _add_details(car: MeshBuilder, body: Body) -> None:
    half, front = body.width / 2, body.length / 2

    def box(low: ArrayLike, high: ArrayLike, colour: ArrayLike, finish: str = "matte") -> None:
        car.quads(finish, boxes(np.array([low]), np.array([high])), colour)

    for side in (-1, 1):
        lamp, tail = side * 0.66 * half, side * 0.72 * half
        box((front - 0.14, lamp - 0.17, body.hood - 0.26), (front + 0.01, lamp + 0.17,
            body.hood - 0.13), (0.72, 0.72, 0.70))  # fmt: skip
        box((-front - 0.015, tail - 0.15, body.deck - 0.26), (-front + 0.1, tail + 0.15,
            body.deck - 0.10), (0.42, 0.01, 0.01))  # fmt: skip
        mirror = side * (half + 0.06)
        box((body.cabin[3] - 0.35, mirror - 0.09, body.belt), (body.cabin[3] - 0.2, mirror + 0.09,
            body.belt + 0.14), BLACK)  # fmt: skip
    box((front - 0.05, -0.45 * half, 0.40), (front + 0.012, 0.45 * half, 0.56), BLACK)
    box((front, -0.26, 0.41), (front + 0.02, 0.26, 0.52), (0.6, 0.6, 0.58))
    box((-front - 0.02, -0.26, 0.50), (-front, 0.26, 0.61), (0.6, 0.6, 0.58))
