"""Curves, breaking points and spread, on rows made by hand."""

import math

import numpy as np
import pytest

from geoevs.protocol.stressors import STRESSORS, Stressor
from geoevs.results.chart_pages import page_html
from geoevs.results.entrants import Entrants, Info
from geoevs.results.settings import TableSettings
from geoevs.results.stability import breaking_points, make_stability_table, seed_spread
from geoevs.results.stability_chart import curves, stability_curves
from geoevs.results.stability_page import stability_markdown

CONTROL_NAMES = ("mean-colour", "nearest-view", "reproject-inpaint", "reproject-inpaint.all-frames")
GIVEN = (
    TableSettings([], [], 200, 0.9, "geo-evs"),
    Entrants({name: Info(name.partition(".")[0], "control") for name in CONTROL_NAMES}),
)
LEVELS = [0.1, 0.05, 0.01]


def curve(method, clean, values, stressor="support", levels=LEVELS, wobble=0.0, **more):
    """Rows of two frames and two draws that lie `wobble` below and above."""
    table = [("clean", 0.0, clean)] if clean is not None else []
    table += [(stressor, level, value) for level, value in zip(levels, values, strict=True)]
    return [
        {
            **{"method": method, "stressor": stress, "level": level, "frame": frame, "seed": draw},
            **{"metric": "psnr", "target": "t", "value": value + wobble * (2 * draw - 1)},
            **more,
        }
        for stress, level, value in table
        for frame in (0, 1)
        for draw in (0, 1)
    ]


def page_of(scores):
    """The suite's page in words."""
    made = (make(scores, *GIVEN) for make in (make_stability_table, breaking_points, seed_spread))
    return stability_markdown(*made)


def one(table, **where):
    for column, value in where.items():
        table = table[table[column] == value]
    (row,) = table.to_dict("records")
    return row


CONTROLS = [
    *curve("mean-colour", 10.0, [10.0] * 3),
    *curve("reproject-inpaint", 24.0, [20.0, 16.0, 9.0]),
]


def test_a_curve_starts_clean_and_says_what_is_lost(rows):
    table = make_stability_table(rows(*CONTROLS, *curve("mine", 25.0, [20, 15, 5])), *GIVEN)
    mine = table[table["method"] == "mine"]
    assert mine["level"].tolist()[1:] == LEVELS  # hardest last
    assert math.isnan(mine["level"].iloc[0])
    assert mine["mean"].tolist() == [25, 20, 15, 5]
    assert mine["change"].tolist() == [0, -5, -10, -20]
    assert mine["relative_degradation"].tolist() == pytest.approx([0, 0.2, 0.4, 0.8])
    assert mine["failure_rate"].tolist() == [0, 0, 0, 1]  # below the floor's 10 dB
    assert mine["n"].tolist() == [4] * 4


def test_every_world_has_a_floor_of_its_own(rows):
    worlds = {"stressor": "motion", "levels": [0, 20]}
    made = rows(
        *CONTROLS,
        *curve("mean-colour", None, [14.0, 18.0], **worlds),
        *curve("mean-colour", 30.0, [30.0] * 3, dataset="elsewhere"),
        *curve("mine", 25.0, [20, 12, 9]),
        *curve("mine", None, [15.0, 17.0], **worlds),
    )
    table = make_stability_table(made, *GIVEN)
    rates = table[table["method"] == "mine"].groupby("stressor")["failure_rate"].agg(list)
    assert rates["support"] == [0, 0, 0, 1]  # below 10 dB
    assert rates["motion"] == [0, 1]  # below 14, below 18


def test_worlds_of_two_stressors_at_one_level_are_two(rows, monkeypatch):
    grain = Stressor("rays of a pixel", kind="world", levels=(20,), option="samples")
    monkeypatch.setitem(STRESSORS, "grain", grain)
    made = rows(
        *curve("mean-colour", None, [18.0], stressor="motion", levels=[20]),
        *curve("mean-colour", None, [8.0], stressor="grain", levels=[20]),
        *curve("mine", None, [17.0], stressor="motion", levels=[20]),
        *curve("mine", None, [9.0], stressor="grain", levels=[20]),
    )
    table = make_stability_table(made, *GIVEN)
    rates = table[table["method"] == "mine"].set_index("stressor")["failure_rate"]
    assert rates.to_dict() == {"motion": 1, "grain": 0}


