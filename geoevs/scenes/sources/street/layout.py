"""Where road, kerbs, pavements and building plots are: straight streets, curves and junctions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

REACH_BEHIND, REACH_AHEAD = 60.0, 150.0  # metres of street around the start
STEP = 0.25
KERB_HEIGHT = 0.14
CORNER_RADIUS = 5.0  # of kerbs at a junction
DETAIL_CENTRE, DETAIL_RADIUS = np.array([15.0, 0.0]), 38.0
LAYOUTS = ("straight", "curve", "junction")


def is_near(place: np.ndarray) -> bool:
    """Whether things at (2,) `place` come close enough to the ego to deserve fine detail."""
    return bool(np.linalg.norm(place - DETAIL_CENTRE) < DETAIL_RADIUS)


class Path:
    """A centre line with a heading, parametrised by arc length in metres.

    Args:
        curvature: radians a metre at each (N,) arc length; positive turns left.
        start: (x, y, heading) at arc length zero.
        span: first and last arc length.
    """

    def __init__(
        self,
        curvature: Callable[[np.ndarray], np.ndarray],
        start: tuple[float, float, float],
        span: tuple[float, float],
    ) -> None:
        self.first, self.last = span
        self._s = np.arange(self.first, self.last + STEP, STEP)
        heading = np.cumsum(curvature(self._s)) * STEP
        origin = np.searchsorted(self._s, 0.0)
        self._heading = heading - heading[origin] + start[2]
        middle = self._heading - curvature(self._s) * STEP / 2
        x, y = np.cumsum(np.cos(middle)) * STEP, np.cumsum(np.sin(middle)) * STEP
        self._x, self._y = x - x[origin] + start[0], y - y[origin] + start[1]

    def heading(self, s: np.ndarray | float) -> np.ndarray:
        """Direction of travel in radians at arc length `s`."""
        return np.interp(s, self._s, self._heading)

    def at(self, s: np.ndarray | float, offset: np.ndarray | float = 0.0) -> np.ndarray:
        """(..., 2) points at arc length `s`, `offset` metres to the left."""
        heading = self.heading(s)
        x = np.interp(s, self._s, self._x) - offset * np.sin(heading)
        y = np.interp(s, self._s, self._y) + offset * np.cos(heading)
        return np.stack([x, y], axis=-1)


class Crossing(NamedTuple):
    """A street that crosses the main street."""

    path: Path  # its centre line, arc length zero in the middle of the junction
    at: float  # arc length of the main street where it crosses


@dataclass(frozen=True)
class KerbLine:
    """A kerb with its block of pavement and buildings on the left of its direction.

    Args:
        offset: (N, 2) points of the line moved `d` metres into the block; N is always the same.
        legs: point ranges along which buildings can stand; two where the kerb turns a corner.
    """

    offset: Callable[[float], np.ndarray]
    legs: tuple[slice, ...]


@dataclass(frozen=True)
class Street:
    """The plan of a scene.

    Args:
        layout: one of LAYOUTS.
        path: centre line of the main street; the ego starts at arc length zero.
        crossing: the crossing street, if there is one.
        lane: width of a lane.
        lanes: lanes each way.
        parking: width of the parking strip on either side, or 0.
        kerbs: the kerb lines.
        verge: width of the strip of grass behind the kerb, or 0.
        sidewalk: width of the sidewalk behind it.
        setback: depth of the front gardens, or 0.
    """

    layout: str
    path: Path
    crossing: Crossing | None
    lane: float
    lanes: int
    parking: float
    kerbs: tuple[KerbLine, ...]
    verge: float
    sidewalk: float
    setback: float

    @property
    def half_width(self) -> float:
        """The distance in metres from the centre line to the kerb, on both streets alike."""
        return self.lane * self.lanes + self.parking

    @property
    def facade(self) -> float:
        """The distance in metres from the kerb to the facades."""
        return 0.2 + self.verge + self.sidewalk + self.setback

    @property
    def ego_offset(self) -> float:
        """The ego's lateral place in metres: the middle of the lane right of the centre line."""
        return -self.lane / 2


def make_street(layout: str, rng: np.random.Generator) -> Street:
    """A random plan of the given layout."""
    lanes = int(rng.choice([1, 1, 2]))
    lane = rng.uniform(3.2, 3.6)
    parking = 0.0 if lanes == 2 and rng.random() < 0.5 else 2.2
    half = lane * lanes + parking
    if layout == "curve":
        turn = rng.choice([-1, 1]) / rng.uniform(45, 75)
        begin, length = rng.uniform(-8, 6), rng.uniform(55, 75)
        path = Path(lambda s: turn * _bump(s, begin, length), (0, 0, 0), _SPAN)
    else:
        path = Path(np.zeros_like, (0, 0, 0), _SPAN)
    crossing = None
    kerbs = _street_kerbs(path, half)
    if layout == "junction":
        at = rng.uniform(17, 26)
        crossing = Crossing(Path(np.zeros_like, (at, 0, np.pi / 2), (-110.0, 110.0)), at)
        kerbs = tuple(_corner(at, half, x, y) for x in (1, -1) for y in (1, -1))
    return Street(
        layout=layout,
        path=path,
        crossing=crossing,
        lane=lane,
        lanes=lanes,
        parking=parking,
        kerbs=kerbs,
        verge=float(rng.choice([0.0, 1.3, 1.6])),
        sidewalk=rng.uniform(2.2, 3.4),
        setback=float(rng.choice([0.0, 0.0, 2.5])),
    )


_SPAN = (-REACH_BEHIND, REACH_AHEAD)


def _bump(s: np.ndarray, begin: float, length: float, ramp: float = 12.0) -> np.ndarray:
    return np.clip((s - begin) / ramp, 0, 1) * np.clip((begin + length - s) / ramp, 0, 1)


def _street_kerbs(path: Path, half: float) -> tuple[KerbLine, ...]:
    s = np.arange(path.first, path.last + 1e-6, 2.0)
    everything = (slice(0, len(s)),)
    return (
        KerbLine(lambda d: path.at(s, half + d), everything),
        KerbLine(lambda d: path.at(s[::-1], -half - d), everything),
    )


def _corner(crossing_at: float, half: float, x_side: int, y_side: int) -> KerbLine:
    """The kerb around one of a junction's four blocks."""
    radius, legs, arc = CORNER_RADIUS, 40, 8
    reach_x = (REACH_AHEAD - crossing_at if x_side > 0 else crossing_at + REACH_BEHIND) - half
    reach_y = 110.0 - half

    def offset(d: float) -> np.ndarray:
        rest = max(radius - d, 0.0)
        bend = max(radius, d)
        angle = np.linspace(np.pi, 1.5 * np.pi, arc)
        turn = bend + rest * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        down = np.stack([np.full(legs, d), np.linspace(reach_y, bend, legs)], axis=1)
        along = np.stack([np.linspace(bend, reach_x, legs), np.full(legs, d)], axis=1)
        block = np.concatenate([down, turn, along])
        if x_side * y_side < 0:
            block = block[::-1]
        return block * [x_side, y_side] + [crossing_at + x_side * half, y_side * half]

    count = 2 * legs + arc
    return KerbLine(offset, (slice(0, legs), slice(legs + arc, count)))
