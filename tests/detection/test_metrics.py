import math
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError
from geoevs.core.parquet import write_parquet
from geoevs.detection.counts import count_frame
from geoevs.detection.metrics import MEAN, average_precision, average_precisions, metrics_table
from geoevs.detection.rules import LET, PLAIN
from geoevs.detection.scoring import detection_counts, read_counts, scene_sums
from tests.detection.conftest import predictions, truths


@pytest.mark.parametrize(
    ("precision", "recall", "expected"),
    [
        ([], [], 0),
        ([0.1], [0.2], 0.2 * 0.1),
        ([0.1, 0.05], [0.2, 1.0], 0.05 * 0.8 + 0.1 * 0.2 + (0.1 - 0.05) * 0.5 * 0.05),
        ([0.1, 0, 0.05], [0.2, 0.4, 1.0], 0.05 * 0.8 + 0.1 * 0.2 + (0.1 - 0.05) * 0.5 * 0.05),
        ([1.0], [0.0], 0),  # nothing was found
        ([1.0, 1.0, 0.5], [0.0, 0.0, 0.5], 0.25),  # at recall 0 the curve stays level
        ([0.8, 0.6], [0.5, 0.5], 0.4),  # the best of one recall
        ([0.2, 0.4], [0.5, 0.53], 0.53 * 0.4),  # the best of a higher one
        # From .5 to .47 it climbs within one short step: .3 * .03 + .47 * .4 with half the corner.
        ([0.2, 0.4], [0.5, 0.47], 0.47 * 0.4 + 0.03 * 0.3),
    ],
)
def test_average_precision_by_hand_and_as_waymos_own_tests_have_it(precision, recall, expected):
    found = average_precision(np.array(precision, float), np.array(recall, float))
    assert found == pytest.approx(expected, abs=1e-9)


def stepped(precision, recall) -> float:
    """The plain twin: the curve's points one after another, then the trapezoid rule."""
    best = {0.0: 1.0}
    for p, r in zip(precision, recall, strict=True):
        best[r] = max(best.get(r, 0.0), p)
    points, last, top = [], 0.0, 0.0
    for r in sorted(best, reverse=True):
        while last - r > 0.05 + 1e-6:
            last -= 0.05
            points.append((top, last))
        top = max(top, best[r])
        points.append((top, r))
        last = r
    if len(points) > 1:
        points[-1] = (points[-2][0], points[-1][1])
    return sum((one[1] - other[1]) * (one[0] + other[0]) / 2 for one, other in pairwise(points))


SHARES = st.one_of(st.integers(0, 20).map(lambda n: n / 20), st.floats(0, 1))


@given(curve=st.lists(st.tuples(SHARES, SHARES), max_size=12))
def test_average_precision_is_that_of_the_plain_twin(curve):
    # Where recall is 0, the rules set the precision to 1.
    recall = [r for _, r in curve]
    precision = [p if r > 0 else 1.0 for p, r in curve]
    found = average_precision(np.array(precision, float), np.array(recall, float))
    assert found == pytest.approx(stepped(precision, recall), abs=1e-6)


def values(seen, there, rules=LET):
    """AP, APH and APL of vehicles alone."""
    found = average_precisions(count_frame(seen, there, rules)[0, -1])
    return [float(found[name]) for name in ("ap", "aph", "apl")]


def test_truths_found_exactly_are_perfect(street):
    boxes, names = street
    there = truths(*boxes, classes=names)
    for rules in (LET, PLAIN):
        counts = count_frame(predictions(*boxes, classes=names), there, rules)
        for found in average_precisions(counts[:4, -1]).values():
            np.testing.assert_allclose(found, [1, 1, np.nan, 1], atol=1e-6)  # there is no sign


def test_truths_turned_by_half_are_found_with_no_heading(street):
    boxes, _ = street
    turned = boxes + np.array([0, 0, 0, 0, 0, 0, math.pi])
    for rules in (LET, PLAIN):
        ap, aph, apl = values(predictions(*turned), truths(*boxes), rules)
        assert (ap, apl) == pytest.approx((1, 1), abs=1e-6)
        assert aph == pytest.approx(0, abs=1e-9)


def test_apl_is_ap_times_an_affinity_that_all_share(street):
    boxes, _ = street
    sensor = np.array(LET.tolerance.sensor)
    away = boxes[:3].copy()  # farther than 5 m, where a tenth of the distance is tolerated
    away[:, :3] = sensor + (away[:, :3] - sensor) * 1.04
    ap, _, apl = values(predictions(*away), truths(*boxes[:3]))
    assert ap == pytest.approx(1, abs=1e-6)
    assert apl == pytest.approx(1 - 0.4, abs=1e-4)


def test_nothing_found_is_0_and_nothing_there_is_no_number(street):
    boxes, _ = street
    assert values(predictions(), truths(*boxes)) == [0, 0, 0]
    assert all(math.isnan(value) for value in values(predictions(*boxes), truths()))


def rows(scene, frame, boxes, classes="vehicle", **others):
    columns = ["x", "y", "z", "length", "width", "height", "heading"]
    table = pd.DataFrame(np.array(boxes).reshape(-1, 7), columns=columns)
    return table.assign(**{"scene": scene, "frame": frame, "class": classes, **others})


