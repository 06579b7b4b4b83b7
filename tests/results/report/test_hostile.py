"""A run by somebody who means harm: none of it is run, or written or read elsewhere."""

import json
import os
import re
import shutil

import pandas as pd
import pytest

from geoevs import layout
from geoevs.core import parquet
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json, write_text
from geoevs.core.parquet import write_parquet
from geoevs.results.chart_pages import page_html
from geoevs.results.report.page import chart_of, make_page
from geoevs.results.report.pictures import file_address
from geoevs.results.rows import read_rows
from geoevs.results.why import explain
from geoevs.results.why_lookup import Cell, Rows, Term, terms_of

NAMES = [
    '"+@pd.io.common.os.system("touch HARM")+"',
    "' or @__import__('os').system('touch HARM') or '",
    "../../elsewhere",
    "/etc",
    "a\nb",
    "<!--<script>",
    "=HYPERLINK(1)",
    "",
    "a`b`",
    "x" * 300,
]


@pytest.fixture
def folder(reported, tmp_path, monkeypatch):
    """A copy of a whole run, and the folder above it, which nothing may write to."""
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(reported[0], tmp_path / "run")


def edit(folder, name, **columns):
    rows = pd.read_parquet(folder / name)
    write_parquet(folder / name, rows.assign(**columns).astype(rows.dtypes))


@pytest.mark.parametrize(
    ("column", "name"),
    [*zip(["dataset", "scene", "method", "variant", "target"] * 2, NAMES, strict=True)],
)
def test_a_name_that_is_none_ends_every_command(folder, geoevs, name, column):
    before = {path for path in folder.parent.rglob("*") if path != folder / layout.SCORES}
    edit(folder, layout.SCORES, **{column: name})
    commands = (
        ("why", "extrapolation", "grey", "sparse_psnr", "--run", folder),
        ("compare", "extrapolation", "grey", "reproject", "--run", folder),
        ("report", "--run", folder, "--out", folder / "new.html"),
    )
    for command in commands:
        code, output, errors = geoevs(*command)
        assert (code, output) == (1, "")
        assert errors.count("\n") == 1
        assert errors.startswith(f"error: {folder}/scores.parquet: {column} '")
        assert "is not an allowed name" in errors
    code, output, _ = geoevs("verify", folder)
    assert code == 1
    assert "is not an allowed name" in output
    assert {path for path in folder.parent.rglob("*") if path != folder / layout.SCORES} == before


def test_terms_choose_rows_without_being_code_and_can_be_pasted():
    rows = pd.DataFrame({"dataset": [NAMES[0], "d", "it's"], "value": [1.0, 2.0, 3.0]})
    for name in rows["dataset"]:
        found = Rows.of("f", rows, [*terms_of(dataset=name), Term("value", ">=", 0.5)])
        assert found.rows["dataset"].tolist() == [name]
        assert rows.query(found.query)["dataset"].tolist() == [name]
    assert Rows.of("f", rows, terms_of(dataset=["d", "e"])).rows["value"].tolist() == [2.0]


@pytest.mark.parametrize(
    "log", ["/etc/passwd", "logs/../../secret", "x/logs/fit/link.log", "/etc/logs/../passwd"]
)
def test_a_log_elsewhere_is_not_embedded(folder, log):
    secret = folder.parent / "secret"
    write_text(secret, "root: a secret\n")
    edit(folder, layout.COSTS, log=log)
    if "link" in log:
        (folder / "logs/fit/link.log").symlink_to(secret)
        with pytest.raises(GeoEvsError, match=r"link\.log is a link that leads out of the run"):
            make_page(folder)
        return
    page = make_page(folder)
    assert not re.search("root:x:|a secret", page)
    assert "The log lies outside of this run and was not read." in page


def test_the_logs_of_a_run_that_was_moved_are_found(folder):
    edit(folder, layout.COSTS, log="/home/them/results/run/logs/fit/d/s/broken.log")
    assert make_page(folder).count("Traceback: &lt;out of points&gt;") == 3


@pytest.mark.parametrize("name", ["tables/more.csv", "renders/d/s/grey/front/000000.png", "own"])
def test_links_that_lead_out_are_refused(folder, name):
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to("/etc" if name == "own" else "/etc/passwd")
    with pytest.raises(GeoEvsError, match="is a link that leads out of the run"):
        make_page(folder)


GRID = ("grid", "extrapolation", "--scenes", "d/s", "--labels", "grey", "--keeps", "[1.0]")


