"""Cells of tables that are no means of one entrant's score rows, of a run made by hand."""

import math
import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_bytes, write_json, write_text
from geoevs.protocol.depth_scoring import DEPTH_SCORE_TYPES
from geoevs.protocol.rows import COST_TYPES, cost_frame
from geoevs.protocol.set_scoring import set_frame
from geoevs.results.why import explain
from geoevs.results.why_lookup import Cell

BLANK = {"string": "", "int64": 0, "float64": math.nan}
SETTINGS = {"pose_bins": [0, 30], "support_bins": [0, 0.1], "resamples": 50, "confidence": 0.9}
SETTINGS |= {"ablation": "geo-evs"}
ENTRANTS = {
    ("geo-evs", "default"): {0: 20.0, 1: 22.0},
    ("geo-evs", "v1"): {0: 19.0, 1: 20.0},
    ("geo-evs", "mean4"): {0: 21.0},
    ("three-dgs", "default"): {0: 18.0},
    ("three-dgs", "2k"): {0: 17.0},
    ("three-dgs", "8k"): {0: 18.5},
}


@pytest.fixture
def run(rows, tmp_path):
    """Two scenes of two frames; Geo-EVS has two seeds, a variant of it one."""
    scores = rows(
        *[
            {"method": method, "variant": variant, "seed": seed, "value": value + frame}
            | {"scene": scene, "frame": frame, "target": "t"}
            for (method, variant), seeds in ENTRANTS.items()
            for seed, value in seeds.items()
            for scene in ("s", "u")
            for frame in (0, 1)
        ]
    )
    zero = {name: BLANK[kind] for name, kind in COST_TYPES.items()}
    zero |= {"dataset": "d", "sources": "all-cameras", "status": "ok", "peak_memory": 3 * 10**6}
    costs = cost_frame(
        [
            zero
            | {"method": method, "variant": variant, "seed": seed, "scene": scene}
            | {"fit_seconds": 2.0 if scene == "s" else 4.0, "primitives": 100}
            for (method, variant), seeds in ENTRANTS.items()
            for seed in seeds
            for scene in ("s", "u")
        ]
    )
    blank = {name: BLANK[kind] for name, kind in DEPTH_SCORE_TYPES.items()}
    blank |= {"dataset": "d", "model": "net", "scale": "lidar", "camera": "front", "truth": "dense"}
    depths = [
        blank | {"scene": scene, "stage": stage, "metric": metric, "value": value}
        for scene in ("s", "u")
        for stage, value in (("pretrained", 0.5), ("fine-tuned", 0.25))
        for metric in ("abs_rel", "rmse", "delta_1.25")
    ]
    depths = pd.DataFrame(depths).astype(DEPTH_SCORE_TYPES)
    for name, frame in (
        *((layout.SCORES, scores), (layout.COSTS, costs), (layout.DEPTH_SCORES, depths)),
        (layout.SET_SCORES, set_frame([])),
    ):
        write_bytes(tmp_path / name, frame.to_parquet(index=False))
    config = {"tables": SETTINGS, "methods": {"geo-evs.v1": {"training": "v1"}}}
    config["trainings"] = {"geo-evs": {"steps": 9, "variants": {"v1": {"masks": "none"}}}}
    who = {
        "name": "A name",
        "paradigm": "a paradigm",
        "extra_prior": "all",
        "needs": "",
        "sees": "views",
    }
    names = ("geo-evs.v1", "three-dgs")
    write_json(tmp_path / layout.ENTRANTS, dict.fromkeys(names, who))
    write_json(tmp_path / layout.MANIFEST, {"commit": "abc", "seed": 0, "config": config})
    return tmp_path


def told(lines, name):
    return [line.removeprefix(name).strip() for line in lines if line.startswith(name)]


def forced(lines):
    """The rules that the rerun forces, and the files that it makes."""
    command = shlex.split(told(lines, "rerun")[0])
    command = command[: command.index("&&")]
    middle = command.index("--")
    return command[command.index("--forcerun") + 1 : middle], command[middle + 1 :]