def test_draws_widen_the_interval_and_the_worst_tenth_is_below_the_mean(rows):
    table = make_stability_table(rows(*CONTROLS, *curve("mine", 25, LEVELS, wobble=1)), *GIVEN)
    row = one(table[table["level"].isna()], method="mine")
    assert (row["low"], row["mean"], row["high"]) == (24, 25, 26)
    assert row["worst_decile"] == 24


def test_a_change_is_of_the_same_draws(rows):
    # Draws lie 2 dB apart, but each loses the same at every level.
    table = make_stability_table(rows(*CONTROLS, *curve("mine", 25, [20] * 3, wobble=1)), *GIVEN)
    row = one(table, method="mine", level=0.01)
    assert (row["low"], row["high"]) == (19, 21)
    assert row["change"] == -5
    assert math.isnan(row["change_low"])  # it is the same in every resample
    uneven = [
        row | ({"value": row["value"] - 1} if row["seed"] and row["level"] == 0.01 else {})
        for row in curve("mine", 25, [20] * 3)
    ]
    row = one(
        make_stability_table(rows(*CONTROLS, *uneven), *GIVEN),
        method="mine",
        level=0.01,
    )
    assert (row["change_low"], row["change"], row["change_high"]) == (-6, -5.5, -5)


def test_the_page_says_what_the_hardest_level_leaves(rows):
    uneven = [
        row | ({"value": row["value"] - 1} if row["seed"] and row["level"] == 0.01 else {})
        for row in curve("mine", 25, [20, 15, 12])
    ]
    page = page_of(rows(*CONTROLS, *uneven, *curve("three-dgs", 20.0, [15, 15, 9])))
    left = page.split("# What the hardest level leaves")[1].split("# Seed spread")[0]
    assert "| method | support 0.01 |" in left
    assert "| *reproject-inpaint* | 9.0 ▼, -15.0 |" in left  # the floor has 10
    assert "| mine | 11.5, -13.5 [-14.0, -13.0] |" in left
    assert "| 3DGS | 9.0 ▼, -11.0 |" in left


def test_undelivered_views_are_failures(rows):
    missing = [row | {"value": math.nan, "status": "failed"} for row in curve("mine", 25, [1] * 3)]
    table = make_stability_table(rows(*CONTROLS, *missing), *GIVEN)
    assert (table[table["method"] == "mine"]["failure_rate"] == 1).all()
    broken = breaking_points(rows(*CONTROLS, *missing), *GIVEN)
    assert one(broken, method="mine")["level"] == "clean"


@pytest.mark.parametrize(
    ("clean", "values", "level"),
    [
        (25.0, [21, 15, 9.5], "0.05"),
        (25.0, [21, 17, 9.5], "0.01"),  # the floor is the best control there
        (25.0, [21, 17, 11], "none"),
        (23.0, [21, 17, 11], "clean"),
    ],
)
def test_the_breaking_point_is_the_first_level_below_the_best_control(rows, clean, values, level):
    broken = breaking_points(rows(*CONTROLS, *curve("mine", clean, values)), *GIVEN)
    row = one(broken, method="mine")
    assert (row["level"], row["low"], row["high"]) == (level, level, level)
    assert row["lead"] == pytest.approx(clean - 24)
    assert row["control"] == ("mean-colour" if level in ("0.01", "none") else "reproject-inpaint")
    assert set(broken["method"]) == {"mine"}


def test_a_control_without_a_value_leaves_the_others_to_judge(rows):
    gone = curve("nearest-view", 30.0, [math.nan] * 3)  # no car in view of it, say
    mine = curve("mine", 31.0, [21, 15, 11])
    broken = breaking_points(rows(*CONTROLS, *gone, *mine), *GIVEN)
    row = one(broken, method="mine")
    # Above 30, 20, then below the 16 of reproject-inpaint.
    assert (row["level"], row["low"], row["high"]) == ("0.05", "0.05", "0.05")
    assert row["control"] == "reproject-inpaint"
    assert row["lead"] == pytest.approx(1)