@pytest.mark.parametrize(
    "name",
    [
        *("scenes/d/s/images/front/000000.png", "renders/d/s/grey/front/000000.png", "scenes/d/s"),
        *("renders", "targets/d/s.json", "references/d/s.npz", "masks/d/s.npz", "truth/d"),
    ],
)
def test_a_grid_shows_nothing_from_outside(folder, geoevs, name):
    elsewhere, out = folder.parent / "elsewhere", folder.parent / "grid.png"
    assert geoevs(*GRID, "--run", folder, "--out", out)[0] == 0
    out.unlink()
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    if (folder / name).exists():
        (folder / name).rename(elsewhere)
    else:
        elsewhere.touch()
    (folder / name).symlink_to(elsewhere)
    code, output, errors = geoevs(*GRID, "--run", folder, "--out", out)
    assert (code, output, out.exists()) == (1, "", False)
    assert "is a link that leads out of the run" in errors
    assert errors.count("\n") == 1


def test_a_picture_that_is_none_by_content_is_refused(folder):
    path = folder / "stability/thinning.png"
    path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n")
    with pytest.raises(GeoEvsError, match=re.escape(str(path))):
        file_address(path)


def test_what_others_wrote_is_text_on_the_page(folder):
    harm = "</script><!--<script><b onclick=x>\x1b[31m\u2028"
    entrants = read_json(folder / layout.ENTRANTS)
    entrants["grey"]["name"] = harm
    write_json(folder / layout.ENTRANTS, entrants)
    edit(folder, layout.COSTS, reason=harm, note=harm)
    chart = {"title": harm, "usermeta": {"embedOptions": {"ast": False}}}
    write_text(folder / "charts/extrapolation.html", f"var spec = {json.dumps(chart)};")
    write_text(folder / "stability/breaking_points.md", f"# {harm}\n\n[a](javascript:b)\n")
    page = make_page(folder)
    assert "<!--<script>" not in page
    assert "<b onclick" not in page
    assert "\x1b" not in page
    assert "javascript:b" not in re.findall(r'href="([^"]*)"', page)
    for name in ("charts-data", "compare-data"):
        data = re.search(rf'id="{name}">(.*?)</script>', page, re.DOTALL)[1]
        assert "<" not in data
        assert "embedOptions" not in data


def test_the_page_runs_its_own_scripts_alone_and_loads_nothing(reported):
    page = reported[1].read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert "default-src &#39;none&#39;" in policy
    assert "unsafe-eval" not in policy
    assert policy.count("sha256-") == page.count("<script>") == 4


@pytest.mark.parametrize("spec", ['{"a": NaN}', '{"a": ', "{" * 9 + "[" * 9999])
def test_a_chart_that_is_none_is_one_sentence(tmp_path, spec):
    page = tmp_path / "page.html"
    write_text(page, f"const spec = {spec}")
    with pytest.raises(GeoEvsError, match="holds no chart that can be read"):
        chart_of(page)


def test_a_chart_page_holds_names_as_text():
    spec = {
        "$schema": "https://vega.github.io/schema/vega-lite/v5.json",
        "data": {"values": [{"a": "</script><script>harm", "b": 1}]},
        "mark": "bar",
        "encoding": {"x": {"field": "a"}, "y": {"field": "b", "type": "quantitative"}},
    }
    page = page_html(spec)
    assert "<script>harm" not in page
    assert r"\u003c/script>\u003cscript>harm" in page


def test_what_a_manifest_may_not_say_is_one_sentence(folder, geoevs):
    said = read_json(folder / layout.MANIFEST)
    tables = said["config"]["tables"]
    for config in (
        {"tables": tables, "methods": []},
        {"tables": tables, "methods": {"grey": 3}},
        {"tables": 3},
        {"tables": {**tables, "pose_bins": "x"}},
        {"tables": tables, "trainings": 3, "methods": {"grey": {"training": "a/b"}}},
    ):
        write_json(folder / layout.MANIFEST, {**said, "config": config})
        code, output, errors = geoevs("why", "extrapolation", "grey", "psnr", "--run", folder)
        assert (code, output) == (1, "")
        assert errors.startswith("error: ")
        assert errors.count("\n") == 1


