import math
from dataclasses import replace

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.detection.counts import FIELDS, count_frame, shards_of
from geoevs.detection.frames import Predictions
from geoevs.detection.rules import LET, PLAIN
from tests.detection.conftest import box, predictions, truths


def counted(seen, there, rules, level=2, cutoff=0, **shard):
    """FIELDS of one shard, level and cutoff, by name; all vehicles by default."""
    wanted = {"breakdown": "type", "label": "vehicle", "bin": "all"} | shard
    place = [each._asdict() for each in shards_of(rules)].index(wanted)
    counts = count_frame(seen, there, rules)[place, rules.levels.index(level), cutoff]
    return dict(zip(FIELDS, counts.tolist(), strict=True))


def car(x, y=0.0, heading=0.0):
    return box(x, y, 1, 4, 2, 2, heading)


HERE, THERE, ELSEWHERE = car(10), car(20), car(40)


def numbers(found):
    return [found[f"{sort}_{kind}"] for sort, kind in KINDS]


KINDS = (("true", "positives"), ("false", "positives"), ("false", "negatives"))


def test_hits_mistakes_and_misses_at_every_cutoff():
    seen = predictions(HERE, THERE, car(60), scores=[0.9, 0.5, 0.7])
    there = truths(HERE, THERE, ELSEWHERE)
    for cutoff, expected in ((0, [2, 1, 1]), (50, [2, 1, 1]), (51, [1, 1, 2]), (71, [1, 0, 2])):
        found = counted(seen, there, PLAIN, cutoff=cutoff)
        assert numbers(found) == expected
        assert found["truths"] == 3
        assert found["predictions"] == sum(expected[:2])
    assert numbers(counted(seen, there, PLAIN, cutoff=91)) == [0, 0, 3]


def test_cutoffs_are_compared_as_float32():
    # 0.29 in float32 is more than 0.29; as doubles, 29 * 0.01 is more than a score of 0.29.
    score = float(np.float32(0.29))
    for given in (0.29, score):
        found = [
            counted(predictions(HERE, scores=[given]), truths(HERE), PLAIN, cutoff=cutoff)
            for cutoff in (28, 29, 30)
        ]
        assert [row["true_positives"] for row in found] == [1, 1, 0]
    sure = counted(predictions(HERE, scores=[1.0]), truths(HERE), PLAIN, cutoff=100)
    assert sure["true_positives"] == 1


def test_a_prediction_in_a_zone_without_labels_is_no_mistake_but_may_hit():
    seen = predictions(HERE, ELSEWHERE, ignored=[True, True])
    found = counted(seen, truths(HERE, THERE), PLAIN)
    assert numbers(found) == [1, 0, 1]
    assert found["predictions"] == 2


def test_hits_of_harder_truths_count_in_level_1_and_only_misses_are_of_it():
    seen = predictions(HERE)
    there = truths(HERE, THERE, ELSEWHERE, levels=[2, 2, 1])
    assert numbers(counted(seen, there, PLAIN, level=1)) == [1, 0, 1]
    assert numbers(counted(seen, there, PLAIN, level=2)) == [1, 0, 2]
    assert counted(seen, there, PLAIN, level=1)["truths"] == 1
    assert counted(seen, there, PLAIN, level=2)["truths"] == 3


def test_ranges_are_by_the_distance_of_each_box():
    # A prediction at 29.9 m is alone in the near range: its truth at 30 m is in the middle one.
    seen, there = predictions(car(29.9)), truths(box(30, 0, 0, 4, 2, 2))
    near = {"breakdown": "range", "bin": "[0, 30)"}
    middle = {"breakdown": "range", "bin": "[30, 50)"}
    assert numbers(counted(seen, there, PLAIN, **near)) == [0, 1, 0]
    assert numbers(counted(seen, there, PLAIN, **middle)) == [0, 0, 1]
    far = {"breakdown": "range", "bin": "[50, inf)"}
    # 3-D: 40 m ahead and 30 m up are 50 m.
    assert numbers(counted(predictions(), truths(box(40, 0, 30)), PLAIN, **far)) == [0, 0, 1]


def test_cameras_count_the_truths_that_they_see_best():
    # From 19.8 to 25.2 degrees, both FRONT and FRONT_LEFT have a car in their field of view.
    place, beside = (
        60 * np.array([math.cos(angle), math.sin(angle)]) for angle in np.radians([20.5, 24.5])
    )
    there = truths(car(*place), cameras=["FRONT_LEFT"])
    left, front, right = (
        {"breakdown": "camera", "bin": name} for name in ("FRONT_LEFT", "FRONT", "FRONT_RIGHT")
    )
    hit = predictions(car(*place))
    assert numbers(counted(hit, there, LET, **left)) == [1, 0, 0]
    assert numbers(counted(hit, there, LET, **front)) == [0, 0, 0]
    assert numbers(counted(hit, there, LET, **right)) == [0, 0, 0]
    # Turned across it overlaps too little to match; it is a mistake of the truth's camera alone.
    across = predictions(car(*place, heading=math.pi / 2))
    assert numbers(counted(across, there, LET, **left)) == [0, 1, 1]
    assert numbers(counted(across, there, LET, **front)) == [0, 0, 0]
    # What overlaps with nothing is a mistake of both.
    wrong = predictions(car(*beside))
    assert numbers(counted(wrong, there, LET, **left)) == [0, 1, 1]
    assert numbers(counted(wrong, there, LET, **front)) == [0, 1, 0]
    assert numbers(counted(wrong, there, LET, **right)) == [0, 0, 0]