@pytest.mark.parametrize(
    ("values", "level", "control"),
    [
        ([21, math.nan, 5.0], "0.01", "mean-colour"),  # 21 > 20; nobody has a value; 5 < 10
        ([19, math.nan, 11.0], "0.1", "reproject-inpaint"),
        ([21, math.nan, 11.0], "none", "mean-colour"),
    ],
)
def test_levels_that_no_control_has_a_value_at_judge_nobody(rows, values, level, control):
    controls = [
        *curve("mean-colour", 10.0, [10.0, math.nan, 10.0]),
        *curve("reproject-inpaint", 24.0, [20.0, math.nan, 9.0]),
    ]
    broken = breaking_points(rows(*controls, *curve("mine", 25.0, values)), *GIVEN)
    row = one(broken, method="mine")
    assert (row["level"], row["low"], row["high"]) == (level, level, level)
    assert row["control"] == control


def test_a_control_is_named_with_its_variant(rows):
    better = curve("reproject-inpaint", 26.0, [22.0] * 3, variant="all-frames")
    made = rows(*CONTROLS, *better, *curve("mine", 27, [25, 21, 8]))
    row = one(breaking_points(made, *GIVEN), method="mine")
    assert (row["level"], row["control"]) == ("0.05", "reproject-inpaint (all-frames)")


def test_where_the_hardest_level_is_undefined_the_last_that_is_names_the_control(rows):
    controls = [
        *curve("mean-colour", 10.0, [10.0, 10.0, math.nan]),
        *curve("reproject-inpaint", 24.0, [20.0, 16.0, math.nan]),
    ]
    mine = curve("mine", 25.0, [21, 17, math.nan])
    row = one(breaking_points(rows(*controls, *mine), *GIVEN), method="mine")
    assert (row["level"], row["high"]) == ("none", "none")
    assert row["control"] == "reproject-inpaint"


def test_a_metric_that_nobody_has_breaks_nobody(rows):
    nobody = [
        row
        for method in ("mean-colour", "mine")
        for row in curve(method, None, [math.nan] * 3, "motion", [0, 5, 10], metric="psnr_moving")
    ]
    made = rows(*CONTROLS, *curve("mine", 25, [21, 17, 11]), *nobody)
    broken = breaking_points(made, *GIVEN)
    row = one(broken, method="mine", metric="psnr_moving")
    assert (row["level"], row["low"], row["high"], row["control"]) == ("", "", "", "")
    page = page_of(made)
    assert page.count("## d, psnr_moving") == 2
    assert page.count("| mine |  |") == 2


def test_resamples_without_a_value_break_nobody(rows):
    seen = [
        row | ({"value": math.nan} if row["frame"] == 0 else {})
        for row in [*CONTROLS, *curve("mine", 25.0, [21, 17, 11])]
    ]  # a quarter of the resamples draw frame 0 twice
    row = one(breaking_points(rows(*seen), *GIVEN), method="mine")
    assert (row["level"], row["low"], row["high"]) == ("none", "none", "none")


def test_its_interval_holds_what_draws_leave_open(rows):
    mine = curve("mine", 30, [20.5, 16.5, 11], wobble=1.0)
    row = one(breaking_points(rows(*CONTROLS, *mine), *GIVEN), method="mine")
    assert row["level"] == "none"
    assert (row["low"], row["high"]) == ("0.1", "none")


def test_poses_start_from_their_own_mildest_level(rows):
    poses = {"stressor": "lateral", "levels": [0, 2, 4]}
    made = rows(
        *curve("mean-colour", 10, [10] * 3, **poses), *curve("mine", 40, [20, 18, 8], **poses)
    )
    table = make_stability_table(made, *GIVEN)
    mine = table[table["method"] == "mine"]
    assert mine["level"].tolist() == [0, 2, 4]
    assert mine["relative_degradation"].iloc[1] == pytest.approx(0.1)
    assert mine["failure_rate"].tolist() == [0, 0, 1]


def test_spread_is_in_8_bit_levels(rows):
    spreads = [
        {"method": "mine", "stressor": "clean", "metric": f"seed_spread_{part}", "value": value}
        for part, value in (("supported", 0.01), ("new", 0.1))
    ]
    spread = seed_spread(rows(*spreads), *GIVEN)
    assert spread["mean"].to_list() == pytest.approx([2.55, 25.5])
    assert "| mine | 2.55 | 25.50 |" in page_of(rows(*CONTROLS, *spreads))


