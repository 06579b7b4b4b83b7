"""The map of a street: it is what its ground looks like, and drawing it changes no picture."""

import hashlib

import numpy as np
import pytest

from geoevs.scenes.road_map import SURFACES
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.street.ground import WHITE, YELLOW, add_ground
from geoevs.scenes.sources.street.layout import LAYOUTS, make_street
from geoevs.scenes.sources.street.light import MOOD_NAMES, MOODS
from geoevs.scenes.sources.street.mesh import MeshBuilder
from geoevs.scenes.sources.street.source import Source

BEFORE = {
    "straight": "d0ec8b1b1e26e77e",
    "curve": "e8df6acbacf09900",
    "junction": "724a7b02776b977b",
}
"""Hashes of the grounds' triangles, in millimetres, of the version that drew no map."""

ON_ROAD = ("asphalt", "worn", "patch", "matte")


def drawn(layout):
    builder = MeshBuilder()
    street = make_street(layout, np.random.default_rng(5))
    road_map = add_ground(builder, street, np.random.default_rng(6))
    return builder.surfaces(), road_map, street


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_map_costs_no_random_number_and_moves_no_triangle(layout):
    surfaces, *_ = drawn(layout)
    digest = hashlib.sha256()
    for finish, surface in sorted(surfaces.items()):
        digest.update(finish.encode())
        for field in surface:
            digest.update(np.rint(field * 1e3).astype(np.int64).tobytes())
    assert digest.hexdigest()[:16] == BEFORE[layout]


def topmost(surfaces, places):
    """The finish, colour and height of what is seen from above at (N, 2) places."""
    seen = [("", None, -np.inf)] * len(places)
    for finish, surface in surfaces.items():
        for corners, colour in zip(surface.corners, surface.colours, strict=True):
            low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
            for number in np.flatnonzero(((places >= low) & (places <= high)).all(axis=1)):
                edges = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]])[:2]
                if abs(np.linalg.det(edges)) < 1e-9:  # an upright kerb stone
                    continue
                share = np.linalg.solve(edges, places[number] - corners[0, :2])
                height = corners[0, 2] + share @ (corners[1:, 2] - corners[0, 2])
                if min(*share, 1 - share.sum()) >= 0 and height > seen[number][2]:
                    seen[number] = finish, colour, height
    return seen


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_map_says_what_lies_on_top(layout):
    surfaces, road_map, street = drawn(layout)
    centre = street.path.at(20.0)
    places = centre + np.random.default_rng(0).uniform(-25, 25, (500, 2))
    found = road_map.at(places)
    expected = np.zeros_like(found)
    for number, (finish, colour, height) in enumerate(topmost(surfaces, places)):
        painted = finish == "matte" and any(np.allclose(colour, c) for c in (WHITE, YELLOW))
        road = finish in ON_ROAD and height < 0.05
        expected[number] = [road, painted, False, finish == "paving"]
    crossing = SURFACES.index("crossing")
    expected[:, crossing] = found[:, crossing]  # of which only the stripes are seen
    # Kerb stones rise from the road's height within 2 cm.
    assert (found != expected).any(axis=1).sum() <= 1
    assert expected.any(axis=0).all()


def test_a_zebra_is_a_crossing_with_stripes_on_the_road():
    _, road_map, street = drawn("junction")
    zebras = [polygon for polygon in road_map.polygons if polygon.surface == "crossing"]
    assert len(zebras) == 4
    corners = zebras[0].corners[:, :2]
    sides = np.sort(np.linalg.norm(np.diff(corners, axis=0), axis=1))
    np.testing.assert_allclose(sides, [3.2, 3.2, 2 * street.half_width], atol=1e-9)
    shares = np.random.default_rng(1).uniform(0.05, 0.95, (400, 2))
    inside = corners[0] + shares @ np.array([corners[1] - corners[0], corners[3] - corners[0]])
    drivable, marking, crossing, _ = road_map.at(inside).T
    assert drivable.all()
    assert crossing.all()
    assert 0.4 < marking.mean() < 0.6  # half a metre in a metre


def test_a_scene_has_its_map_and_the_words_of_a_prompt():
    record = Source(8, 8).open(SceneRef("junction-3"))
    assert record.extras.road_map.polygons
    layout, light = record.info.tags
    assert layout == "junction"
    assert light in MOOD_NAMES
    assert len(MOODS) == len(MOOD_NAMES)
    # The ego drives along the road.
    assert record.extras.road_map.at(np.array([[2.0, -1.7]]))[0, 0]
