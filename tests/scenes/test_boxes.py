"""Boxes of tracks, by hand and as properties."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.scenes.boxes import Box, moving_boxes
from geoevs.scenes.scene import TRACK_COLUMNS

CAR = Box(3, "car-1", "car", 10.0, 5.0, 1.0, 4.0, 2.0, 1.5, 90.0, True)
metres = st.floats(-50, 50)


def test_a_turned_box_by_hand():
    # Its nose points to +y: 4 m long that way, 2 m wide along x.
    points = np.array([[10, 6.9, 1], [10.9, 5, 1], [11.9, 5, 1], [10, 5, 1.8], [10, 7, 1.75]])
    np.testing.assert_allclose(CAR.local(points)[:2], [[1.9, 0, 0], [0, -0.9, 0]], atol=1e-12)
    assert CAR.holds(points).tolist() == [True, True, False, False, True]


@given(st.tuples(metres, metres, metres), st.floats(-180, 180), metres)
def test_world_undoes_local(point, yaw, x):
    box = CAR._replace(yaw=yaw, x=x)
    np.testing.assert_allclose(box.world(box.local(np.array([point]))), [point], atol=1e-9)


@given(st.tuples(metres, metres, metres), st.floats(-180, 180))
def test_points_move_with_their_box(point, yaw):
    moved = CAR._replace(x=-20.0, y=3.0, yaw=yaw)
    there = moved.world(CAR.local(np.array([point])))
    np.testing.assert_allclose(moved.local(there), CAR.local(np.array([point])), atol=1e-9)
    assert (
        moved.holds(there).tolist() == CAR.holds(np.array([point])).tolist()
        or np.isclose(np.abs(CAR.local(np.array([point]))), [2, 1, 0.75], atol=1e-6).any()
    )


def test_rows_keep_their_order():
    rows = [CAR, CAR._replace(frame=4, moving=False)]
    table = pd.DataFrame(rows, columns=list(TRACK_COLUMNS))
    assert Box.rows(table) == rows


@pytest.mark.parametrize("kind", [bool, int, object])
def test_what_moves_in_given_frames_is_found_whatever_its_column_holds(kind):
    parked, other = CAR._replace(moving=False), CAR._replace(frame=5)
    table = pd.DataFrame([parked, CAR, other], columns=list(TRACK_COLUMNS)).astype({"moving": kind})
    assert moving_boxes(table, (3, 4)) == [CAR]
    assert moving_boxes(table[:0], (3, 4)) == []
