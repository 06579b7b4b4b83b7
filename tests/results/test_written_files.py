"""What the workflow's commands leave: every file of a table, a chart or a suite's page."""

from pathlib import Path

import pandas as pd
import pytest

from geoevs.protocol.depth_scoring import DEPTH_SCORE_TYPES
from geoevs.protocol.rows import COST_TYPES, cost_frame
from geoevs.protocol.set_scoring import SET_TYPES, set_frame
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.results.ablation import (
    ablation_latex,
    ablation_markdown,
    make_ablation_table,
    write_ablation_table,
)
from geoevs.results.chart_pages import write_chart
from geoevs.results.charts import speed_accuracy
from geoevs.results.complexity import (
    complexity_markdown,
    make_complexity_table,
    size_curves,
    write_complexity_table,
)
from geoevs.results.complexity_chart import write_size_chart
from geoevs.results.costs import cost_markdown, make_cost_table, write_cost_table
from geoevs.results.entrants import Entrants, Info
from geoevs.results.formats import to_latex, to_markdown, write_table
from geoevs.results.geometry_table import (
    geometry_latex,
    geometry_markdown,
    make_geometry_table,
    write_geometry_table,
)
from geoevs.results.rank_agreement import (
    make_rank_agreement,
    rank_agreement_markdown,
    write_rank_agreement,
)
from geoevs.results.settings import TableSettings
from geoevs.results.stability import breaking_points, make_stability_table, seed_spread
from geoevs.results.stability_chart import curves, write_stability_chart
from geoevs.results.stability_page import stability_markdown, write_stability
from geoevs.results.table_specs import table_spec
from geoevs.results.tables import make_table

SETTINGS = TableSettings([0, 10], [0, 0.1], resamples=100, confidence=0.9, ablation="geo-evs")
METHODS = ("mean-colour", "three-dgs", "geo-evs")
ENTRANTS = Entrants({name: Info(name.title(), "a paradigm", "none") for name in METHODS})


@pytest.fixture
def scores(rows):
    return rows(
        *[
            {"method": method, "frame": frame, "value": 10.0 + number + frame}
            for number, method in enumerate(METHODS)
            for frame in range(2)
        ]
    )


@pytest.fixture
def costs():
    blank = {"string": "", "int64": 1, "float64": 0.5}
    usual = {name: blank[kind] for name, kind in COST_TYPES.items()}
    fit = {"dataset": "d", "scene": "s", "variant": "default", "sources": ALL_CAMERAS}
    return cost_frame([{**usual, **fit, "method": m, "status": "ok"} for m in METHODS])


def files(stem: Path) -> dict[str, str]:
    """Texts by suffix; of pictures and pages, that they are there."""
    return {
        path.suffix: "" if path.suffix in (".png", ".html") else path.read_text()
        for path in stem.parent.glob(f"{stem.name}.*")
    }


def test_a_table_is_csv_markdown_and_latex(scores, tmp_path):
    write_table(tmp_path / "a", "extrapolation", scores, SETTINGS, ENTRANTS)
    table, spec = (
        make_table("extrapolation", scores, SETTINGS, ENTRANTS),
        table_spec("extrapolation"),
    )
    assert files(tmp_path / "a") == {
        ".csv": table.to_csv(index=False),
        ".md": to_markdown(spec, table),
        ".tex": to_latex(spec, table),
    }


def test_distances_of_sets_reach_their_table(scores, tmp_path):
    blank = {"string": "", "int64": 0, "float64": 7.25}
    row = {name: blank[kind] for name, kind in SET_TYPES.items()}
    row |= {"dataset": "d", "split": "observed", "method": "three-dgs", "variant": "default"}
    sets = set_frame([{**row, "metric": "fid", "status": "ok"}])
    observed = scores.assign(split="observed", metric="psnr")
    write_table(tmp_path / "a", "observed", observed, SETTINGS, ENTRANTS, sets)
    assert "7.25" in (tmp_path / "a.csv").read_text()


def test_the_ablation_is_csv_markdown_and_latex(scores, tmp_path):
    write_ablation_table(tmp_path / "a", scores, SETTINGS, ENTRANTS)
    table = make_ablation_table(scores, SETTINGS, ENTRANTS)
    assert files(tmp_path / "a") == {
        ".csv": table.to_csv(index=False),
        ".md": ablation_markdown(table),
        ".tex": ablation_latex(table),
    }


