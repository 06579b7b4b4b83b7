import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geoevs.results.bootstrap import bootstrap_mean, paired_difference, summarise


def interval(values, scenes, confidence=0.95, resamples=2000):
    names = np.array(list(scenes), object)
    return bootstrap_mean(np.array(values, float), names, resamples, confidence)


def test_one_frame_a_scene_gives_no_interval():
    for values, scenes in (([4.0], ["a"]), ([3.0, 5.0], ["a", "b"])):
        mean, low, high = interval(values, scenes)
        assert mean == 4.0
        assert math.isnan(low)
        assert math.isnan(high)


def test_two_frames_by_hand():
    # Redrawn means are 0, 1/2 and 1 with chances 1/4, 1/2 and 1/4.
    assert interval([0, 1], "aa", 0.95) == (0.5, 0.0, 1.0)
    assert interval([0, 1], "aa", 0.45) == (0.5, 0.5, 0.5)  # tails of 0.275
    assert interval([0, 1], "aa", 0.55) == (0.5, 0.0, 1.0)  # tails of 0.225


def test_frames_are_redrawn_within_their_scene():
    # The scenes differ much, their frames do not: nothing varies.
    assert interval([9, 9, 0, 0, 0], "aabbb") == pytest.approx((3.6, 3.6, 3.6))
    # One scene's single frame always counts; the other gives 0, 1/2 or 1 in the mean.
    assert interval([4, 0, 1], list("abb")) == pytest.approx((5 / 3, 4 / 3, 2.0))


def test_infinite_values_stay_infinite():
    assert interval([math.inf, math.inf], "aa") == (math.inf, math.inf, math.inf)
    # Both draws are the finite frame in a quarter of the resamples.
    assert interval([math.inf, 1.0], "aa") == (math.inf, 1.0, math.inf)


def test_the_same_numbers_every_time():
    values = np.random.default_rng(1).random(9)
    assert interval(values, "aaabbbccc") == interval(values, "aaabbbccc")


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(-100, 100), min_size=2, max_size=9), st.floats(0.5, 0.99))
def test_the_interval_lies_within_the_values(values, confidence):
    mean, low, high = interval(values, ["a"] * len(values), confidence, 100)
    assert min(values) - 1e-9 <= low <= high <= max(values) + 1e-9
    assert mean == pytest.approx(np.mean(values))


def frame(*rows) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["metric", "scene", "frame", "value", "status"])


def test_a_frame_counts_once_however_many_targets_it_has():
    rows = frame(
        *[("m", "a", 0, value, "ok") for value in (1.0, 2.0, 3.0)],
        ("m", "a", 1, 10.0, "ok"),
    )
    (summary,) = summarise(rows, ["metric"], 1000, 0.95).to_dict("records")
    assert summary == {"metric": "m", "mean": 6.0, "low": 2.0, "high": 10.0, "n": 4, "failed": 0}


def test_frames_of_two_scenes_are_two_frames():
    rows = frame(("m", "a", 0, 1.0, "ok"), ("m", "b", 0, 3.0, "ok"), ("m", "b", 0, 9.0, "ok"))
    assert summarise(rows, ["metric"], 100, 0.95)["mean"].tolist() == [3.5]


def test_rows_without_a_value_are_counted_and_not_averaged():
    rows = frame(
        ("m", "a", 0, 1.0, "ok"),
        ("m", "a", 1, math.nan, "failed"),
        ("m", "a", 2, math.nan, "empty-mask"),
        ("x", "a", 1, math.nan, "failed"),
    )
    summary = summarise(rows, ["metric"], 100, 0.95).set_index("metric")
    assert summary.loc["m", ["mean", "n", "failed"]].tolist() == [1.0, 1, 1]
    assert summary.loc["x", ["n", "failed"]].tolist() == [0, 1]
    assert math.isnan(summary.loc["x", "mean"])


def test_groups_keep_the_order_of_the_rows():
    rows = frame(*[(name, "a", 0, 1.0, "ok") for name in "zax"])
    assert summarise(rows, ["metric"], 100, 0.95)["metric"].tolist() == ["z", "a", "x"]


def test_no_rows_give_the_columns():
    empty = summarise(frame(), ["metric"], 100, 0.95)
    assert list(empty.columns) == ["metric", "mean", "low", "high", "n", "failed"]
    assert len(empty) == 0


def entrant(*rows) -> pd.DataFrame:
    """Rows of scene, frame, target, seed and value."""
    return pd.DataFrame(rows, columns=["scene", "frame", "target", "seed", "value"])


def grid(values) -> pd.DataFrame:
    """One scene; a line of values for each seed, a value for each frame."""
    return entrant(
        *[
            ("a", frame, "t", seed, value)
            for seed, line in enumerate(values)
            for frame, value in enumerate(line)
        ]
    )


