"""The table of chosen and fixed sizes, from rows by hand."""

import math
from pathlib import Path

import pytest
import yaml

from geoevs.protocol.rows import COST_TYPES, cost_frame
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.results.chart_pages import page_html, page_png
from geoevs.results.complexity import (
    FIXED,
    complexity_markdown,
    make_complexity_table,
    size_curves,
)
from geoevs.results.complexity_chart import size_chart
from geoevs.results.entrants import Entrants
from geoevs.results.settings import TableSettings

SCALE = Path(__file__).parents[2] / "workflow/scales/complexity.yaml"
SETTINGS = TableSettings([], [], 50, 0.9, "geo-evs")
ENTRANTS = Entrants({})
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
    table = make_complexity_table(scores, costs(*entrants("s"), *entrants("t"), front), ENTRANTS)
    table = table.set_index("scene")
    assert list(table.index) == ["s", "t", "mean"]
    assert table["best_variant"].tolist()[:2] == ["8k", "2k"]
    assert table.loc["s", ["chosen", "psnr", "seconds"]].tolist() == [3000, 21.0, 10.0]
    assert table.loc["s", ["best", "best_psnr", "best_seconds"]].tolist() == [8000, 21.25, 20.0]
    assert table["regret_db"].tolist() == pytest.approx([0.25, 0.5, 0.375])
    assert table["regret_seconds"].tolist() == pytest.approx([-10.0, 6.0, -2.0])
    assert table.loc["mean", "best"] == 5000
    assert table.loc["mean", "note"] == "of 2 scenes"
    assert set(table["timed_on"]) == {""}


def test_sizes_that_other_processors_timed_are_not_compared_silently(rows, costs):
    scores = rows(*scored(default=(20.0,), _2k=(19.0,), _8k=(21.0,)))
    fits = [fit | {"cpu": f"cpu {fit['variant']}"} for fit in entrants()]
    table = make_complexity_table(scores, costs(*fits), ENTRANTS)
    said = "Timed on 3 machines with 3 processors, whose seconds do not compare: "
    assert set(table["timed_on"]) == {f"{said}cpu default, cpu 2k, cpu 8k."}
    assert f"\n**{said}" in complexity_markdown(table)


def test_a_failed_fit_is_said_and_not_averaged(rows, costs):
    scores = rows(
        *scored("s", default=(20.0,), _2k=(21.0,)),
        *scored("t", default=(math.nan,), _2k=(18.5,)),
    )
    failed, *others = entrants("t", {"default": (0, math.nan), "2k": (2000, 4.0)})
    table = make_complexity_table(
        scores, costs(*entrants("s"), {**failed, "status": "failed"}, *others), ENTRANTS
    ).set_index("scene")
    assert table.loc["t", "note"] == "no chosen size here; views are missing of default"
    assert math.isnan(table.loc["t", "regret_db"])
    assert table.loc["mean", "regret_db"] == 1.0
    assert table.loc["mean", "note"] == "of 1 scenes, not all 2"


def test_without_fixed_sizes_a_row_says_so(rows, costs):
    table = make_complexity_table(rows(*scored(default=(20.0,))), costs(entrants()[0]), ENTRANTS)
    assert table["note"].tolist() == ["no fixed size was run"]
    assert "| no fixed size was run |" in complexity_markdown(table)


def test_markdown_shows_sizes_and_signs(rows, costs):
    scores = rows(*scored(default=(20.0,), _2k=(19.0,), _8k=(20.5,)))
    text = complexity_markdown(make_complexity_table(scores, costs(*entrants()), ENTRANTS))
    line = "| 3DGS | s | 3,000 | 20.00 | 10.0 | 8,000 | 20.50 | 20.0 | +0.50 | -10.0 |  |"
    assert line in text


@pytest.fixture
def three_scenes(rows, costs):
    """Rows of scenes that chose 9,000, nothing, and 3,000 primitives, and were run at 2k and 8k."""
    chosen = {"s": (9000, 9.0), "t": None, "u": (3000, 3.0)}
    fits, values = [], []
    for scene, size in chosen.items():
        sizes = {"2k": (2000, 4.0), "8k": (8000, 20.0)} | ({"default": size} if size else {})
        fits += entrants(scene, sizes)
        values += scored(scene, _2k=(19.0, 21.0), _8k=(24.0, 24.0))
        values += scored(scene, default=(22.0, 23.0)) if size else []
    dense = [row | {"metric": "psnr", "value": row["value"] - 1} for row in values]
    others = [
        {"method": "reproject", "value": 30.0},
        {"method": "three-dgs", "variant": "gradient", "scene": "s", "value": 30.0},
        {"method": "three-dgs", "variant": "2k", "scene": "s", "metric": "gms", "value": 1.0},
    ]
    return rows(*values, *dense, *others), costs(*fits, {"method": "reproject"})


def test_scenes_are_sorted_by_the_size_chosen_there(three_scenes):
    table = make_complexity_table(*three_scenes, ENTRANTS)
    assert table["scene"].tolist() == ["u", "s", "t", "mean"]
    curves = size_curves(*three_scenes, SETTINGS, ENTRANTS)
    assert list(dict.fromkeys(curves["scene"])) == ["u", "s", "t"]


