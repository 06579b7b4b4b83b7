"""The road map: what lies where, by hand, by the slow way and by the fast one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.scenes.road_map import SURFACES, Polygon, RoadMap
from geoevs.scenes.sources.waymo.road_map import band

DRIVABLE, MARKING, CROSSING, SIDEWALK = range(len(SURFACES))


def square(low, high, z=0.0):
    """The ring of a square between two places on the diagonal."""
    return np.array([[low, low, z], [high, low, z], [high, high, z], [low, high, z]], float)


def flat(ring):
    return np.column_stack([ring, np.zeros(len(ring))])


def test_a_raster_looks_ahead_and_has_the_left_on_its_left():
    car_park = RoadMap([Polygon("drivable", [square(0, 4)]), Polygon("marking", [square(0, 1)])])
    # From (2, 2) along x: the marking lies behind, on the right.
    seen = car_park.raster(np.array([2.0, 2.0]), 0.0, 8.0, 8)
    assert seen.shape == (8, 8, 4)
    inner = seen[2:6, 2:6]
    assert inner[..., DRIVABLE].all()
    assert inner[3, 3, MARKING]
    assert not inner[0, :, MARKING].any()
    assert not seen[..., SIDEWALK].any()
    # Turned to the left, the same corner lies behind on the left.
    assert car_park.raster(np.array([2.0, 2.0]), 90.0, 8.0, 8)[5, 2, MARKING]


def test_a_line_thinner_than_a_cell_has_no_gap():
    line = RoadMap([Polygon("marking", [flat([[-9, 0.31], [9, 0.31], [9, 0.35], [-9, 0.35]])])])
    seen = line.raster(np.zeros(2), 10.0, 10.0, 20)
    assert seen[..., MARKING].any(axis=1).all()


def test_a_sidewalk_hides_what_it_lies_on_and_holes_are_none():
    rings = [square(0, 10), square(2, 4), square(6, 8)]
    road_map = RoadMap([Polygon("drivable", rings), Polygon("sidewalk", [square(9, 11)])])
    places = np.array([[1, 1], [3, 3], [7, 7], [5, 5], [9.5, 9.5], [10.5, 10.5], [30, 30]])
    on_road = [True, False, False, True, False, False, False]
    on_sidewalk = [False] * 4 + [True, True, False]
    found = road_map.at(places)
    np.testing.assert_array_equal(found[:, DRIVABLE], on_road)
    np.testing.assert_array_equal(found[:, SIDEWALK], on_sidewalk)
    seen = road_map.raster(np.array([6.0, 6.0]), 0.0, 12.0, 120)
    rows, columns = ((12 - places[:6]) * 10).astype(int).T  # x counts rows, y columns, from afar
    np.testing.assert_array_equal(seen[rows, columns], found[:6])


corners = st.tuples(st.floats(-20, 20), st.floats(-20, 20))
rings = st.lists(st.lists(corners, min_size=3, max_size=8).map(flat), min_size=1, max_size=2)
polygons = st.builds(Polygon, st.sampled_from(SURFACES[:3]), rings)


@given(st.lists(polygons, min_size=1, max_size=4), st.floats(-180, 180), corners)
def test_the_raster_is_what_lies_at_its_cells_but_for_the_edges(drawn, yaw, centre):
    """Cells that are some cells from every edge are inside or outside for both."""
    road_map, cells, metres = RoadMap(drawn), 24, 30.0
    size = metres / cells
    cos, sin = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    steps = metres / 2 - (np.arange(cells) + 0.5) * size
    ahead, left = np.meshgrid(steps, steps, indexing="ij")
    places = np.array(centre) + np.stack(
        [ahead * cos - left * sin, ahead * sin + left * cos], axis=-1
    ).reshape(-1, 2)
    seen = road_map.raster(np.array(centre), yaw, metres, cells).reshape(-1, 4)
    found = road_map.at(places)
    rings = [ring[:, :2] for polygon in drawn for ring in polygon.rings]
    far = np.min([_distance(places, ring) for ring in rings], axis=0) > 2.5 * size
    np.testing.assert_array_equal(seen[far], found[far])


def _distance(points, ring):
    """(N,) metres to the nearest edge."""
    nearest = np.full(len(points), np.inf)
    for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        edge = end - start
        share = np.clip((points - start) @ edge / max(edge @ edge, 1e-12), 0, 1)
        away = points - start - share[:, None] * edge
        nearest = np.minimum(nearest, np.linalg.norm(away, axis=1))
    return nearest


def test_the_ground_is_the_plane_of_the_road():
    ring = square(-30, 30)
    ring[:, 2] = 0.1 * ring[:, 0] - 0.05 * ring[:, 1] + 2
    road_map = RoadMap([Polygon("drivable", [ring]), Polygon("sidewalk", [square(-9, 9, z=7.0)])])
    np.testing.assert_allclose(road_map.ground(np.array([5.0, 3.0])), [0.1, -0.05, 2], atol=1e-9)


def test_the_ground_of_corners_in_a_line_does_not_tip_over():
    line = np.array([[0.0, 0, 1], [10, 0, 1], [20, 0, 1]])
    only = RoadMap([Polygon("sidewalk", [line])])
    np.testing.assert_allclose(only.ground(np.array([0.0, 4.0])), [0, 0, 1], atol=1e-9)


def test_a_hill_counts_the_less_the_farther_it_is():
    here, there = square(-5, 5), square(300, 310, z=30.0)
    plane = RoadMap([Polygon("drivable", [here]), Polygon("drivable", [there])]).ground(np.zeros(2))
    assert abs(plane[2]) < 0.5


@pytest.mark.parametrize("line", [[[0, 0, 0]], [[1, 2, 3], [1, 2, 5]]])
def test_a_line_of_one_place_has_no_band(line):
    assert len(band(np.array(line, float), 2.0)) == 0