def test_costs_are_csv_and_markdown(costs, tmp_path):
    write_cost_table(tmp_path / "a", costs, ENTRANTS)
    table = make_cost_table(costs, ENTRANTS)
    assert files(tmp_path / "a") == {
        ".csv": table.to_csv(index=False),
        ".md": cost_markdown(table),
    }


def test_geometry_is_csv_markdown_and_latex(tmp_path):
    blank = {"string": "a", "int64": 1, "float64": 0.5}
    row = {name: blank[kind] for name, kind in DEPTH_SCORE_TYPES.items()}
    row |= {"metric": "abs_rel", "stage": "pretrained", "scale": "none", "status": "ok"}
    scores = pd.DataFrame([row], columns=list(DEPTH_SCORE_TYPES)).astype(DEPTH_SCORE_TYPES)
    write_geometry_table(tmp_path / "a", scores, SETTINGS)
    table = make_geometry_table(scores, SETTINGS)
    assert files(tmp_path / "a") == {
        ".csv": table.to_csv(index=False),
        ".md": geometry_markdown(table),
        ".tex": geometry_latex(table),
    }


def test_complexity_is_csv_and_markdown_and_a_chart(scores, costs, tmp_path):
    write_complexity_table(tmp_path / "a", scores, costs, ENTRANTS)
    table = make_complexity_table(scores, costs, ENTRANTS)
    assert files(tmp_path / "a") == {
        ".csv": table.to_csv(index=False),
        ".md": complexity_markdown(table),
    }
    write_size_chart(tmp_path / "b", scores, costs, SETTINGS, ENTRANTS)
    assert files(tmp_path / "b") == {
        ".csv": size_curves(scores, costs, SETTINGS, ENTRANTS).to_csv(index=False),
        ".png": "",
        ".html": "",
    }


def test_rank_agreement_is_csv_and_markdown(scores, tmp_path):
    write_rank_agreement(tmp_path / "a", scores, SETTINGS)
    table = make_rank_agreement(scores, SETTINGS)
    assert files(tmp_path / "a") == {
        ".csv": table.to_csv(index=False),
        ".md": rank_agreement_markdown(table),
    }


def test_a_chart_is_csv_a_picture_and_a_page(scores, costs, tmp_path):
    write_chart(tmp_path / "a", "extrapolation", scores, costs, SETTINGS, ENTRANTS)
    table = speed_accuracy("extrapolation", scores, costs, SETTINGS, ENTRANTS)
    assert files(tmp_path / "a") == {
        ".csv": table.to_csv(index=False),
        ".png": "",
        ".html": "",
    }


def test_the_stability_suite_is_three_tables_a_page_and_curves(scores, tmp_path):
    clean = scores.assign(stressor="clean", level=0.0)
    made = pd.concat(
        [
            clean.assign(metric="psnr"),
            clean.assign(metric="psnr", stressor="support", level=0.05),
            clean.assign(metric="seed_spread_supported"),
            clean.assign(metric="seed_spread_new"),
        ]
    )
    write_stability(tmp_path, made, SETTINGS, ENTRANTS)
    tables = {
        "stability": make_stability_table(made, SETTINGS, ENTRANTS),
        "breaking_points": breaking_points(made, SETTINGS, ENTRANTS),
        "seed_spread": seed_spread(made, SETTINGS, ENTRANTS),
    }
    assert {path.name for path in tmp_path.iterdir()} == {
        *(f"{name}.csv" for name in tables),
        "breaking_points.md",
    }
    for name, table in tables.items():
        assert (tmp_path / f"{name}.csv").read_text() == table.to_csv(index=False)
    page = stability_markdown(tables["stability"], tables["breaking_points"], tables["seed_spread"])
    assert (tmp_path / "breaking_points.md").read_text() == page
    write_stability_chart(tmp_path / "support", tables["stability"], "support")
    assert files(tmp_path / "support") == {
        ".csv": curves(tables["stability"], "support").to_csv(index=False),
        ".png": "",
        ".html": "",
    }
