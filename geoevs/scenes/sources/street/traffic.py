"""Who is on the street: parked and moving cars and pedestrians, as functions of time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from geoevs.scenes.scene import TRACK_COLUMNS
from geoevs.scenes.sources.street.layout import KERB_HEIGHT, Path, Street
from geoevs.scenes.sources.street.mesh import MeshBuilder
from geoevs.scenes.sources.street.people import SIZE, Person
from geoevs.scenes.sources.street.vehicles import make_car


class Place(NamedTuple):
    """A position in metres and a heading in radians, in the world."""

    x: float
    y: float
    z: float
    yaw: float


@dataclass(frozen=True)
class Actor:
    """One car or pedestrian on a path; `speed` is along the path, negative against it.

    Args:
        size: length, width and height of its box.
        looks: the mesh at the origin, of a car; or the person.
    """

    track: str
    label: str
    path: Path
    start: float
    offset: float
    speed: float
    height: float  # of the ground under it
    size: tuple[float, float, float]
    looks: MeshBuilder | Person
    yaw_change: float = 0.0

    @property
    def moving(self) -> bool:
        """Whether it moves during the scene."""
        return self.speed != 0

    def at(self, time: float) -> Place:
        """Its place at `time` seconds."""
        s = self.start + self.speed * time
        x, y = self.path.at(s, self.offset)
        backwards = np.pi if self.speed < 0 else 0.0
        heading = float(self.path.heading(s))
        return Place(x, y, self.height, heading + backwards + self.yaw_change)

    def add_to(self, builder: MeshBuilder, time: float) -> None:
        """Add its mesh at `time` seconds."""
        if isinstance(self.looks, Person):
            mesh = self.looks.mesh(self.start + abs(self.speed) * time)
            builder.place(mesh, *self.at(time), self.looks.scale)
        else:
            builder.place(self.looks, *self.at(time))


def make_actors(
    street: Street,
    ego_speed: float,
    rng: np.random.Generator,
    traffic_speed: float | None = None,
) -> list[Actor]:
    """Everybody of a scene, tracks numbered in order; nobody meets the ego.

    `traffic_speed`, in m/s, replaces the speeds of all cars that drive; nothing else changes. Then
    cars may meet, though not within the first second or so.
    """
    actors: list[Actor] = []

    def car(path: Path, start: float, offset: float, speed: float, yaw: float = 0.0) -> None:
        if speed and traffic_speed is not None:
            if traffic_speed == 0 and speed < 0:
                yaw = np.pi  # who stands still faces the way it would have gone
            speed = traffic_speed if speed > 0 else -traffic_speed
        looks, body = make_car(rng)
        size = (body.length + 0.06, body.width + 0.32, body.height + 0.02)
        track = f"car-{len(actors):03d}"
        actors.append(Actor(track, "car", path, start, offset, speed, 0.0, size, looks, yaw))

    def person(path: Path, start: float, offset: float, speed: float, height: float) -> None:
        looks = Person(rng)
        length, width, tall = (looks.scale * edge for edge in SIZE)
        size = (length, width, tall)
        track = f"pedestrian-{len(actors):03d}"
        actors.append(Actor(track, "pedestrian", path, start, offset, speed, height, size, looks))

    _park(street, rng, car)
    _drive(street, ego_speed, rng, car)
    _walk(street, rng, person)
    return actors


def _free_stretches(street: Street) -> list[tuple[Path, float, float]]:
    """Parts of the paths along which cars may park."""
    main = street.path
    if street.crossing is None:
        return [(main, main.first + 5, main.last - 5)]
    clear = street.half_width + 13.0
    cross, at = street.crossing
    return [
        (main, main.first + 5, at - clear),
        (main, at + clear, main.last - 5),
        (cross, -70.0, -clear),
        (cross, clear, 70.0),
    ]


def _park(street: Street, rng: np.random.Generator, car: Callable[..., None]) -> None:
    if not street.parking:
        return
    aside = street.half_width - street.parking / 2 - 0.05
    for path, first, last in _free_stretches(street):
        for side in (-1, 1):
            for s in np.arange(first + 3, min(last, 90.0), 5.8):
                if rng.random() < 0.62:
                    # Traffic keeps right, so cars on the left-hand side face backwards.
                    yaw = (np.pi if side > 0 else 0.0) + rng.normal(0, 0.015)
                    place = side * (aside + rng.uniform(-0.08, 0.05))
                    car(path, s + rng.uniform(-0.25, 0.25), place, 0.0, yaw)


def _drive(
    street: Street, ego_speed: float, rng: np.random.Generator, car: Callable[..., None]
) -> None:
    lane, oncoming = street.lane, -rng.uniform(6, 11)
    for start in (-rng.uniform(14, 25), *(np.cumsum(rng.uniform(14, 30, 3)) + 2)):
        car(street.path, start, (street.lanes - 0.5) * lane, oncoming)
    car(street.path, rng.uniform(19, 32), street.ego_offset, ego_speed + rng.uniform(-0.4, 1.0))
    if street.lanes == 2:
        car(street.path, rng.uniform(7, 14), -1.5 * lane, ego_speed + rng.uniform(-1.0, 1.5))
    if street.crossing is not None:
        cross = street.crossing.path
        car(cross, -street.half_width - rng.uniform(10, 13), -lane / 2, rng.uniform(0.8, 2))
        car(cross, street.half_width + rng.uniform(10, 16), lane / 2, -rng.uniform(1, 3))


def _walk(street: Street, rng: np.random.Generator, person: Callable[..., None]) -> None:
    middle = street.half_width + 0.2 + street.verge + street.sidewalk / 2
    spans = [(street.path, -12.0, 55.0, 12)]
    if street.crossing is not None:
        clear = street.half_width + 6
        cross, at = street.crossing
        spans = [(street.path, -15.0, at - clear, 6), (street.path, at + clear, 70.0, 5),
                 (cross, clear, 35.0, 4), (cross, -35.0, -clear, 4)]  # fmt: skip
    for path, first, last, count in spans:
        for s in np.sort(rng.uniform(first, last, count)):
            side, way = rng.choice([-1, 1], 2)
            aside = side * (middle + rng.uniform(-0.3, 0.3) * street.sidewalk)
            person(path, s, aside, way * rng.uniform(0.9, 1.6), KERB_HEIGHT)


def make_tracks(actors: list[Actor], frames: list[int], interval: float) -> pd.DataFrame:
    """Boxes with TRACK_COLUMNS of all actors in `frames`, `interval` seconds apart."""
    rows = []
    for frame in frames:
        for actor in actors:
            x, y, z, yaw = actor.at(frame * interval)
            length, width, height = actor.size
            degrees = float(np.degrees(yaw) + 180) % 360 - 180
            rows.append((frame, actor.track, actor.label, x, y, z + height / 2, length, width,
                         height, degrees, actor.moving))  # fmt: skip
    return pd.DataFrame(rows, columns=list(TRACK_COLUMNS))