def behind(lines, run):
    """The rows that every query finds in the file that it names."""
    places = [k for k, line in enumerate(lines) if line.startswith("rows")]
    for place in places:
        count, path = re.match(r"rows +(\d+) in (\S+), as", lines[place]).groups()
        found = pd.read_parquet(run / path).query(lines[place + 1].strip())
        assert len(found) == int(count)
        yield found


def number(lines):
    return float(re.search(r" = (\S+) ", lines[0])[1])


def test_each_variant_has_its_own_seeds(run):
    lines = explain(Cell("extrapolation", "geo-evs.mean4", "sparse_psnr"), run)
    _, files = forced(lines)
    names = [f"{run}/parts/d/{scene}/geo-evs.mean4.scores.parquet" for scene in ("s", "u")]
    assert files == names
    _, files = forced(explain(Cell("extrapolation", "geo-evs.v1", "sparse_psnr"), run))
    assert [file.split("/")[-1] for file in files[:2]] == [
        *("geo-evs.v1.scores.parquet", "geo-evs.v1.seed1.scores.parquet")
    ]


def test_an_ablation_mean_leads_to_its_rows(run):
    lines = explain(Cell("ablation", "geo-evs.v1", "extrapolation_sparse_psnr"), run)
    (rows,) = behind(lines, run)
    assert number(lines) == rows["value"].mean() == 20.0
    assert len(told(lines, "lowest")) == 3
    assert f"{run}/renders/d/s/geo-evs.v1/t/000000.png" in told(lines, "lowest")[0]
    assert any("'masks': 'none'" in line for line in lines)
    assert told(lines, "entrant") == ["Geo-EVS (v1); paradigm a paradigm; extra prior all"]
    rules, files = forced(lines)
    assert rules == ["fit", "render", "score"]
    assert len(files) == 4  # two scenes, two seeds
    assert lines[-1].endswith(f"{run}/tables/ablation.csv")


def test_an_ablation_difference_needs_the_full_model_too(run):
    lines = explain(Cell("ablation", "geo-evs.v1", "extrapolation_sparse_psnr_diff"), run)
    (rows,) = behind(lines, run)
    means = rows.groupby("variant")["value"].mean()
    assert number(lines) == means["default"] - means["v1"] == 1.5
    assert all("/geo-evs.v1" in line for line in told(lines, "lowest"))
    assert len(forced(lines)[1]) == 8


def test_depth_leads_to_photos_and_its_own_rule(run):
    lines = explain(Cell("geometry", "net", "abs_rel_change", "fine-tuned/lidar"), run)
    assert number(lines) == -0.25
    (rows,) = behind(lines, run)
    assert rows["stage"].value_counts().to_dict() == {"pretrained": 2, "fine-tuned": 2}
    assert told(lines, "lowest")[0] == f"0.25: {run}/scenes/d/s/images/front/000000.png"
    rules, files = forced(lines)
    assert rules == ["depth_scores_of_scene"]
    assert files == [f"{run}/parts/d/{scene}/depth-scores.parquet" for scene in ("s", "u")]


def test_a_cost_is_the_mean_of_its_fits(run):
    lines = explain(Cell("costs", "three-dgs", "fit_seconds"), run)
    (rows,) = behind(lines, run)
    assert number(lines) == rows["fit_seconds"].mean() == 3.0
    assert told(lines, "fit") == ["2: s, seed 0", "4: u, seed 0"]
    assert told(lines, "entrant") == ["3DGS; paradigm a paradigm; extra prior all"]
    assert len(forced(lines)[1]) == 2
    lines = explain(Cell("costs", "three-dgs", "peak_memory_mb"), run)
    assert number(lines) == 3.0
    assert "column peak_memory, in millions of bytes" in told(lines, "note")[0]


@pytest.mark.parametrize(("scene", "scenes", "seconds"), [("u", 1, 4), ("", 2, 3)])
def test_a_regret_needs_every_size(run, scene, scenes, seconds):
    lines = explain(Cell("complexity", "three-dgs", "regret_db", scene), run)
    assert number(lines) == 0.5
    assert told(lines, "entrant") == ["3DGS; paradigm a paradigm; extra prior all"]
    scores, fits = behind(lines, run)
    assert set(scores["variant"]) == set(fits["variant"]) == {"default", "2k", "8k"}
    assert len(fits) == len(forced(lines)[1]) == 3 * scenes
    assert number(explain(Cell("complexity", "three-dgs", "seconds", scene), run)) == seconds


