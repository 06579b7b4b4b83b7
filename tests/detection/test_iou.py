import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.detection.iou import intersection_areas, iou_3d
from tests.detection.conftest import box

QUARTER = math.pi / 4

UNIT = box()  # 1 x 2 x 2
BY_HAND = {
    "itself": (UNIT, 1.0),
    "far away": (box(10, 10, heading=1.0), 0.0),
    "half of it in a larger one": (box(0.5, length=1, width=4, height=4), 2 / (4 + 16 - 2)),
    "a quarter turn": (box(0.5, length=1, width=4, height=4, heading=math.pi / 2), 2 / 18),
    "an eighth turn": (box(0.5, width=4, heading=QUARTER), 0.24074958176697656),
    "a half turn": (box(heading=math.pi), 1.0),
    "no size": (box(length=0, width=0, height=0), 0.0),
    "a line": (box(length=0, width=0, height=1), 0.0),
    "a negative side": (box(width=-1, height=1), 0.0),
    "1 cm wide": (box(width=1e-2), 0.0),
    "more than 1 cm wide": (box(width=1.01e-2), 1.01e-2 / 2),
    "1,000 km long": (box(length=1e6), 0.0),
    "within it": (box(0.1, 0.2, 0.3, length=0.5, width=1, height=1, heading=0.1), 0.125),
    "touching its side": (box(1.0), 0.0),
    "touching its corner": (box(1.0, 2.0), 0.0),
    "on top of it": (box(z=2.0), 0.0),
    "half as high on it": (box(z=1.0), 1 / 3),
}


@pytest.mark.parametrize(("other", "expected"), BY_HAND.values(), ids=BY_HAND)
def test_by_hand_and_as_waymos_own_tests_have_it(other, expected):
    assert iou_3d(UNIT, other) == pytest.approx(expected, abs=1e-9)
    assert iou_3d(other, UNIT) == pytest.approx(expected, abs=1e-9)


def test_what_is_no_box_overlaps_not_even_with_itself():
    for wrong in (box(width=1e-12), box(width=-1), box(length=1e6), box(0, 0, 0, 0, 0, 0)):
        assert iou_3d(wrong, wrong) == 0
    thin = box(width=1.01e-2)
    assert iou_3d(thin, thin) == pytest.approx(1)


def test_two_squares_an_eighth_turn_apart_share_an_octagon():
    # A square of side s cut by the same one, turned: 2 (sqrt 2 - 1) s^2.
    square = box(3, -5, 1, length=2, width=2, heading=0.3)
    turned = box(3, -5, 1, length=2, width=2, heading=0.3 + QUARTER)
    area = intersection_areas(square[None], turned[None])
    assert area == pytest.approx([8 * (math.sqrt(2) - 1)], abs=1e-12)


def test_a_cross_shares_its_middle():
    long, wide = box(length=8, width=1, heading=0.7), box(length=1, width=8, heading=0.7)
    assert intersection_areas(long[None], wide[None]) == pytest.approx([1], abs=1e-12)


def test_a_box_and_itself_shorter_as_in_waymos_test():
    one = box(70.97, 10.09, -0.38, 4.27, 2.02, 1.66, -3.12)
    other = box(70.97, 10.09, -0.38, 4.25, 2.02, 1.66, -3.12)
    assert iou_3d(one, other) == pytest.approx(4.25 / 4.27, abs=1e-9)


def test_an_exact_half_turn_changes_nothing():
    rng = np.random.default_rng(0)
    boxes = np.column_stack([rng.uniform(-80, 80, (500, 3)), rng.uniform(0.1, 9, (500, 3))])
    for heading in (rng.uniform(-np.pi, np.pi, 500), np.round(rng.uniform(-3, 3, 500)) * QUARTER):
        one = np.column_stack([boxes, heading])
        for turn in (math.pi, -math.pi, 0.0, 2 * math.pi, 1e-12, math.pi + 1e-12):
            turned = one + np.array([0, 0, 0, 0, 0, 0, turn])
            np.testing.assert_allclose(iou_3d(one, turned), 1, atol=1e-10)


def clipped_area(one, other) -> float:
    """The plain twin: Sutherland and Hodgman's polygon clipping, an edge and a point at a time."""

    def corners(one):
        x, y, _, length, width, _, heading = one
        cos, sin = math.cos(heading), math.sin(heading)
        half = [(length / 2, width / 2), (-length / 2, width / 2)]
        half += [(-a, -b) for a, b in half]
        return [(x + cos * a - sin * b, y + sin * a + cos * b) for a, b in half]

    polygon, clip = corners(one), corners(other)
    for (ax, ay), (bx, by) in zip(clip, clip[1:] + clip[:1], strict=True):

        def side(p, ax=ax, ay=ay, bx=bx, by=by):
            return (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax)

        kept = []
        for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
            if side(p) >= 0:
                kept.append(p)
            if (side(p) >= 0) != (side(q) >= 0):
                t = side(p) / (side(p) - side(q))
                kept.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
        polygon = kept
    pairs = zip(polygon, polygon[1:] + polygon[:1], strict=True)
    return sum(p[0] * q[1] - p[1] * q[0] for p, q in pairs) / 2


# Halves and eighth turns make sides coincide and corners touch; other numbers make neither.
PLACES = st.one_of(st.integers(-6, 6).map(lambda n: n / 2), st.floats(-3, 3))
SIDES = st.one_of(st.integers(1, 8).map(lambda n: n / 2), st.floats(0.02, 6))
HEADINGS = st.one_of(st.integers(-8, 8).map(lambda n: n * QUARTER), st.floats(-7, 7))
BOXES = st.builds(box, PLACES, PLACES, PLACES, SIDES, SIDES, SIDES, HEADINGS)


@given(one=BOXES, other=BOXES)
def test_areas_are_those_of_the_plain_twin(one, other):
    area = intersection_areas(one[None], other[None])[0]
    assert area == pytest.approx(max(clipped_area(one, other), 0), abs=1e-9)
    assert area <= min(one[3] * one[4], other[3] * other[4]) + 1e-9


@given(one=BOXES, other=BOXES, x=PLACES, y=PLACES, turn=HEADINGS)
def test_iou_is_symmetric_and_the_same_wherever_one_stands(one, other, x, y, turn):
    def moved(given):
        cos, sin = math.cos(turn), math.sin(turn)
        return box(
            x + cos * given[0] - sin * given[1],
            y + sin * given[0] + cos * given[1],
            *given[2:6],
            given[6] + turn,
        )

    iou = iou_3d(one, other)
    assert 0 <= iou <= 1
    assert iou_3d(other, one) == pytest.approx(iou, abs=1e-9)
    assert iou_3d(moved(one), moved(other)) == pytest.approx(iou, abs=1e-9)


@given(boxes=st.lists(BOXES, min_size=1, max_size=4), others=st.lists(BOXES, max_size=3))
def test_all_pairs_at_once_are_each_pair_alone(boxes, others):
    one, other = np.array(boxes), np.array(others).reshape(-1, 7)
    table = iou_3d(one[:, None], other)
    assert table.shape == (len(boxes), len(others))
    for row, column in np.ndindex(table.shape):
        assert table[row, column] == iou_3d(one[row], other[column])
