import numpy as np
import pytest

from geoevs.detection.iou import iou_3d
from geoevs.detection.let import affinities, aligned
from geoevs.detection.rules import LET, Tolerance
from tests.detection.conftest import box

LOOSE = Tolerance(0.15, 2.0, (0, 0, 0))
"""What Waymo's unit tests of affinities use."""


@pytest.mark.parametrize(
    ("prediction", "expected"),
    [
        ((1, 0, 0), 1),
        ((1.5, 0, 0), 1 - 0.5 / 2),
        ((1.5, 1, 0), 1 - 0.5 / 2),  # beside the line of sight: no error along it
        ((4, 0, 0), 0),
        ((-1, 0, 0), 0),
        ((0, 0, 0), 1 - 1 / 2),
    ],
)
def test_affinity_near_by(prediction, expected):
    found = affinities(box(*prediction)[None], box(1)[None], LOOSE)
    assert found == pytest.approx(np.array([[expected]]), abs=1e-12)


@pytest.mark.parametrize(
    ("prediction", "expected"),
    [
        ((30, 40, 0), 1),
        ((33, 44, 0), 1 - 5 / 7.5),  # a tenth farther; 15 % of 50 m are tolerated
        ((33.4, 43.7, 0), 1 - 5 / 7.5),
        ((34.2, 43.1, 0), 1 - 5 / 7.5),
        ((36, 48, 0), 0),
    ],
)
def test_affinity_far_away(prediction, expected):
    found = affinities(box(*prediction)[None], box(30, 40)[None], LOOSE)
    assert found == pytest.approx(np.array([[expected]]), abs=1e-12)


def test_affinity_falls_linearly_along_the_ray():
    sensor = np.array(LET.tolerance.sensor)
    truth = sensor + np.array([30, 20, -1])
    distance = np.linalg.norm(truth - sensor)
    shifts = np.linspace(-0.2, 0.2, 41)  # 10 % are tolerated
    shifted = [box(*sensor + (truth - sensor) * (1 + shift)) for shift in shifts]
    found = affinities(np.array(shifted), box(*truth)[None], LET.tolerance)[:, 0]
    assert distance > 5  # where the share decides
    np.testing.assert_allclose(found, np.clip(1 - np.abs(shifts) / 0.1, 0, 1), atol=1e-12)


def test_half_a_metre_is_tolerated_near_by():
    tolerance = Tolerance(0.1, 0.5, (1.0, 2.0, 3.0))
    truth, wrong = box(3, 2, 3), box(3.2, 2, 3)
    found = affinities(wrong[None], truth[None], tolerance)
    assert found == pytest.approx(np.array([[1 - 0.2 / 0.5]]))


def test_alignment_is_to_the_nearest_point_of_the_line_of_sight():
    # P = (1.5, 1), G = (1, 0): P.G / |P|^2 = 1.5 / 3.25, as in Waymo's unit test.
    wrong = box(1.5, 1)
    moved = aligned(wrong[None], box(1)[None], LOOSE)[0, 0]
    np.testing.assert_allclose(moved, box(9 / 13, 6 / 13))
    right = iou_3d(box(9 / 13, 6 / 13), box(1))
    sensor = Tolerance(0.15, 2.0, (1.0, 0.0, 0.5))
    shifted = aligned(box(2.5, 1, 0.5)[None], box(2, 0, 0.5)[None], sensor)[0, 0]
    np.testing.assert_allclose(shifted, box(9 / 13 + 1, 6 / 13, 0.5))
    assert iou_3d(shifted, box(2, 0, 0.5)) == pytest.approx(right)


def test_what_is_wrong_along_the_ray_alone_is_aligned_onto_the_truth():
    sensor = np.array([1.0, 2.0, 3.0])
    tolerance = Tolerance(0.1, 0.5, tuple(sensor))
    way = np.array([4.0, -2.0, -1.5])
    seen, truth = box(*sensor + 1.3 * way, heading=0.4), box(*sensor + way, heading=0.4)
    moved = aligned(seen[None], truth[None], tolerance)[0, 0]
    np.testing.assert_allclose(moved, truth)  # z too: the line of sight falls
    behind = box(*sensor - way)
    np.testing.assert_allclose(aligned(behind[None], truth[None], tolerance)[0, 0, :3], truth[:3])


def test_all_pairs_at_once_are_each_pair_alone():
    rng = np.random.default_rng(1)
    seen, truths = rng.uniform(1, 30, (5, 7)), rng.uniform(1, 30, (3, 7))
    near, moved = affinities(seen, truths, LOOSE), aligned(seen, truths, LOOSE)
    assert moved.shape == (5, 3, 7)
    for row, column in np.ndindex(5, 3):
        one, other = seen[row : row + 1], truths[column : column + 1]
        assert near[row, column] == pytest.approx(affinities(one, other, LOOSE)[0, 0])
        np.testing.assert_allclose(moved[row, column], aligned(one, other, LOOSE)[0, 0])


def test_a_prediction_at_the_sensor_is_aligned_nowhere_and_harms_nobody():
    here, truth = box(*LET.tolerance.sensor), box(10)
    assert np.isfinite(aligned(here[None], truth[None], LET.tolerance)).all()
    assert affinities(here[None], truth[None], LET.tolerance)[0, 0] == 0