def test_rows_and_their_table(street, tmp_path):
    boxes, names = street
    given = {"points": 9, "level": 2, "camera": "FRONT"}
    there = pd.concat([rows(scene, 1, boxes, names, **given) for scene in "ab"])
    found = {"score": 0.5, "ignored": 0}
    # Scene a is found whole, of scene b only its first vehicle.
    seen = pd.concat([rows("b", 1, boxes[:1], **found), rows("a", 1, boxes, names, **found)])
    counts = detection_counts(seen, there, LET)
    table = metrics_table(counts, 500, 0.95).set_index(["breakdown", "class", "bin"])
    vehicle = table.loc["type", "vehicle", "all"]
    assert (vehicle["truths"], vehicle["predictions"]) == (8, 5)
    assert vehicle["flipped"] == 0
    # 5 of 8: recall 0.625 with precision 1. Scenes redrawn: both b gives 1/4, both a gives 1.
    expected = {"ap": 0.625, "ap_low": 0.25, "ap_high": 1, "aph": 0.625, "apl": 0.625}
    assert vehicle[list(expected)].to_dict() == pytest.approx(expected, abs=1e-6)
    assert table.loc["type", "pedestrian", "all"]["ap"] == pytest.approx(0.5, abs=1e-6)
    assert table.loc["type", "cyclist", "all"]["ap"] == pytest.approx(0.5, abs=1e-6)
    mean = table.loc["type", MEAN, "all"]
    assert mean["ap"] == pytest.approx((0.625 + 0.5 + 0.5) / 3, abs=1e-6)
    assert mean[["ap_low", "ap_high"]].tolist() == pytest.approx([0.25 / 3, 1], abs=1e-6)
    sign = table.loc["type", "sign", "all"]
    assert sign[["ap", "ap_low", "flipped"]].isna().all()
    assert (sign["truths"], sign["predictions"]) == (0, 0)
    # All derives from the rows, in whatever order they lie in a file.
    write_parquet(tmp_path / "counts.parquet", counts.sample(frac=1, random_state=0))
    again = metrics_table(read_counts(tmp_path / "counts.parquet"), 500, 0.95)
    pd.testing.assert_frame_equal(again, table.reset_index()[list(again)], atol=1e-12)


def test_means_leave_out_what_has_no_truth_and_signs(street):
    boxes, _ = street
    given = {"points": 9, "level": 2, "camera": "FRONT"}
    there = pd.concat([rows("a", 1, boxes, **given), rows("a", 1, boxes[:1], "sign", **given)])
    seen = rows("a", 1, boxes, score=0.5, ignored=0)
    table = metrics_table(detection_counts(seen, there, PLAIN), 100, 0.95)
    mean = table[table["class"] == MEAN].set_index("level")
    assert mean["ap"].tolist() == pytest.approx([math.nan, 1], nan_ok=True)  # none is of LEVEL_1
    assert mean.loc[2, "truths"] == len(boxes)


def test_one_scene_with_truths_gives_no_interval(street):
    boxes, _ = street
    given = {"points": 9, "level": 2, "camera": "FRONT"}
    there = pd.concat([rows("a", frame, boxes, **given) for frame in (1, 2)])
    seen = pd.concat([rows(scene, 1, boxes, score=0.5, ignored=0) for scene in "ab"])
    table = metrics_table(detection_counts(seen, there, LET), 100, 0.95)
    vehicle = table.iloc[0]
    assert vehicle["ap"] == pytest.approx(0.25, abs=1e-6)  # half is found, half of it wrongly
    assert math.isnan(vehicle["ap_low"])
    assert math.isnan(vehicle["ap_high"])


def test_counts_of_frames_are_added(street):
    boxes, names = street
    given = {"points": 9, "level": 2, "camera": "FRONT"}
    there = pd.concat([rows("a", frame, boxes, names, **given) for frame in (1, 2)])
    seen = rows("a", 2, boxes[:2], score=0.9, ignored=0)
    sums = scene_sums(detection_counts(seen, there, LET))
    labels = truths(*boxes, classes=names)
    parts = [count_frame(predictions(*found), labels, LET) for found in ([], boxes[:2])]
    np.testing.assert_allclose(sums, [parts[0] + parts[1]])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"rules": "hers"}, "has counts by the rules 'hers'; give counts by one of LET, plain"),
        ({"class": "tram"}, "has rows that are no counts by the rules 'LET'"),
        ({"level": 1}, "has rows that are no counts"),
        ({"cutoff": 0.123}, "has rows that are no counts"),
        ({"affinity": math.nan}, "has rows that are no counts"),
        ({"truths": -1}, "has rows that are no counts"),
    ],
)
def test_counts_of_others_are_checked(street, tmp_path, change, sentence):
    boxes, _ = street
    there = rows("a", 1, boxes, points=9, level=2, camera="FRONT")
    counts = detection_counts(rows("a", 1, boxes, score=0.5, ignored=0), there, LET)
    path = tmp_path / "counts.parquet"
    write_parquet(path, counts.assign(**change))
    with pytest.raises(GeoEvsError, match=sentence) as error:
        read_counts(path)
    assert str(path) in str(error.value)
    write_parquet(path, counts.iloc[:0])
    with pytest.raises(GeoEvsError, match="has counts by the rules ''"):
        read_counts(path)


def test_neither_predictions_nor_truths_are_refused():
    nothing = rows("a", 1, [], points=9, level=2, camera="", score=0.5, ignored=0)
    with pytest.raises(GeoEvsError, match="neither a prediction nor a truth"):
        detection_counts(nothing, nothing, LET)