def test_the_chart_goes_from_clean_to_hardest(rows):
    table = make_stability_table(rows(*CONTROLS), *GIVEN)
    shown = curves(table, "support")
    assert list(dict.fromkeys(shown["severity"])) == ["clean", "0.1", "0.05", "0.01"]
    page = page_html(stability_curves(shown, "support").to_dict())
    assert "valid pixels of the LiDAR condition" in page
    assert 'src="http' not in page
    assert np.isfinite(shown["mean"]).all()


def lost(made, level, frames=(0,)):
    """Rows of which some frames failed at a level, in the second draw."""
    failed = {"value": math.nan, "status": "failed"}
    return [
        row | (failed if row["level"] == level and row["frame"] in frames and row["seed"] else {})
        for row in made
    ]


@pytest.mark.parametrize(("level", "named"), [(0.05, "0.05"), (0.0, "clean"), (0.01, "0.01")])
def test_a_method_breaks_where_it_lacks_a_view(rows, level, named):
    mine = lost(curve("mine", 30.0, [29.0, 28.0, 27.0]), level)
    made = rows(*CONTROLS, *mine)
    row = one(breaking_points(made, *GIVEN), method="mine")
    assert (row["level"], row["low"], row["high"], row["lacking"]) == (named, named, named, 1)
    assert f"| mine | {named} † |" in page_of(made)


def test_a_control_that_lacks_a_view_is_no_rival_there(rows):
    # Of its easy frame alone the control would be 5 dB above the method.
    control = curve("nearest-view", 10.0, [26.0, 9.0, 9.0])
    mine = curve("mine", 25.0, [21.0, 17.0, 11.0])
    row = one(breaking_points(rows(*CONTROLS, *lost(control, 0.1), *mine), *GIVEN), method="mine")
    assert row["level"] == "none"
    row = one(breaking_points(rows(*CONTROLS, *control, *mine), *GIVEN), method="mine")
    assert row["level"] == "0.1"


def test_survivors_have_a_mean_and_neither_changes_nor_a_worst_tenth(rows):
    uneven = [
        row | {"value": row["value"] - 9 * row["frame"]} for row in curve("mine", 25, [20] * 3)
    ]
    made = rows(*CONTROLS, *lost(uneven, 0.01, frames=(1,)))
    table = make_stability_table(made, *GIVEN)
    row = one(table, method="mine", level=0.01)
    assert (row["mean"], row["n"], row["lacking"]) == (pytest.approx(17), 3, 1)
    for name in ("change", "change_low", "relative_degradation", "worst_decile"):
        assert math.isnan(row[name])
    assert row["failure_rate"] == 0.25
    assert one(table, method="mine", level=0.05)["change"] == -5
    assert "| mine | 17.0 † |" in page_of(made)
    chart = stability_curves(curves(table, "support"), "support").to_json()
    assert "Hollow: views are missing" in chart
    whole = make_stability_table(rows(*CONTROLS), *GIVEN)
    assert "Hollow" not in stability_curves(curves(whole, "support"), "support").to_json()


def test_a_floor_that_lacks_views_marks_nobody(rows):
    mine = curve("mine", 25.0, [20, 15, 9])
    assert "| mine | 9.0 ▼, -16.0 |" in page_of(rows(*CONTROLS, *mine))
    page = page_of(rows(*lost(CONTROLS[:16], 0.01), *CONTROLS[16:], *mine))
    assert "| mine | 9.0, -16.0 |" in page


def test_a_spread_over_fewer_scenes_is_marked(rows):
    spreads = [
        {"method": method, "scene": scene, "stressor": "clean", "metric": f"seed_spread_{part}"}
        for method, scene in (("mine", "s"), ("mine", "t"), ("other", "s"))
        for part in ("supported", "new")
    ]
    page = page_of(rows(*CONTROLS, *({**row, "value": 0.1} for row in spreads)))
    assert "| other | 25.50 † | 25.50 † |" in page
    assert "| mine | 25.50 | 25.50 |" in page
