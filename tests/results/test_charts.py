import json

import numpy as np
import pandas as pd
import pytest

from geoevs.results.chart_pages import (
    HEIGHT,
    LABEL_SIZE,
    WIDTH,
    _label_places,
    _laid_out,
    _length,
    _metric_range,
    draw_page,
    page_html,
    page_png,
)
from geoevs.results.charts import COSTS, speed_accuracy
from geoevs.results.entrants import Entrants, Info
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import TABLES

SETTINGS = TableSettings(
    [0, 10, 30], [0, 0.02, 0.1], resamples=100, confidence=0.9, ablation="geo-evs"
)
WHO = Entrants({name: Info(name, "control") for name in ("mean-colour", "reproject")})
# Seconds a view on two scenes, and sparse PSNR of two frames.
ENTRANTS = {
    ("mean-colour", "default"): ((0.001, 0.001), (10.0, 12.0)),
    ("reproject", "default"): ((0.008, 0.012), (20.0, 24.0)),
    ("geo-evs", "default"): ((0.100, 0.100), (21.0, 22.0)),  # slower and worse than reproject
    ("geo-evs", "t1"): ((0.020, 0.020), (25.0, 25.0)),
    ("reference", "default"): ((0.001, 0.001), (60.0, 60.0)),
}


@pytest.fixture
def rows():
    scores, costs = [], []
    for (method, variant), (seconds, values) in ENTRANTS.items():
        entrant = {"dataset": "d", "method": method, "variant": variant}
        for frame, value in enumerate(values):
            score = {"scene": "s", "frame": frame, "target": "t", "seed": 0, "level": np.nan}
            score |= {"stressor": "", "pose_offset": 5.0 + 10 * frame, "support_ratio": 0.01}
            kept = {**entrant, **score, "metric": "sparse_psnr", "value": value, "status": "ok"}
            scores += [{**kept, "split": split} for split in ("extrapolation", "pose-sweep")]
            scores += [{**kept, "split": "observed", "metric": "psnr", "value": np.inf}]
            scores += [{**kept, "split": "interpolation", "metric": "psnr"}]
            scores += [{**kept, "split": "extrapolation", "stressor": "thinning", "value": 99.0}]
        for scene, second in zip("st", seconds, strict=True):
            cost = {
                "scene": scene,
                "seed": 0,
                "sources": "all-cameras",
                "status": "ok",
                "fit_seconds": 0.0,
                "bytes": 0,
            }
            cost |= {"peak_memory": 2e8, "gpu_memory": 0}
            cost |= {"load_seconds": 3.0, "warm_up_seconds": 1.0, "host": "a", "cpu": "EPYC"}
            spent = {**entrant, **cost, "render_seconds": second}
            costs += [spent, {**spent, "sources": "front-side", "render_seconds": 2 * second}]
    table = pd.DataFrame(scores)
    return table, pd.DataFrame(costs)


def charted(rows, name="extrapolation"):
    return speed_accuracy(name, *rows, SETTINGS, WHO)


def test_the_frontier_holds_what_nothing_beats_in_both(rows):
    table = charted(rows).set_index(["method", "variant"])
    assert "reference" not in table.index.get_level_values(0)
    assert table["mean"].to_dict() == {
        ("mean-colour", "default"): 11.0,
        ("reproject", "default"): 22.0,
        ("geo-evs", "default"): 21.5,
        ("geo-evs", "t1"): 25.0,
    }
    assert table["render_seconds_frontier"].to_dict() == {
        ("mean-colour", "default"): True,
        ("reproject", "default"): True,
        ("geo-evs", "default"): False,
        ("geo-evs", "t1"): True,
    }
    # All take the same memory, so that the best one alone is worth it.
    assert table.index[table["memory_mb_frontier"]].tolist() == [("geo-evs", "t1")]
    assert table["control"].tolist() == [True, True, False, False]


def test_a_chart_says_which_machines_its_seconds_are_of(rows):
    scores, costs = rows
    assert set(charted(rows)["timed_on"]) == {""}
    other = costs["method"] == "reproject"
    table = charted((scores, costs.assign(cpu=costs["cpu"].mask(other, "Xeon"))))
    said = (
        "Timed on 2 machines with 2 processors, whose seconds do not compare: EPYC (a), Xeon (a)."
    )
    assert set(table["timed_on"]) == {said}
    (panel, *_) = draw_page("extrapolation", table, SETTINGS).vconcat[0].hconcat
    assert " ".join(panel.title.subtitle).endswith(said)