def zeros(rows) -> pd.DataFrame:
    return rows.assign(value=0.0)


def difference(rows, others, confidence=0.95, resamples=2000):
    found = paired_difference(rows, others, resamples, confidence)
    return found.mean, found.low, found.high


@pytest.mark.parametrize("values", [[[0.0, 1.0]], [[0.0], [1.0]]], ids=["frames", "seeds"])
def test_two_frames_or_two_seeds_by_hand(values):
    # Redrawn means are 0, 1/2 and 1 with chances 1/4, 1/2 and 1/4.
    rows = grid(values)
    assert difference(rows, zeros(rows), 0.95) == (0.5, 0.0, 1.0)
    assert difference(rows, zeros(rows), 0.45) == (0.5, 0.5, 0.5)
    assert difference(rows, zeros(rows), 0.55) == (0.5, 0.0, 1.0)


def test_a_seed_counts_once_however_many_frames_it_has():
    # Both seeds in all draws of frames: only the seeds vary, by as much as with one frame.
    rows = grid([[-1.0] * 8, [1.0] * 8])
    assert difference(rows, zeros(rows)) == (0.0, -1.0, 1.0)
    # But what all seeds share in a frame varies with the frames alone.
    rows = grid([[-1.0, 1.0]] * 8)
    assert difference(rows, zeros(rows)) == (0.0, -1.0, 1.0)
    assert difference(rows, zeros(rows), 0.45) == (0.0, 0.0, 0.0)


def test_seeds_and_frames_vary_independently():
    # Each of four cells counts 4, 2, 1 or 0 times; the mean is 4 only if one seed and one frame,
    # those of the last cell, are drawn twice: a chance of 1/16.
    rows = grid([[0.0, 0.0], [0.0, 4.0]])
    assert difference(rows, zeros(rows), 1 - 2 * 0.05) == (1.0, 0.0, 4.0)
    assert difference(rows, zeros(rows), 1 - 2 * 0.08)[2] == 2.0


def test_targets_of_a_frame_are_averaged():
    rows = entrant(("a", 0, "t", 0, 1.0), ("a", 0, "u", 0, 3.0), ("a", 1, "t", 0, 8.0))
    assert difference(rows, zeros(rows)) == (5.0, 2.0, 8.0)


def test_pairs_share_scene_frame_target_and_seed():
    rows = entrant(("a", 0, "t", 0, 1.0), ("a", 1, "t", 0, 5.0))
    shuffled = entrant(("a", 1, "t", 0, 3.0), ("a", 0, "t", 0, 0.0))
    assert difference(rows, shuffled)[0] == 1.5
    for stranger in (("b", 0, "t", 0), ("a", 2, "t", 0), ("a", 0, "u", 0), ("a", 0, "t", 1)):
        found = paired_difference(rows, entrant((*stranger, 9.0)), 100, 0.95)
        assert found.pairs == 0
        assert math.isnan(found.mean)
        both = pd.concat([shuffled, entrant((*stranger, 9.0))])
        assert difference(rows, both)[0] == 1.5


def test_values_that_are_no_number_make_no_pair():
    rows = grid([[1.0, math.inf, math.nan]])
    found = paired_difference(rows, zeros(rows), 100, 0.95)
    assert (found.mean, found.pairs) == (1.0, 1)
    assert math.isnan(found.low)
    assert paired_difference(rows[1:], zeros(rows), 100, 0.95).pairs == 0


def test_one_frame_a_scene_and_one_seed_give_no_interval():
    rows = entrant(("a", 0, "t", 0, 1.0), ("b", 0, "t", 0, 3.0))
    mean, low, high = difference(rows, zeros(rows))
    assert mean == 2.0
    assert math.isnan(low)
    assert math.isnan(high)


def test_a_seed_that_lacks_frames_still_counts():
    rows = entrant(("a", 0, "t", 0, 1.0), ("a", 1, "t", 0, 1.0), ("a", 1, "t", 1, 4.0))
    mean, low, high = difference(rows, zeros(rows))
    assert mean == 2.0  # three cells
    assert (low, high) == (1.0, 4.0)


@settings(deadline=None, max_examples=30)
@given(
    st.lists(st.lists(st.floats(-50, 50), min_size=3, max_size=3), min_size=1, max_size=3),
    st.floats(-20, 20),
)
def test_what_all_pairs_share_shifts_the_interval(values, shift):
    rows = grid(values)
    before = difference(rows, zeros(rows), resamples=100)
    after = difference(rows, rows.assign(value=-shift), resamples=100)
    assert after == pytest.approx([end + shift for end in before], abs=1e-6)
    assert before[1] <= before[2]
    reverse = difference(zeros(rows), rows, resamples=100)
    assert reverse[0] == pytest.approx(-before[0], abs=1e-9)
