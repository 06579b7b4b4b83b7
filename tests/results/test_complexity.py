"""The table of chosen and fixed sizes, from rows by hand."""

import math

import pytest

from geoevs.protocol.rows import COST_TYPES, cost_frame
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.results.complexity import complexity_markdown, make_complexity_table

SIZES = {"default": (3000, 10.0), "2k": (2000, 4.0), "8k": (8000, 20.0)}


@pytest.fixture
def costs():
    """Makes cost rows of fits from all cameras that went well."""

    def make(*changes):
        blank = {"string": "", "int64": 0, "float64": math.nan}
        usual = {name: blank[kind] for name, kind in COST_TYPES.items()}
        usual |= {"dataset": "d", "scene": "s", "method": "three-dgs", "sources": ALL_CAMERAS}
        return cost_frame([{**usual, "status": "ok", **change} for change in changes])

    return make


def entrants(scene="s", sizes=SIZES):
    return [
        {"scene": scene, "variant": variant, "primitives": count, "fit_seconds": seconds}
        for variant, (count, seconds) in sizes.items()
    ]


def scored(scene="s", method="three-dgs", **values):
    return [
        {"scene": scene, "method": method, "variant": name.strip("_"), "frame": frame, "value": v}
        for name, pair in values.items()
        for frame, v in enumerate(pair)
    ]


def test_regret_is_against_the_best_fixed_size_of_the_scene(rows, costs):
    scores = rows(
        *scored("s", default=(20.0, 22.0), _2k=(19.0, 19.0), _8k=(21.0, 21.5)),
        *scored("t", default=(18.0, 18.0), _2k=(18.5, 18.5), _8k=(17.0, 17.0)),
        {"method": "three-dgs", "variant": "8k", "split": "observed", "value": 99.0},
        {"method": "three-dgs", "variant": "8k", "stressor": "thinning", "value": 99.0},
        {"method": "reproject", "value": 30.0},
    )
    front = {"variant": "8k", "primitives": 1, "fit_seconds": 1.0, "sources": "front-side"}
    table = make_complexity_table(scores, costs(*entrants("s"), *entrants("t"), front))
    table = table.set_index("scene")
    assert list(table.index) == ["s", "t", "mean"]
    assert table["best_variant"].tolist()[:2] == ["8k", "2k"]
    assert table.loc["s", ["chosen", "psnr", "seconds"]].tolist() == [3000, 21.0, 10.0]
    assert table.loc["s", ["best", "best_psnr", "best_seconds"]].tolist() == [8000, 21.25, 20.0]
    assert table["regret_db"].tolist() == pytest.approx([0.25, 0.5, 0.375])
    assert table["regret_seconds"].tolist() == pytest.approx([-10.0, 6.0, -2.0])
    assert table.loc["mean", "best"] == 5000
    assert table.loc["mean", "note"] == "of 2 scenes"


def test_a_failed_fit_is_said_and_not_averaged(rows, costs):
    scores = rows(
        *scored("s", default=(20.0,), _2k=(21.0,)),
        *scored("t", default=(math.nan,), _2k=(18.5,)),
    )
    failed, *others = entrants("t", {"default": (0, math.nan), "2k": (2000, 4.0)})
    table = make_complexity_table(
        scores, costs(*entrants("s"), {**failed, "status": "failed"}, *others)
    ).set_index("scene")
    assert table.loc["t", "note"] == "no chosen size here"
    assert math.isnan(table.loc["t", "regret_db"])
    assert table.loc["mean", "regret_db"] == 1.0
    assert table.loc["mean", "note"] == "of 1 scenes"


def test_without_fixed_sizes_a_row_says_so(rows, costs):
    table = make_complexity_table(rows(*scored(default=(20.0,))), costs(entrants()[0]))
    assert table["note"].tolist() == ["no fixed size was run"]
    assert "| no fixed size was run |" in complexity_markdown(table)


def test_markdown_shows_sizes_and_signs(rows, costs):
    scores = rows(*scored(default=(20.0,), _2k=(19.0,), _8k=(20.5,)))
    text = complexity_markdown(make_complexity_table(scores, costs(*entrants())))
    line = "| 3DGS | s | 3,000 | 20.00 | 10.0 | 8,000 | 20.50 | 20.0 | +0.50 | -10.0 |  |"
    assert line in text