def test_where_less_is_better_the_frontier_goes_down(rows):
    scores, costs = rows
    table = charted((scores.assign(metric="lpips"), costs)).set_index(["method", "variant"])
    assert table.index[table["render_seconds_frontier"]].tolist() == [("mean-colour", "default")]


# Of the entrants above: what a distance of sets says of each.
DISTANCES = {"mean-colour": 40.0, "reproject": 0.5, "geo-evs": 0.1, "reference": 0.0}


def distances(metric, values=DISTANCES, **more):
    return [
        {"dataset": "d", "split": "extrapolation", "method": method, "variant": "default"}
        | {"seed": seed, "metric": metric, "value": value + shift, "low": value, "high": value + 2}
        | {"views": 4, "failed": 0}
        | more
        for method, value in values.items()
        for seed, shift in ((0, -0.05), (1, 0.05))
    ]


def with_sets(rows, *sets, name="extrapolation"):
    return speed_accuracy(
        name, *rows, SETTINGS, WHO, pd.DataFrame([row for some in sets for row in some])
    )


def test_distances_of_sets_are_means_over_seeds_and_fewer_is_better(rows):
    other = distances("texture_energy", split="observed", value=9.0)
    table = with_sets(rows, distances("texture_energy"), other)
    table = table[table["metric"] == "texture_energy"].set_index("method")
    assert table["mean"].to_dict() == pytest.approx(
        {"mean-colour": 40.0, "reproject": 0.5, "geo-evs": 0.1}
    )
    assert table.loc["reproject", ["low", "high", "n"]].tolist() == [0.5, 2.5, 8]
    # From fast to slow: 40, 0.5 and 0.1. All take the same memory.
    assert table["render_seconds_frontier"].all()
    assert table.index[table["memory_mb_frontier"]].tolist() == ["geo-evs"]
    again = with_sets(rows, distances("texture_energy", {**DISTANCES, "geo-evs": 0.6}))
    again = again[again["metric"] == "texture_energy"].set_index("method")
    assert again["render_seconds_frontier"].to_list() == [True, True, False]


def test_the_weight_free_distance_stands_in_where_no_other_is_measured(rows):
    missing = distances("fid", value=np.nan, low=np.nan, high=np.nan)
    assert "fid" not in set(with_sets(rows, missing, distances("texture_energy"))["metric"])
    fid = distances("fid", low=np.nan, high=np.nan)
    metrics = with_sets(rows, fid, distances("texture_energy"))["metric"]
    assert set(metrics) == {"sparse_psnr", "fid"}
    sets = pd.DataFrame(distances("texture_energy"))
    assert set(speed_accuracy("pose_offset", *rows, SETTINGS, WHO, sets)["metric"]) == {
        "sparse_psnr"
    }
    assert "texture_energy" not in set(charted(rows)["metric"])


@pytest.mark.parametrize("metric", ["fid", "texture_energy", "lpips", "psnr"])
def test_up_is_better_on_every_axis(rows, metric):
    worse, better = (0.2, 0.1) if metric != "psnr" else (20.0, 30.0)
    points = pd.DataFrame({"low": [worse, better], "high": [worse, better]})
    bottom, top = _metric_range(points, metric, 0.15)
    assert (worse - bottom) * (top - better) > 0  # room at both ends
    assert (top > bottom) == (better > worse)


def test_a_page_shows_distances_of_sets_on_an_axis_of_decades(rows):
    table = with_sets(rows, distances("texture_energy", {**DISTANCES, "geo-evs": -0.01}))
    page = draw_page("extrapolation", table, SETTINGS)
    assert "Fit seconds are without the training of networks" in page.title
    text = page.to_json()
    assert '"symlog"' in text
    assert "texture_energy ↓ (reversed: up is better)" in json.dumps(
        json.loads(text), ensure_ascii=False
    )
    assert page_png(page.to_dict()).startswith(b"\x89PNG")


