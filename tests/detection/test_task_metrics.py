import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.detection.labels import vehicle_pose
from geoevs.detection.task_metrics import (
    agent_ious,
    box_corners,
    image_boxes,
    image_from_vehicle,
    image_iou,
)
from geoevs.methods.tiny import FOCAL, HEIGHT, WIDTH, tiny_camera

FRONT = tiny_camera("front", 0.0, np.array([0.0, 0.0, 2.0]))
LEFT = tiny_camera("left", 45.0, np.array([0.0, 0.0, 2.0]))
POSE = vehicle_pose(FRONT)  # the world's own axes, as the camera is 2 m above its origin
MATRIX = image_from_vehicle(FRONT, POSE)


def box(x, y=0.0, z=2.0, length=2.0, width=2.0, height=1.0, heading=0.0):
    return np.array([[x, y, z, length, width, height, heading]])


def test_corners_by_hand():
    corners = box_corners(box(10.0, 1.0, heading=np.pi / 2))[0]
    # A quarter turn: the length of 2 m lies along y.
    np.testing.assert_allclose(corners[0], [10 - 1, 1 + 1, 1.5], atol=1e-12)
    np.testing.assert_allclose(corners[:, 2], [1.5] * 4 + [2.5] * 4)


def test_a_box_straight_ahead_by_hand():
    found = image_boxes(box(11.0), MATRIX, HEIGHT, WIDTH)[0]
    # Its near face stands 10 m away: 1 m to each side, 0.5 m up and down.
    across, down = FOCAL / 10, FOCAL * 0.5 / 10
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    np.testing.assert_allclose(found[:2], middle - np.array([across, down]))
    np.testing.assert_allclose(found[2:], middle + np.array([across, down]))


def test_boxes_are_cut_at_the_image_and_before_the_camera():
    around = image_boxes(box(0.0, length=20.0, width=20.0, height=20.0), MATRIX, HEIGHT, WIDTH)[0]
    np.testing.assert_allclose(around, [0, 0, WIDTH, HEIGHT])
    for nowhere in (box(-10.0), box(10.0, y=30.0)):
        left, top, right, bottom = image_boxes(nowhere, MATRIX, HEIGHT, WIDTH)[0]
        assert (right - left) * (bottom - top) == 0
    beside = image_boxes(box(0.0, y=2.0, length=12.0), MATRIX, HEIGHT, WIDTH)[0]
    assert beside[0] == 0 < beside[2] < WIDTH / 2
    assert np.isfinite(beside).all()


@given(st.lists(st.floats(0, 10), min_size=8, max_size=8))
def test_iou_of_rectangles_is_what_a_grid_counts(numbers):
    ends = np.round(np.array(numbers)).reshape(2, 2, 2)
    one, other = (np.concatenate([e.min(axis=0), e.max(axis=0)])[None] for e in ends)
    y, x = np.mgrid[:10, :10] + 0.5
    cells = [(x > b[0]) & (x < b[2]) & (y > b[1]) & (y < b[3]) for b in (one[0], other[0])]
    either = (cells[0] | cells[1]).sum()
    expected = (cells[0] & cells[1]).sum() / either if either else 0
    assert image_iou(one, other)[0, 0] == pytest.approx(expected)


def ious(predictions, vehicles, scores=None):
    scores = np.linspace(1, 0.5, len(predictions)) if scores is None else np.array(scores)
    return agent_ious(predictions, scores, vehicles, [FRONT, LEFT], POSE)


def test_perfect_boxes_have_iou_1_in_the_camera_that_shows_them():
    left = box(8.0, y=8.0, heading=0.3)
    vehicles = np.concatenate([box(12.0), left, box(-9.0)])
    np.testing.assert_allclose(ious(vehicles[:2], vehicles), [1, 1])


def test_no_prediction_scores_0_and_no_vehicle_counts_none():
    assert ious(np.zeros((0, 7)), box(12.0)).tolist() == [0]
    assert len(ious(box(12.0), np.zeros((0, 7)))) == 0
    assert len(ious(box(12.0), box(-9.0))) == 0


def test_only_as_many_predictions_as_vehicles_count():
    vehicle, wrong = box(12.0), box(12.0, y=6.0)
    both = np.concatenate([vehicle, wrong])
    assert ious(both, vehicle, [0.9, 0.5]).tolist() == [1]
    assert ious(both, vehicle, [0.5, 0.9]).tolist() == [0]
    assert ious(both, both, [0.5, 0.9]).tolist() == [1, 1]