def test_a_camera_sees_25_degrees_to_each_side():
    for degrees, names in ((25.1, {"FRONT", "FRONT_LEFT"}), (25.3, {"FRONT_LEFT"})):
        at = 20 * np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
        seen = predictions(car(*at))
        found = {
            name
            for name in ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")
            if counted(seen, truths(), LET, breakdown="camera", bin=name)["predictions"]
        }
        assert found == names


def test_a_truth_of_an_unknown_camera_is_in_no_camera_but_in_all_else():
    there = truths(HERE, cameras=["rear"])
    assert numbers(counted(predictions(HERE), there, LET)) == [1, 0, 0]
    front = counted(predictions(HERE), there, LET, breakdown="camera", bin="FRONT")
    assert numbers(front) == [0, 0, 0]
    assert front["truths"] == 0


def test_headings_and_affinities_are_summed_over_hits():
    x, y, z = LET.tolerance.sensor
    there = truths(box(x + 20, y, z, 2, 2, 2), box(x + 40, y, z, 2, 2, 2))
    seen = predictions(box(x + 21, y, z, 2, 2, 2, math.pi), box(x + 40, y, z, 2, 2, 2))
    found = counted(seen, there, LET)
    assert found["true_positives"] == 2
    assert found["flipped"] == 1
    assert found["heading_accuracy"] == pytest.approx(1)
    assert found["affinity"] == pytest.approx(0.5 + 1)


def test_headings_beyond_a_quarter_turn_are_flipped():
    there = truths(box(10, 0, 1, 2, 2, 2))
    for degrees, flipped in ((89, 0), (91, 1), (-91, 1), (180, 1), (271, 0)):
        seen = predictions(box(10, 0, 1, 2, 2, 2, math.radians(degrees)))
        assert counted(seen, there, LET)["true_positives"] == 1
        assert counted(seen, there, LET)["flipped"] == flipped


def test_the_order_of_boxes_does_not_matter(street):
    boxes, names = street
    rng = np.random.default_rng(0)
    # Twins: equal boxes with equal scores but other headings, so that ties must be broken alike.
    seen = np.concatenate([boxes + rng.normal(0, 0.2, boxes.shape), boxes, boxes])
    seen[-len(boxes) :, 6] += math.pi
    scores = np.concatenate([rng.uniform(0, 1, len(boxes)), np.full(2 * len(boxes), 0.5)])
    there = truths(*boxes, classes=names, cameras=["FRONT"] * 4 + ["SIDE_LEFT"] * 3)
    found = predictions(*seen, scores=scores, classes=names * 3)
    expected = count_frame(found, there, LET)
    assert expected[..., FIELDS.index("true_positives")].any()
    for _ in range(5):
        shuffled = found.take(rng.permutation(len(found)))
        others = there.take(rng.permutation(len(there)))
        np.testing.assert_array_equal(count_frame(shuffled, others, LET), expected)


def test_sensor_and_boxes_that_move_together_change_nothing(street):
    boxes, names = street
    rng = np.random.default_rng(0)
    seen = boxes + rng.normal(0, 0.2, boxes.shape)
    shift = np.array([3.0, -2.0, 0.7])
    sensor = tuple(np.array(LET.tolerance.sensor) + shift)
    moved = replace(LET, tolerance=replace(LET.tolerance, sensor=sensor))
    by = np.array([*shift, 0, 0, 0, 0])
    types = slice(0, 4)  # ranges and cameras are seen from the vehicle's origin
    here = count_frame(predictions(*seen, classes=names), truths(*boxes, classes=names), LET)
    there = count_frame(
        predictions(*seen + by, classes=names), truths(*boxes + by, classes=names), moved
    )
    assert here[types].any()
    np.testing.assert_allclose(there[types], here[types], atol=1e-5)


def test_a_frame_without_boxes_counts_nothing():
    assert not count_frame(predictions(), truths(), LET).any()


def test_arrays_of_other_lengths_are_refused():
    with pytest.raises(GeoEvsError, match=r"shapes \(2, 7\), \(2,\), \(1,\), \(2,\); give"):
        Predictions(np.zeros((2, 7)), np.zeros(2, int), np.zeros(1), np.zeros(2, bool))
    with pytest.raises(GeoEvsError, match=r"\(2, 6\)"):
        Predictions(np.zeros((2, 6)), np.zeros(2, int), np.zeros(2), np.zeros(2, bool))
