import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geoevs.results.summary import bootstrap_mean, summarise


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