def test_a_curve_has_every_size_of_a_scene_with_its_interval(three_scenes):
    curves = size_curves(*three_scenes, SETTINGS, ENTRANTS)
    assert set(curves["metric"]) == {"sparse_psnr", "psnr"}
    mine = curves[(curves["scene"] == "s") & (curves["metric"] == "psnr")]
    assert mine["variant"].tolist() == ["2k", "8k", "default"]
    assert mine["primitives"].tolist() == [2000, 8000, 9000]
    assert mine["mean"].tolist() == [19.0, 23.0, 21.5]
    assert mine[["low", "high"]].to_numpy().tolist() == [[18, 20], [23, 23], [21, 22]]
    assert mine["chosen"].tolist() == [9000] * 3
    assert curves[curves["scene"] == "t"]["chosen"].isna().all()


def test_the_chart_has_a_panel_a_scene_and_needs_no_network(three_scenes):
    page = size_chart(size_curves(*three_scenes, SETTINGS, ENTRANTS))
    (row,) = page.to_dict()["vconcat"]
    titles = [panel["title"] for panel in row["concat"]]
    assert titles == ["u: 3,000 chosen", "s: 9,000 chosen", "t: no chosen size"]
    assert 'src="http' not in page_html(page.to_dict())
    assert page_png(page.to_dict()).startswith(b"\x89PNG")


def test_without_fixed_sizes_the_chart_says_how_to_run_them(rows, costs):
    table = size_curves(rows(*scored(default=(20.0,))), costs(entrants()[0]), SETTINGS, ENTRANTS)
    assert table.empty
    assert "chosen" in table
    page = size_chart(table)
    assert "workflow/scales/complexity.yaml" in page.to_json()
    assert page_png(page.to_dict()).startswith(b"\x89PNG")
    assert SCALE.exists()


def test_the_scale_of_sizes_names_them_so_that_they_count_as_fixed():
    labels = yaml.safe_load(SCALE.read_text())["methods"]
    variants = [label.split(".")[1] for label in labels if "." in label]  # others choose
    assert len(variants) == 6
    assert all(map(FIXED.fullmatch, variants))


def test_a_size_that_lacks_a_view_is_neither_the_best_nor_the_chosen(rows, costs):
    # 8k delivers the easy frame alone, which is worth 10 dB more.
    scores = rows(
        *scored("s", default=(30.0, 20.0), _2k=(29.0, 19.0), _8k=(31.0,)),
        {"scene": "s", "method": "three-dgs", "variant": "8k", "frame": 1, "status": "failed"}
        | {"value": math.nan},
        *scored("t", default=(30.0,), _2k=(29.0, 19.0), _8k=(31.0, 21.0)),
    )
    fits = costs(*entrants("s"), *entrants("t"))
    table = make_complexity_table(scores, fits, ENTRANTS).set_index("scene")
    assert table.loc["s", ["best_variant", "best_psnr", "regret_db"]].tolist() == ["2k", 24.0, -1.0]
    assert table.loc["s", "note"] == "views are missing of 8k"
    assert table.loc["t", "note"] == "no chosen size here; views are missing of default"
    assert math.isnan(table.loc["t", "regret_db"])
    assert table.loc["mean", ["regret_db", "note"]].tolist() == [-1.0, "of 1 scenes, not all 2"]
    curves = size_curves(scores, fits, SETTINGS, ENTRANTS)
    missing = curves.set_index(["scene", "variant"])["lacking"]
    assert missing.to_dict() == {
        **dict.fromkeys([("s", "2k"), ("s", "default"), ("t", "2k"), ("t", "8k")], 0),
        **dict.fromkeys([("s", "8k"), ("t", "default")], 1),
    }
    assert "Hollow: views are missing" in size_chart(curves).to_json()


def test_one_failed_seed_leaves_a_size_out(rows, costs):
    fits = entrants("s", {"default": (3000, 10.0), "2k": (2000, 4.0), "8k": (8000, 20.0)})
    second = {**fits[2], "seed": 1, "status": "failed", "fit_seconds": math.nan}
    lost = {
        "method": "three-dgs",
        "variant": "8k",
        "seed": 1,
        "value": math.nan,
        "status": "failed",
    }
    scores = rows(*scored(default=(20.0,), _2k=(19.0,), _8k=(25.0,)), lost)
    table = make_complexity_table(scores, costs(*fits, second), ENTRANTS)
    assert table["best_variant"].tolist()[0] == "2k"
    assert table["note"].tolist()[0] == "views are missing of 8k"


def test_a_method_whose_fixed_sizes_all_failed_still_has_its_rows(rows, costs):
    fits = [
        fit | ({"status": "failed"} if fit["variant"] != "default" else {}) for fit in entrants()
    ]
    scores = rows(*scored(default=(20.0,), _2k=(math.nan,), _8k=(math.nan,)))
    table = make_complexity_table(scores, costs(*fits), ENTRANTS)
    assert table["note"].tolist() == [
        "no fixed size here; views are missing of 2k, 8k",
        "of 0 scenes, not all 1",
    ]
