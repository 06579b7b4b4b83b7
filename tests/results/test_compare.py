"""Two entrants on the same views: pairs, seeds, levels, and what a terminal shows."""

import math
from dataclasses import asdict

import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_bytes, write_json
from geoevs.results.compare import COLUMNS, compare_entrants, comparison_text
from geoevs.results.settings import TableSettings
from geoevs.results.views import paired_of, rows_of

SETTINGS = TableSettings(
    [0, 15, 30], [0, 0.05, 0.1], resamples=200, confidence=0.95, ablation="geo-evs"
)


def series(method, numbers, **more):
    """Rows of one entrant, one a frame."""
    return [{"method": method, "frame": k, "value": v, **more} for k, v in enumerate(numbers)]


@pytest.fixture
def gain(rows):
    """`paired_of` of `mine` and `other` among rows by hand."""

    def make(*changes):
        table = rows(*changes)
        both = (rows_of(table, name, "default") for name in ("mine", "other"))
        return paired_of(*both, SETTINGS)

    return make


@pytest.fixture
def folder(rows, tmp_path):
    """Writes a run of rows by hand."""

    def make(*changes):
        write_bytes(tmp_path / layout.SCORES, rows(*changes).to_parquet(index=False))
        config = {"tables": asdict(SETTINGS), "methods": {}}
        write_json(tmp_path / layout.MANIFEST, {"config": config})
        return tmp_path

    return make


def test_a_difference_is_sure_though_intervals_overlap(folder):
    run = folder(*series("mine", [20.5, 30.5, 40.5]), *series("other", [20.0, 30.0, 40.0]))
    (row,) = compare_entrants("extrapolation", "mine", "other", run).to_dict("records")
    assert (row["metric"], row["pairs"]) == ("sparse_psnr", 3)
    assert (row["first"], row["second"]) == (30.5, 30.0)
    assert (row["difference"], row["low"], row["high"]) == (0.5, 0.5, 0.5)


def test_what_has_one_seed_meets_every_seed_of_the_other(gain):
    trained = [*series("mine", [3.0], seed=4), *series("mine", [7.0], seed=5)]
    found = gain(*trained, *series("other", [1.0], seed=0))
    assert (found.mean, found.pairs) == (4.0, 2)
    assert (found.low, found.high) == (2.0, 6.0)  # seeds are redrawn
    turned = gain(*series("mine", [1.0]), *({**row, "method": "other"} for row in trained))
    assert (turned.mean, turned.low, turned.high) == (-4.0, -6.0, -2.0)


def test_single_seeds_meet_whatever_they_are(gain):
    found = gain(*series("mine", [3.0], seed=2), *series("other", [1.0], seed=1))
    assert (found.mean, found.pairs) == (2.0, 1)


def test_seeds_that_both_have_are_pairs(gain):
    found = gain(
        *series("mine", [3.0], seed=0),
        *series("mine", [9.0], seed=1),
        *series("other", [2.0], seed=0),
        *series("other", [5.0], seed=1),
        *series("other", [50.0], seed=2),
    )
    assert (found.mean, found.pairs) == (2.5, 2)


def test_views_meet_at_the_same_level_of_stress(gain):
    thinned = {"stressor": "thinning", "level": 0.5}
    found = gain(
        *series("mine", [3.0]),
        *series("mine", [10.0], **thinned),
        *series("other", [2.0]),
        *series("other", [6.0], **thinned),
    )
    assert (found.mean, found.pairs) == (2.5, 2)


def test_bins_and_metrics_without_a_pair_are_left_out(folder):
    thin, thick = {"support_ratio": 0.01}, {"support_ratio": 0.07}
    run = folder(
        *series("mine", [3.0, math.nan], **thin),
        *series("mine", [4.0], metric="sparse_ssim", **thin),
        *series("mine", [5.0], **thick),
        *series("other", [1.0, 1.0], **thin),
    )
    found = compare_entrants("sparsity", "mine", "other", run)
    assert found[["bin", "metric", "pairs"]].values.tolist() == [["0-0.05", "sparse_psnr", 1]]