def test_commands_print_nothing_that_steers_a_terminal(folder, geoevs):
    said = read_json(folder / layout.MANIFEST)
    write_json(folder / layout.MANIFEST, {**said, "commit": "\x1b]0;harm\x07\x1b[2J"})
    code, output, _ = geoevs("why", "extrapolation", "grey", "psnr", "--run", folder)
    assert code == 0
    assert "\x1b" not in output
    edit(folder, layout.COSTS, reason="red \x1b[31m\u202e text\r\n")
    code, _, errors = geoevs("failures", folder / layout.COSTS)
    assert code == 0
    assert "\x1b" not in errors
    assert "\u202e" not in errors


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda rows: rows.drop(columns="level"), "lacks the column 'level'"),
        (lambda rows: rows.assign(seed="1"), "column 'seed' holds .*string, not whole numbers"),
        (lambda rows: rows.assign(seed=0.5), "column 'seed' holds double, not whole numbers"),
        (lambda rows: rows.assign(value="x"), "column 'value' holds .*string, not numbers"),
        (lambda rows: rows.assign(reason=5), "column 'reason' holds int64, not text"),
        (lambda rows: rows.assign(scene=None), "column 'scene' holds null, not text"),
        (lambda rows: rows.assign(log="x" * 20_000), "column 'log' holds a text of more than"),
        (lambda rows: rows.assign(pose_offset=float("nan")), "'pose_offset' has values that are"),
        (lambda rows: rows[:0], "has no rows"),
    ],
)
def test_rows_that_cannot_be_are_named_with_file_and_column(folder, change, sentence):
    path = folder / layout.SCORES
    change(pd.read_parquet(path)).to_parquet(path, index=False)
    with pytest.raises(GeoEvsError, match=rf"{re.escape(str(path))}.*{sentence}"):
        read_rows(path, layout.SCORES)


def test_what_is_no_parquet_file_is_one_sentence(tmp_path):
    for name, make in {
        "folder": lambda path: path.mkdir(),
        "empty": lambda path: path.touch(),
        "junk": lambda path: path.write_bytes(b"PAR1" + b"\xff" * 99 + b"PAR1"),
        "fifo": os.mkfifo,
        "none": lambda path: None,
    }.items():
        make(tmp_path / name)
        with pytest.raises(GeoEvsError, match=f"{name} is (not whole|missing|a folder|a pipe)"):
            read_rows(tmp_path / name, layout.SCORES)


def test_a_table_of_a_billion_rows_is_not_unpacked(tmp_path, monkeypatch):
    rows = pd.DataFrame({"a": ["x"] * 200_000})
    rows.to_parquet(tmp_path / "rows.parquet", index=False)
    monkeypatch.setattr(parquet, "MOST_ROWS", (1000, 1))
    with pytest.raises(GeoEvsError, match="claims 200000 rows"):
        parquet.read_parquet(tmp_path / "rows.parquet", {"a": "string"})


def test_a_cell_of_hostile_words_is_refused_not_run(folder):
    for cell in (
        Cell("extrapolation", NAMES[0], "psnr"),
        Cell("extrapolation", "grey", NAMES[1]),
        Cell("extrapolation", "grey", "psnr", dataset=NAMES[0]),
        Cell("pose_offset", "grey", "psnr", NAMES[1]),
        Cell("../" * 5 + "etc/passwd", "grey", "psnr"),
    ):
        with pytest.raises(GeoEvsError, match="there is no "):
            explain(cell, folder)


@pytest.mark.parametrize("name", ["../../out", "/tmp/out", "a/../../../out", "a\nb", ""])
def test_targets_of_hostile_names_are_neither_exported_nor_rendered(folder, geoevs, name):
    place = {"dataset": "d", "scene": "s"}
    scene, targets = (folder / path.format(**place) for path in (layout.SCENE, layout.TARGETS))
    views = read_json(targets)
    views[0]["name"] = name
    write_json(targets, views)
    model = folder / "models/d/s/grey"
    outcome = {"status": "ok", "stage": "", "reason": "", "log": "", "threads": 1}
    outcome |= {"peak_memory": 0, "gpu_memory": 0}
    write_json(model / "fit.json", {"all-cameras": outcome})
    before = set(folder.parent.rglob("*"))
    masks = folder / layout.MASKS.format(**place)
    out = ("--out", folder / "out")
    render = ("render", "--method", "mean-colour", "--model", model, "--masks", masks)
    for command in (
        ("export", "--scene", scene, "--targets", targets, *out),
        (*render, "--targets", targets, "--method-log", folder / "logs/r.log", *out),
    ):
        geoevs(*command)
        left = set(folder.parent.rglob("*")) - before
        assert all(path.is_relative_to(folder / "out") or path.suffix == ".log" for path in left)
        assert not list((folder / "out").rglob("*.png")) if (folder / "out").exists() else True


def test_a_suite_whose_table_is_broken_is_named(folder):
    write_text(folder / "audit/agreement.csv", "metric\nsparse_psnr\n")
    with pytest.raises(GeoEvsError, match=r"agreement\.csv is not whole"):
        make_page(folder)
