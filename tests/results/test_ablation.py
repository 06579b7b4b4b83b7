import dataclasses
import math

import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.results.ablation import (
    MEASURES,
    ablation_latex,
    ablation_markdown,
    column_name,
    make_ablation_table,
)
from geoevs.results.entrants import Entrants, Info
from geoevs.results.settings import TableSettings

SETTINGS = TableSettings([], [], 200, 0.95, "geo-evs")
ENTRANTS = Entrants({})
HIDDEN = {"split": "masked-observed", "metric": "psnr_removed"}


@pytest.fixture
def table(rows):
    def make(*changes):
        usual = {"method": "geo-evs", "target": "t"}
        scores = rows(*[{**usual, **change} for change in changes])
        return make_ablation_table(scores, SETTINGS, ENTRANTS)

    return make


def by_variant(table):
    return {row["variant"]: row for row in table.to_dict("records")}


def values(variant, numbers, **more):
    """Rows of one variant, one a frame."""
    return [{"variant": variant, "frame": k, "value": v, **more} for k, v in enumerate(numbers)]


def test_differences_are_of_pairs(table):
    # The full model gains 1 dB in each frame, though the frames differ much from each other.
    made = by_variant(
        table(
            *values("default", [21.0, 31.0, 41.0]),
            *values("v1", [20.0, 30.0, 40.0]),
            *values("v1", [10.0], **HIDDEN),
            *values("default", [12.0], **HIDDEN),
        )
    )
    assert list(made) == ["v1", "default"]
    variant, full = made["v1"], made["default"]
    assert variant["extrapolation_sparse_psnr"] == pytest.approx(30)
    assert variant["extrapolation_sparse_psnr_low"] < 25
    for suffix in ("", "_low", "_high"):
        assert variant[f"extrapolation_sparse_psnr_diff{suffix}"] == pytest.approx(1)
    assert variant["masked_observed_psnr_removed_diff"] == 2.0
    assert math.isnan(variant["masked_observed_psnr_removed_diff_low"])  # one frame, one seed
    assert math.isnan(full["extrapolation_sparse_psnr_diff"])
    assert math.isnan(variant["observed_psnr"])
    assert (variant["seeds"], variant["note"], full["note"]) == (1, "", "")


def test_the_seeds_spread_is_of_their_means(table):
    made = table(
        *values("default", [20.0, 22.0], seed=0),
        *values("default", [23.0, 25.0], seed=1),
        *values("v1", [20.0]),
    )
    variant, full = by_variant(made).values()
    assert full["extrapolation_sparse_psnr_seed_sd"] == pytest.approx(3 / math.sqrt(2))  # 21, 24
    assert math.isnan(variant["extrapolation_sparse_psnr_seed_sd"])  # one seed
    assert "| over seeds, dB" in ablation_markdown(made)
    assert "| over seeds, dB" not in ablation_markdown(table(*values("v1", [20.0])))


def test_every_measure_has_its_columns(table):
    made = table(*values("v1", [1.0]))
    for split, metric in MEASURES:
        name = column_name(split, metric)
        for suffix in ("", "_low", "_high", "_diff", "_diff_low", "_diff_high", "_seed_sd"):
            assert f"{name}{suffix}" in made
    assert [name for name in made if name.endswith("_paper")] == ["extrapolation_sparse_psnr_paper"]


def test_the_papers_numbers_stand_beside(table):
    names = ("v1", "v2", "v2-unmatched", "default")
    made = by_variant(table(*[row for name in names for row in values(name, [1.0])]))
    assert list(made) == list(names)
    paper = [row["extrapolation_sparse_psnr_paper"] for row in made.values()]
    assert paper[:2] == [21.73, 22.34]
    assert math.isnan(paper[2])
    assert paper[3] == 23.65


def test_only_plain_rows_of_geo_evs_count(table):
    made = table(
        *values("default", [20.0]),
        *values("default", [90.0], stressor="reference-thinning", level=0.5),
        *values("default", [90.0], method="other"),
        *values("default", [90.0], split="pose-sweep"),
    )
    assert made["extrapolation_sparse_psnr"].tolist() == [20.0]


def test_the_config_says_which_method_is_ablated(rows):
    settings = dataclasses.replace(SETTINGS, ablation="mine")
    made = make_ablation_table(
        rows(
            *values("default", [20.0], method="mine"),
            *values("small", [18.5], method="mine"),
            *values("v1", [90.0], method="geo-evs"),
        ),
        settings,
        Entrants({"mine": Info("Mine", "reconstruction"), "mine.small": Info("Mine")}),
    )
    assert by_variant(made)["small"]["extrapolation_sparse_psnr_diff"] == 1.5
    assert made["method"].tolist() == ["mine", "mine"]
    assert "extrapolation_sparse_psnr_paper" not in made  # the paper ablates another one
    assert "| dB ↑ | Mine (small) | Mine |" in ablation_markdown(made)
    assert "| extrapolation sparse_psnr | +1.50 |" in ablation_markdown(made)