def test_the_text_has_signs_intervals_and_no_empty_column():
    table = pd.DataFrame(
        [
            ("", "sparse_psnr", 26.0, 25.5, 0.5, 0.25, 0.75, 8, 0),
            ("", "mae", 1, 2, -1, *[math.nan] * 2, 1, 0),
        ],
        columns=COLUMNS,
    )
    header, first, second = comparison_text(table, "mine", "other.variant").splitlines()
    assert header.split() == ["metric", "mine", "other.variant", "difference", "pairs"]
    assert first.split() == [
        "sparse_psnr",
        "↑",
        "26.00",
        "25.50",
        "+0.50",
        "[+0.25,",
        "+0.75]",
        "8",
    ]
    assert second.split() == ["mae", "↓", "1.000", "2.000", "-1.000", "1"]
    assert len(header) == len(first) == len(second)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("extrapolatoin", "mine", "other"), "no table 'extrapolatoin' here; did you mean 'extrap"),
        (("extrapolation", "mine", "otter"), "no entrant 'otter' here; did you mean 'other'"),
        (
            ("observed", "mine", "other"),
            "no view of table observed has a finite value of both mine",
        ),
    ],
)
def test_what_cannot_be_compared_is_said(folder, names, words):
    run = folder(*series("mine", [3.0]), *series("other", [1.0]))
    with pytest.raises(GeoEvsError, match=words):
        compare_entrants(*names, run)


def test_another_data_set_is_named(folder):
    run = folder(
        *series("mine", [3.0]),
        *series("mine", [9.0], dataset="e"),
        *series("other", [1.0]),
        *series("other", [2.0], dataset="e"),
    )
    assert compare_entrants("extrapolation", "mine", "other", run)["difference"].tolist() == [2.0]
    found = compare_entrants("extrapolation", "mine", "other", run, "e")
    assert found["difference"].tolist() == [7.0]
    with pytest.raises(GeoEvsError, match="no data set 'f' here"):
        compare_entrants("extrapolation", "mine", "other", run, "f")


def test_means_are_of_the_pairs_and_what_is_left_out_is_counted(folder):
    # 1 dB worse on each view that both have; its fit of the hard scene failed.
    run = folder(
        *series("mine", [25.0, 26.0]),
        *series("mine", [math.nan] * 2, scene="hard", status="failed"),
        *series("other", [26.0, 27.0]),
        *series("other", [10.0, 11.0], scene="hard"),
    )
    table = compare_entrants("extrapolation", "mine", "other", run)
    (row,) = table.to_dict("records")
    assert (row["first"], row["second"], row["difference"]) == (25.5, 26.5, -1.0)
    assert (row["pairs"], row["left_out"]) == (2, 2)
    header, line, *note = comparison_text(table, "mine", "other").splitlines()
    assert header.split()[-2:] == ["left", "out"]
    assert line.split()[-2:] == ["2", "2"]
    assert " ".join(note).startswith("All numbers are of the pairs.")


def test_one_seed_that_failed_leaves_the_pairs_of_the_others(folder):
    run = folder(
        *series("mine", [3.0, 5.0], seed=0),
        *series("mine", [7.0], seed=1),
        {"method": "mine", "seed": 1, "frame": 1, "value": math.nan, "status": "failed"},
        *series("other", [1.0, 1.0]),
    )
    (row,) = compare_entrants("extrapolation", "mine", "other", run).to_dict("records")
    assert (row["first"], row["second"], row["difference"]) == (5.0, 1.0, 4.0)
    assert (row["pairs"], row["left_out"]) == (3, 1)


def test_targets_of_a_frame_meet_themselves_alone(gain):
    mine = [{"method": "mine", "target": name, "value": 3.0} for name in "lr"]
    other = [
        {"method": "other", "target": name, "value": v} for name, v in (("l", 1.0), ("r", 9.0))
    ]
    assert gain(*mine, *other).pairs == 2
    one = gain(*mine[:1], *other)
    assert (one.mean, one.pairs, one.left_out) == (2.0, 1, 1)