def test_costs_have_intervals_and_logarithms(rows):
    table = charted(rows).set_index(["method", "variant"])
    row = table.loc[("reproject", "default")]
    assert row["render_seconds"] == pytest.approx(0.010)
    assert row["render_seconds_low"] == pytest.approx(0.008)
    assert row["render_seconds_high"] == pytest.approx(0.012)
    assert (row["fit_seconds"], row["size_mb"], row["memory_mb"]) == (1e-3, 1e-4, 200)
    assert row["ready_seconds"] == 4.0  # 3 of loading and 1 of the first view
    assert set(COSTS) <= set(table.columns)


def test_costs_are_of_the_sources_that_the_views_are_made_from(rows):
    table = charted(rows, "interpolation").set_index(["method", "variant"])
    assert table.loc[("geo-evs", "t1"), "render_seconds"] == pytest.approx(0.040)


def test_every_bin_has_a_frontier_of_its_own(rows):
    table = charted(rows, "pose_offset").set_index(["bin", "method", "variant"]).sort_index()
    assert table.loc[("0-10", "geo-evs", "default"), "mean"] == 21.0
    assert table.loc[("10-30", "geo-evs", "default"), "mean"] == 22.0
    assert table.loc["0-10", "render_seconds_frontier"].sum() == 3


def test_memory_is_what_the_larger_of_main_and_gpu_memory_took(rows):
    scores, costs = rows
    costs.loc[costs["method"] == "geo-evs", "gpu_memory"] = 5e8
    table = charted((scores, costs)).set_index(["method", "variant"])
    assert table.loc[("geo-evs", "t1"), "memory_mb"] == 500
    assert table.loc[("reproject", "default"), "memory_mb"] == 200
    # What was the best at no more memory now takes more than reproject.
    frontier = table.index[table["memory_mb_frontier"]].tolist()
    assert frontier == [("reproject", "default"), ("geo-evs", "t1")]


def test_entrants_that_failed_are_no_points(rows):
    scores, costs = rows
    scores.loc[scores["method"] == "reproject", "value"] = np.nan
    assert "reproject" not in set(charted((scores, costs))["method"])


def failing(scores, method, frame=1):
    """The score rows with one frame that a method failed on."""
    lost = (scores["method"] == method) & (scores["frame"] == frame)
    return scores.assign(
        value=scores["value"].mask(lost), status=scores["status"].mask(lost, "failed")
    )


def test_who_lacks_views_is_on_no_frontier_and_pushes_nobody_off_it(rows):
    scores, costs = rows
    hard = scores["frame"] == 1
    scores.loc[hard, "value"] -= 20  # so that the mean without this frame is the highest
    table = charted((failing(scores, "mean-colour"), costs)).set_index(["method", "variant"])
    assert table["lacking"].to_dict() == dict.fromkeys(table.index, 0) | {
        ("mean-colour", "default"): 1
    }
    frontier = table.index[table["render_seconds_frontier"]].tolist()
    assert frontier == [("reproject", "default"), ("geo-evs", "t1")]


def test_costs_of_fewer_fits_are_no_frontier_either(rows):
    scores, costs = rows
    # Cheap where it could fit, and all views of this bin are of that scene.
    costs.loc[(costs["method"] == "mean-colour") & (costs["scene"] == "t"), "status"] = "failed"
    table = charted((scores, costs), "pose_offset").set_index(["bin", "method", "variant"])
    row = table.loc[("0-10", "mean-colour", "default")]
    assert (row["lacking"], row["lacking_fits"], row["render_seconds_frontier"]) == (
        0,
        2 - 1,
        False,
    )


def test_who_is_not_ranked_is_drawn_hollow_and_named(rows):
    scores, costs = rows
    for name in ("extrapolation", "pose_offset"):
        whole = draw_page(name, charted(rows, name), SETTINGS).to_json()
        assert "Hollow" not in whole
        assert '"filled": false' not in whole
    table = charted((failing(scores, "reproject"), costs))
    page = draw_page("extrapolation", table, SETTINGS)
    (panel, *_) = page.vconcat[0].hconcat
    assert panel.title.subtitle == [
        "Hollow, not ranked, as views or fits are missing:",
        "reproject",
    ]
    assert '"filled": false' in page.to_json()
    assert page_png(page.to_dict()).startswith(b"\x89PNG")