def test_a_rank_agreement_needs_every_ranked_method(run):
    lines = explain(Cell("rank_agreement", "extrapolation", "sparse_psnr"), run)
    (rows,) = behind(lines, run)
    assert number(lines) == 1.0
    assert set(rows["method"]) == {"geo-evs", "three-dgs"}
    assert told(lines, "here") == ["Geo-EVS > 3DGS"]
    assert "no one picture gives it" in told(lines, "note")[0]
    assert len(forced(lines)[1]) == 6  # of two scenes: two seeds and one


@pytest.mark.parametrize(
    ("cell", "sentence"),
    [
        (Cell("ablaton", "geo-evs", "psnr"), "no table 'ablaton' here; did you mean 'ablation'"),
        (Cell("ablation", "geo-evs.v9", "x"), "no entrant 'geo-evs.v9' here; did you mean"),
        (Cell("ablation", "geo-evs", "observed_pnsr"), "did you mean 'observed_psnr'"),
        (Cell("geometry", "net", "rmse"), "no bin '' here; one of: fine-tuned/lidar, pretrained"),
        (Cell("costs", "three-dgs", "fit"), "no column 'fit' here"),
        (Cell("complexity", "geo-evs", "psnr"), "no entrant 'geo-evs' here; one of: three-dgs"),
        (Cell("rank_agreement", "observed", "psnr"), "no table of the paper 'observed' here"),
        (Cell("rank_agreement", "extrapolation", "gms"), "no metric 'gms' here"),
    ],
)
def test_a_cell_that_is_none_is_named(run, cell, sentence):
    with pytest.raises(GeoEvsError, match=re.escape(sentence)):
        explain(cell, run)


def test_logs_are_of_the_fits_behind_the_views_and_costs_shown(run):
    scores = pd.read_parquet(run / layout.SCORES)
    scores.loc[scores["scene"] == "u", "value"] -= 9  # the lowest are of u, the highest of s
    write_bytes(run / layout.SCORES, scores.to_parquet(index=False))
    cell = Cell("extrapolation", "geo-evs", "sparse_psnr")
    logs = [
        f"{run}/logs/{step}/d/{scene}/{label}.log"
        for scene, labels in (("u", ("geo-evs", "geo-evs.seed1")), ("s", ("geo-evs.seed1",)))
        for label in labels
        for step in ("fit", "render")
    ]
    for path in (*logs, f"{run}/logs/fit/d/v/geo-evs.log"):
        write_text(Path(path), "fine")
    assert told(explain(cell, run), "log")[:4] == logs[:4]
    assert set(told(explain(cell, run), "log")) == set(logs)
    costs = explain(Cell("costs", "geo-evs", "fit_seconds"), run)
    assert {line.split("/")[-2] for line in told(costs, "log")} == {"s", "u"}


@pytest.mark.parametrize(
    ("table", "source"),
    [
        ("stability", "stability/scores.parquet"),
        ("audit", "audit/rows.parquet"),
        ("agreement", "audit/rows.parquet"),
    ],
)
def test_suites_are_no_tables(run, table, source):
    write_text(run / "audit/agreement.csv", "metric\n")
    sentence = f"why` answers for {run}/tables only; .* are made from {run / source} and lie in"
    with pytest.raises(GeoEvsError, match=sentence):
        explain(Cell(table, "geo-evs", "psnr"), run)


def test_an_empty_table_says_so(run):
    costs = pd.read_parquet(run / layout.COSTS)
    scores = pd.read_parquet(run / layout.SCORES)
    for name, frame in ((layout.COSTS, costs), (layout.SCORES, scores)):
        kept = frame[~frame["variant"].isin(["2k", "8k"])]
        write_bytes(run / name, kept.to_parquet(index=False))
    remedy = r"complexity is empty for d; add fixed sizes with .*/complexity\.yaml -- tables"
    with pytest.raises(GeoEvsError, match=remedy):
        explain(Cell("complexity", "three-dgs", "psnr"), run)