def test_what_cannot_be_compared_is_noted(table):
    alone = by_variant(table(*values("v1", [20.0])))
    assert alone["v1"]["note"] == "no pair with the full model"
    strangers = by_variant(table(*values("v1", [20.0], seed=1), *values("default", [20.0], seed=2)))
    assert strangers["v1"]["note"] == "no pair with the full model"
    failed = {"status": "failed", "value": math.nan}
    broken = table(*values("v1", [20.0]), *[{"variant": "v1", "frame": 1, **HIDDEN, **failed}] * 2)
    assert (broken["failed"][0], broken["note"][0]) == (1, "failed on 1 views")


def test_a_run_without_geo_evs_says_so(table):
    made = table(*values("default", [20.0], method="reproject"))
    assert made["note"].tolist() == ["no variant of geo-evs was run"]
    assert "## d\n\nNo variant of geo-evs was run.\n" in ablation_markdown(made)
    assert "% d: no variant of geo-evs was run" in ablation_latex(made)
    assert "tabular" not in ablation_latex(made)


def test_each_data_set_is_compared_within_itself(table):
    made = table(
        *values("default", [20.0], dataset="a"),
        *values("v1", [19.0], dataset="a"),
        *values("v1", [19.0], dataset="b"),
    )
    found = made.set_index(["dataset", "variant"])["extrapolation_sparse_psnr_diff"]
    assert found["a", "v1"] == 1.0
    assert math.isnan(found["b", "v1"])


def test_markdown_by_hand(table):
    text = ablation_markdown(
        table(*values("v1", [20.0, 20.0]), *values("default", [20.5, 20.5, 30.0]))
    )
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert lines[:3] == [
        "| dB ↑ | Geo-EVS (v1) | Geo-EVS |",
        "| --- | --- | --- |",
        "| extrapolation sparse_psnr paper | 21.73 | 23.65 |",
    ]
    assert lines[3].startswith(
        "| extrapolation sparse_psnr | 20.00 [20.00, 20.00] † | 23.67 [20.50, "
    )
    assert "| seeds | 1 | 1 |" in lines
    start = lines.index("| full model minus, dB | Geo-EVS (v1) |")
    assert lines[start + 2 : start + 4] == [
        "| extrapolation sparse_psnr paper | +1.92 |",
        "| extrapolation sparse_psnr | **+0.50 [+0.50, +0.50]** |",
    ]
    assert lines[start + 4] == "| observed psnr |  |"


def test_an_interval_around_zero_is_not_bold(table):
    made = table(*values("v1", [20.0, 20.0]), *values("default", [19.0, 21.5]))
    assert "| extrapolation sparse_psnr | +0.25 [-1.00, +1.50] |" in ablation_markdown(made)


def test_latex_has_rules_between_splits(table):
    latex = ablation_latex(table(*values("v1", [20.0]), *values("default", [21.0])))
    assert latex.count(r"\begin{tabular}{lcc}") == latex.count(r"\begin{tabular}{lc}") == 1
    # Below each header; three between the splits, and one before the number of seeds.
    assert latex.count(r"\midrule") == (1 + 3 + 1) + (1 + 3)
    assert r"extrapolation sparse\_psnr & +1.00 \\" in latex


def test_different_protocols_are_refused(table):
    with pytest.raises(GeoEvsError, match="come from different protocols"):
        table({"variant": "v1"}, {"fingerprint": "g"})


def test_a_variant_that_failed_is_marked_and_met_on_common_views(table):
    failed = {"status": "failed", "value": math.nan}
    made = table(
        *values("default", [21.0, 11.0]),
        *values("v1", [22.0]),
        {"variant": "v1", "frame": 1, **failed},
    )
    variant, full = by_variant(made).values()
    assert (variant["partial"], full["partial"]) == ("extrapolation_sparse_psnr", "")
    assert variant["extrapolation_sparse_psnr_diff"] == -1.0  # though 22 is more than 16
    assert "| extrapolation sparse_psnr | 22.00 † | 16.00 [" in ablation_markdown(made)


def test_seeds_spread_over_the_views_that_all_delivered(table):
    failed = {"status": "failed", "value": math.nan}
    made = table(
        *values("default", [20.0, 10.0], seed=0),
        *values("default", [22.0], seed=1),  # without the hard frame 7 dB above the other's mean
        {"variant": "default", "frame": 1, "seed": 1, **failed},
        *values("v1", [20.0, 10.0]),
    )
    full = by_variant(made)["default"]
    assert full["extrapolation_sparse_psnr_seed_sd"] == pytest.approx(2 / math.sqrt(2))
    assert full["partial"] == "extrapolation_sparse_psnr"