def test_distances_over_fewer_images_are_not_ranked(rows):
    sets = distances("texture_energy")
    sets[5] |= {"value": np.nan, "views": 0, "failed": 4}
    table = with_sets(rows, sets)
    table = table[table["metric"] == "texture_energy"].set_index("method")
    assert table["lacking"].tolist() == [0, 0, 4]
    assert table["render_seconds_frontier"].tolist() == [True, True, False]


def test_views_in_no_bin_are_said_above_the_curve(rows):
    scores, costs = rows
    scores["pose_offset"] += 16.0
    table = charted((scores, costs), "pose_offset")
    assert set(table["outside"]) == {"1 of 2 views lie in no bin: 1 above 30"}
    (curve, *_) = draw_page("pose_offset", table, SETTINGS).vconcat[0].hconcat
    assert curve.title.subtitle == ["1 of 2 views lie in no bin: 1 above 30"]


def observed(rows, exact):
    """The rows with finite observed views, but for those of some methods."""
    scores, costs = rows
    changed = (scores["split"] == "observed") & ~scores["method"].isin(exact)
    scores.loc[changed, "value"] = scores.loc[changed, "frame"] + 20.0
    return scores, costs


def test_exact_copies_beat_what_costs_more_but_are_no_points(rows):
    table = charted(observed(rows, ["reproject"]), "observed")
    frontier = table[table["render_seconds_frontier"]].set_index("method")["mean"]
    assert frontier.to_dict() == {"mean-colour": 20.5, "reproject": np.inf}
    (panel, *_) = panels = draw_page("observed", table, SETTINGS).vconcat[0].hconcat
    assert panel.title.subtitle == ["Beyond the axis (∞, some views are exact): reproject"]
    drawn = panels[1].to_dict()  # render seconds
    line, bars = drawn["layer"][0], drawn["layer"][1]
    names = {point["name"] for point in drawn["datasets"][bars["data"]["name"]]}
    assert names == {"mean-colour", "Geo-EVS", "Geo-EVS (t1)"}
    edge = line["encoding"]["y"]["scale"]["domain"][1]
    assert [step["y"] for step in drawn["datasets"][line["data"]["name"]]] == [20.5, edge]


def test_of_exact_copies_alone_the_cheapest_is_worth_it(rows):
    table = charted(rows, "observed")
    assert table.loc[table["render_seconds_frontier"], "method"].tolist() == ["mean-colour"]
    assert page_png(draw_page("observed", table, SETTINGS).to_dict()).startswith(b"\x89PNG")


def crowded(count):
    """Points of about the same cost and quality, all of them on the frontier."""
    numbers = np.arange(count)
    near = {"x": 0.1 + 0.001 * numbers, "y": 20 + 0.01 * numbers, "n": 9, "frontier": True}
    data = pd.DataFrame({"name": [f"a rather long name {k}" for k in numbers], **near})
    return data.assign(low=data.y, high=data.y, x_low=data.x, x_high=data.x)


@pytest.mark.parametrize("metric", ["psnr", "lpips"])
def test_names_of_the_frontier_never_overlap_and_stay_in_the_panel(metric):
    data = crowded(12)
    if metric == "lpips":  # the same upside down, where less is better
        data[["y", "low", "high"]] *= -1
    data, across, up = _laid_out(data, metric)
    places = _label_places(data, across, up)
    assert np.diff(places["bottom"].sort_values()).min() >= LABEL_SIZE
    assert places["bottom"].max() + LABEL_SIZE <= HEIGHT
    assert (places["right"] - data["name"].map(_length)).min() >= 0
    assert places["right"].max() <= WIDTH
    assert ((data["label_y"] - data["y"]) * (up[1] - up[0]) > 0).all()


@pytest.mark.parametrize("name", ["extrapolation", "pose_offset"])
def test_the_page_needs_no_network(rows, name):
    page = draw_page(name, charted(rows, name), SETTINGS)
    text = page_html(page.to_dict())
    assert 'src="http' not in text
    assert "Geo-EVS (t1)" in text
    assert page_png(page.to_dict()).startswith(b"\x89PNG")


@pytest.mark.parametrize("name", TABLES)
def test_a_table_without_any_value_still_has_a_page(rows, name):
    scores, costs = rows
    empty = charted((scores[:0], costs), name)
    assert json.loads(draw_page(name, empty, SETTINGS).to_json())["vconcat"] == []
