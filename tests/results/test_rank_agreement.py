"""Kendall's tau between the paper's order and a run's, by hand."""

import math

import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.results.paper import paper_values
from geoevs.results.rank_agreement import make_rank_agreement, rank_agreement_markdown
from geoevs.results.settings import TableSettings

TAU = ("tau", "tau_low", "tau_high")
SETTINGS = TableSettings([], [], 200, 0.95, "geo-evs")
# Of the paper's table 2 by sparse PSNR, from worst to best.
PAPER = sorted(
    paper_values("extrapolation"),
    key=lambda name: paper_values("extrapolation")[name]["sparse_psnr"],
)


@pytest.fixture
def agreement(rows):
    """The row of a table and metric, of methods' values by frame."""

    def make(values, split="extrapolation", metric="sparse_psnr", more=()):
        changes = [
            {"method": method, "split": split, "metric": metric, "frame": frame, "value": value}
            for method, frames in values.items()
            for frame, value in enumerate(frames)
        ]
        table = make_rank_agreement(rows(*changes, *more), SETTINGS)
        found = table[(table["table"] == split) & (table["metric"] == metric)]
        (row,) = found.to_dict("records")
        return row

    return make


def test_the_papers_own_values_agree_with_themselves(agreement):
    printed = paper_values("extrapolation")
    row = agreement({name: [cells["sparse_psnr"]] * 3 for name, cells in printed.items()})
    assert tuple(row[k] for k in TAU) == pytest.approx((1, 1, 1))
    assert (row["methods"], row["left_out"]) == (5, 0)
    assert row["paper"] == row["here"]
    assert row["paper"].startswith("Geo-EVS > Street Gaussians > FreeVS > EmerNeRF > ")


def test_one_swapped_pair_by_hand(agreement):
    # One of ten pairs is the other way round: (9 - 1) / 10.
    worst, second, *others = PAPER
    order = [second, worst, *others]
    row = agreement({name: [float(place)] * 2 for place, name in enumerate(order)})
    assert row["tau"] == pytest.approx(0.8)
    backwards = agreement({name: [-float(place)] * 2 for place, name in enumerate(PAPER)})
    assert backwards["tau"] == pytest.approx(-1)


def test_frames_are_redrawn_for_all_methods_at_once(agreement):
    # In every frame the order is the paper's, though frames differ by more than methods.
    row = agreement({name: [place, 100.0 + place] for place, name in enumerate(PAPER)})
    assert (row["tau_low"], row["tau_high"]) == pytest.approx((1, 1))
    # In one of two frames it is reversed, by as much less than it holds in the other.
    mixed = agreement({name: [2.0 * place, -1.0 * place] for place, name in enumerate(PAPER)})
    assert tuple(mixed[k] for k in TAU) == pytest.approx((1, -1, 1))


def test_absent_and_failed_methods_are_left_out_and_counted(agreement):
    values = {name: [float(place)] * 2 for place, name in enumerate(PAPER[:3])}
    row = agreement({**values, PAPER[3]: [math.nan] * 2, "reproject": [99.0] * 2})
    assert (row["tau"], row["methods"], row["left_out"]) == (pytest.approx(1), 3, 2)
    one = agreement({PAPER[0]: [1.0, 2.0]})
    assert math.isnan(one["tau"])
    assert (one["methods"], one["left_out"]) == (1, 4)


def test_variants_and_stressed_rows_do_not_rank(agreement):
    values = {name: [float(place)] * 2 for place, name in enumerate(PAPER)}
    other = {"method": PAPER[0], "value": 99.0}
    more = [{**other, "variant": "large"}, {**other, "stressor": "thinning"}]
    assert agreement(values, more=more)["tau"] == pytest.approx(1)


def test_every_metric_that_is_printed_and_measured_has_a_row(rows):
    table = make_rank_agreement(rows({"method": "geo-evs"}), SETTINGS)
    found = table[["table", "metric"]].itertuples(index=False, name=None)
    assert list(found) == [
        ("extrapolation", "sparse_psnr"),
        ("extrapolation", "sparse_ssim"),
        ("interpolation", "ssim"),
        ("interpolation", "psnr"),
        ("interpolation", "lpips"),
    ]


def test_orders_go_from_best_to_worst_where_less_is_better(rows):
    lpips = {"split": "interpolation", "metric": "lpips"}
    made = [
        {**lpips, "method": "emernerf", "value": 0.1},
        {**lpips, "method": "geo-evs", "value": 0.2},
    ]
    table = make_rank_agreement(rows(*made), SETTINGS).set_index("metric")
    assert table.loc["lpips", "paper"] == "Geo-EVS > EmerNeRF"
    assert table.loc["lpips", "here"] == "EmerNeRF > Geo-EVS"
    assert table.loc["lpips", "tau"] == pytest.approx(-1)


def test_markdown_says_tau_with_its_interval(rows):
    changes = [
        {"method": name, "frame": frame, "value": float(place + frame)}
        for place, name in enumerate(PAPER)
        for frame in (0, 1)
    ]
    text = rank_agreement_markdown(make_rank_agreement(rows(*changes), SETTINGS))
    assert "| extrapolation | sparse_psnr | 1.00 [1.00, 1.00] | 5 | 0 | Geo-EVS > " in text
    assert "| interpolation | psnr |  | 0 | 5 |  |  |" in text


def test_one_frame_a_scene_has_no_interval(agreement):
    row = agreement({name: [float(place)] for place, name in enumerate(PAPER)})
    assert row["tau"] == pytest.approx(1)
    assert math.isnan(row["tau_low"])


def test_protocols_are_not_mixed(rows):
    with pytest.raises(GeoEvsError, match=r"protocol"):
        make_rank_agreement(rows({}, {"fingerprint": "g"}), SETTINGS)


def test_a_method_that_lacks_a_view_is_in_no_order(agreement, rows):
    # The worst method fails on the frame that is hard for all: by its other frame it is the best.
    values = {name: [50.0 + place, float(place)] for place, name in enumerate(PAPER)}
    whole = agreement(values)
    assert (whole["tau"], whole["methods"]) == (pytest.approx(1), 5)
    row = agreement({**values, PAPER[0]: [99.0, math.nan]})
    assert (row["methods"], row["left_out"]) == (4, 1)
    assert row["tau"] == pytest.approx(1)
    # One of several targets, or of several seeds, is enough.
    more = [{"method": name, "target": "other", "value": 9.0} for name in PAPER[1:]]
    assert agreement(values, more=more)["methods"] == 4
    lost = {"method": PAPER[4], "seed": 1, "value": math.nan, "status": "failed"}
    assert agreement(values, more=[lost])["methods"] == 4
