import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.detection.matching import Pairs, heading_accuracies, match, match_first, pair_up
from geoevs.detection.rules import LET, PLAIN
from tests.detection.conftest import box, predictions, truths


def pairs_of(weight) -> Pairs:
    """Pairs that weigh so much (IoU with affinity 1), and may match where it is above 0.3."""
    iou = np.array(weight, np.float32)
    return Pairs(iou, np.ones_like(iou), np.ones(iou.shape), iou > 0.3)


def matched(pairs: Pairs) -> set[tuple[int, int]]:
    return {(int(one), int(other)) for one, other in zip(*match(pairs), strict=True)}


def test_the_heaviest_assignment_is_not_the_greedy_one():
    # Greedy takes 0.9 and leaves 0.4: 1.3; crosswise 0.8 + 0.8.
    assert matched(pairs_of([[0.9, 0.8], [0.8, 0.4]])) == {(0, 1), (1, 0)}


def test_pairs_that_may_not_match_weigh_nothing_and_are_dropped():
    assert matched(pairs_of([[0.3, 0.2], [0.2, 0.5]])) == {(1, 1)}
    assert matched(pairs_of([[0.3]])) == set()
    assert matched(pairs_of(np.zeros((0, 3)))) == matched(pairs_of(np.zeros((2, 0)))) == set()


def test_affinity_weighs_and_is_what_decides_between_equals():
    pairs = pairs_of([[0.8], [0.8]])
    pairs.affinity[1] = 0.5
    assert matched(pairs) == {(0, 0)}
    assert pairs.weight.tolist() == [[800_000], [400_000]]


SHARES = st.sampled_from([0.0, 0.31, 0.4, 0.55, 0.7, 0.9])


@st.composite
def weights(draw):
    rows, columns = draw(st.integers(0, 5)), draw(st.integers(0, 4))
    return np.array(
        [[draw(SHARES) for _ in range(columns)] for _ in range(rows)], np.float32
    ).reshape(rows, columns)


def heaviest(weight: np.ndarray) -> float:
    """The plain twin: the best of all ways to give every truth another prediction, or none."""
    rows, columns = weight.shape
    choices = [*range(rows), *[None] * columns]
    ways = {way[:columns] for way in permutations(choices, columns)}
    return max(
        sum(weight[row, column] for column, row in enumerate(way) if row is not None)
        for way in ways
    )


@given(weight=weights())
def test_first_predictions_are_matched_as_if_there_were_no_others(weight):
    pairs = pairs_of(weight)
    numbers = np.arange(len(weight) + 1)
    found = match_first(pairs, numbers)
    for number, (prediction, truth) in zip(numbers, found, strict=True):
        assert (prediction < number).all()
        assert pairs.may_match[prediction, truth].all()
        assert len(set(truth)) == len(truth) == len(set(prediction))
        best = heaviest(np.where(pairs.may_match, pairs.weight, 0)[:number])
        assert pairs.weight[prediction, truth].sum() == best


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (0, 0, 1),
        (0, math.pi, 0),
        (math.pi, -math.pi, 1),
        (0, math.pi / 2, 0.5),
        (3, -3, 1 - (2 * math.pi - 6) / math.pi),
        (0.1, 0.1 + 4 * math.pi, 1),
        (-0.25 * math.pi, 0.5 * math.pi, 0.25),
    ],
)
def test_heading_accuracy_by_hand(one, other, expected):
    assert heading_accuracies(np.array(one), np.array(other)) == pytest.approx(expected, abs=1e-12)
    assert heading_accuracies(np.array(other), np.array(one)) == pytest.approx(expected, abs=1e-12)


def test_pairs_of_other_classes_have_nothing_in_common():
    here = box(10, 0, 1, 4, 2, 2)
    pairs = pair_up(
        predictions(here, here, classes=["vehicle", "sign"]),
        truths(here, here, classes=["vehicle", "cyclist"]),
        PLAIN,
    )
    np.testing.assert_allclose(pairs.iou, [[1, 0], [0, 0]], atol=1e-6)
    assert pairs.may_match.tolist() == [[True, False], [False, False]]


def test_thresholds_are_those_of_the_class_and_include_themselves():
    # 4 m long, shifted by d along its length: IoU = (4 - d) / (4 + d).
    for name, rules, least in (
        ("vehicle", PLAIN, 0.7),
        ("pedestrian", PLAIN, 0.5),
        ("sign", PLAIN, 0.5),
        ("cyclist", PLAIN, 0.5),
    ):
        shift = 4 * (1 - least) / (1 + least)
        for more, expected in ((-1e-6, True), (1e-5, False)):
            seen = predictions(box(10, shift + more, 1, 4, 4, 2), classes=[name])
            there = truths(box(10, 0, 1, 4, 4, 2), classes=[name])
            assert pair_up(seen, there, rules).may_match.tolist() == [[expected]]
    # Half as high: an IoU of exactly 0.5 matches a pedestrian.
    seen, there = box(10, 0, 1, 1, 1, 1), box(10, 0, 1, 1, 1, 2)
    for name, expected in (("pedestrian", True), ("vehicle", False)):
        pairs = pair_up(predictions(seen, classes=[name]), truths(there, classes=[name]), PLAIN)
        assert pairs.may_match.tolist() == [[expected]]


def test_let_forgives_distance_and_plain_rules_do_not():
    x, y, z = LET.tolerance.sensor
    truth = box(x + 30, y, z, length=4)
    seen = box(x + 32, y, z, length=4)
    one, other = predictions(seen), truths(truth)
    pairs = pair_up(one, other, LET)
    assert pairs.iou[0, 0] == pytest.approx(1)
    assert pairs.affinity[0, 0] == pytest.approx(1 - 2 / 3)
    assert pairs.may_match[0, 0]
    plain = pair_up(one, other, PLAIN)
    assert plain.iou[0, 0] == pytest.approx(2 / 6)
    assert plain.affinity[0, 0] == 1
    assert not plain.may_match[0, 0]
    beyond = predictions(box(x + 33.1, y, z, length=4))
    assert not pair_up(beyond, other, LET).may_match[0, 0]
