import json
import re
import shutil

import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_text
from geoevs.protocol.targets import read_targets
from geoevs.results.entrants import Entrants, Info
from geoevs.results.report import page
from geoevs.results.report.page import _exhibits, chart_of, make_page, table_html
from geoevs.results.report.pictures import _unlike, comparison

PLACE = {"dataset": "d", "scene": "s"}
SCENES = [("d", "s")]


def embedded(file, name):
    found = re.search(rf'id="{name}">(.*?)</script>', file.read_text(), re.DOTALL)
    return json.loads(found[1])


def test_the_page_holds_the_run_and_needs_nothing_else(reported):
    _, page = reported
    text = page.read_text()
    markup = text[: text.index("<script")]
    assert not re.search(r'(src|href)="(?!data:|#)', markup)
    assert not re.search(r"@import|url\((?!data:)", text[: text.index("</style>")])
    assert page.stat().st_size < 3e6
    assert "no &lt;points&gt;" in text
    assert "Traceback: &lt;out of points&gt;" in text
    assert "Not measured: lpips, as no weights." in text
    assert list(embedded(page, "charts-data")) == ["charts/extrapolation"]


def test_the_page_says_that_renders_were_dropped(reported, tmp_path):
    run, page = reported
    said = "Renders were dropped when they were scored, as the config says."
    assert said not in page.read_text()
    run = shutil.copytree(run, tmp_path / "run")
    manifest = json.loads((run / layout.MANIFEST).read_text())
    manifest["config"]["renders"] = "drop"
    (run / layout.MANIFEST).write_text(json.dumps(manifest))
    shutil.rmtree(run / "renders")
    assert said in make_page(run)


def test_results_of_any_folder_appear(reported):
    _, page = reported
    text = page.read_text()
    assert '<a href="#stability">Stability</a>' in text
    assert 'alt="stability: thinning" src="data:image/webp;base64,' in text
    assert "thinning.csv" in text
    assert '<section id="renders">' not in text


def test_pages_in_words_are_shown_first_and_their_text_is_data(reported):
    _, page = reported
    stability = page.read_text().split('<section id="stability">')[1].split("</section>")[0]
    assert "<h3>Breaking &lt;points&gt;</h3>" in stability
    assert "<td>&lt;b&gt;3DGS&lt;/b&gt;</td>" in stability
    assert "<em>none</em>: it stays [above](http://host) it ![so](http://host/a.png)." in stability
    assert "<summary>Breaking points</summary>" in stability
    assert stability.index("Breaking points") < stability.index("thinning.csv")


def test_the_summary_speaks_of_suites_that_were_run(reported, tmp_path):
    run, page = reported
    assert "see Audit" not in page.read_text()
    copy = shutil.copytree(run, tmp_path / "run")
    row = {"dataset": "d", "metric": "sparse_psnr", "share": 1.0, "support": 0.06, "bias": 1.0}
    row |= {"tau": 0.9, "tau_low": 0.8, "tau_high": 1.0, "gap": 2.0, "entrants": 4}
    write_text(copy / "audit/agreement.csv", pd.DataFrame([row]).to_csv(index=False))
    text = make_page(copy)
    assert text.index("in the order of dense PSNR 19 times in 20.") < text.index("see Failures.")


def test_the_summary_is_made_from_the_numbers(reported):
    _, page = reported
    text = re.sub(r"&#3[49];", "'", page.read_text())
    # Frames 0 and 1 of one scene: the mean of 22 and 23.
    assert "By sparse PSNR of extrapolated views the best method is Geo-EVS (22.50 [" in text
    assert "The best control is Reprojection (20.50 [" in text
    assert "View by view Geo-EVS gains 2.00 dB [2.00, 2.00] on Reprojection." in text
    frontier = "mean-colour (0.001 s a view, 11.50 dB), Reprojection (0.01 s a view, 20.50 dB), "
    assert f"each of these: {frontier}Geo-EVS (0.1 s a view, 22.50 dB)." in text
    assert "Worse than one colour (mean-colour) on extrapolated views: Grey on " in text
    assert "Failed, on at least one scene: broken; see Failures." in text
    assert "Failed, under stress: mean-colour; see Failures." in text


def test_failures_under_stress_are_listed_with_their_log(reported):
    _, page = reported
    listed = page.read_text().split('<section id="failures">')[1]
    place = "d/s, stressed by support 0.01 (draws 1)"
    assert f"mean-colour could not fit {place}: no &lt;points&gt;" in listed
    assert listed.count("Traceback: &lt;out of points&gt;") == 3  # two fits, one stressed


def test_every_view_has_its_pictures_and_scores(reported):
    run, page = reported
    data = embedded(page, "compare-data")
    targets = read_targets(run / layout.TARGETS.format(**PLACE))
    assert len(data["views"]) == len(targets)
    assert data["frames"] == data["all_frames"] == 2
    for view, target in zip(data["views"], targets, strict=True):
        assert (view["view"], view["frame"]) == (target.camera.name, target.frame)
        assert ("truth" in view["pictures"]) == target.recorded
        assert ("sparse reference" in view["pictures"]) != target.recorded
        assert "grey" in view["pictures"]
        assert (view["overlay"] is None) == (target.recorded and not target.masked)
        assert view["scores"]["reproject"] == {
            "sparse_psnr": 20 + target.frame,
            "psnr": 20 + target.frame,
        }
        assert "broken" not in view["scores"]
    assert all(image.startswith("data:image/webp;base64,") for image in data["images"])


def test_a_budget_lowers_quality_then_leaves_out_frames(run):
    ample = comparison(run, SCENES, ["grey"], 10**8)
    assert (ample["quality"], ample["frames"], ample["all_frames"]) == (80, 2, 2)
    scarce = comparison(run, SCENES, ["grey"], 6000)
    assert scarce["quality"] == 30
    assert (scarce["frames"], scarce["all_frames"]) == (1, 2)
    assert {view["frame"] for view in scarce["views"]} == {0}
    assert len(scarce["views"]) < len(ample["views"])


def test_pictures_get_what_the_rest_of_the_page_leaves(reported, monkeypatch):
    def one_that_fills(_run, _scenes, _labels, budget, _threads):
        return {"images": ["x" * budget], "views": [], "quality": 40, "frames": 1, "all_frames": 1}

    monkeypatch.setattr(page, "comparison", one_that_fills)
    length = len(make_page(reported[0]).encode())
    assert 0.99 * page.PAGE_BYTES < length <= page.PAGE_BYTES + 1000
    assert page.PAGE_BYTES < 25e6


def test_equal_pictures_count_once_for_the_budget(tmp_path):
    paths = [tmp_path / name for name in ("a", "b", "c")]
    for path, text in zip(paths, ("same", "same", "other"), strict=True):
        path.write_text(text)
    assert sorted(path.name for path in _unlike(paths)) == ["b", "c"]


def test_means_stand_with_their_interval_and_sort_by_their_value():
    rows = pd.DataFrame(
        {
            **{"method": ["geo-evs", "reproject"], "psnr": [21.5, float("inf")]},
            **{"psnr_low": [20.0, float("nan")], "psnr_high": [23.0, float("nan")]},
            **{"empty": [None, None], "note": ["<b>", ""], "gap_low": [1.0, 2.0]},
        }
    )
    entrants = Entrants({"reproject": Info("Reprojection", "control")})
    text = str(table_html(rows, entrants))
    assert '<td class="number" data-sort="21.5">21.5 <small>[20, 23]</small></td>' in text
    assert '<td class="number" data-sort="inf">∞</td>' in text
    assert "<tr class=control><td>reproject</td>" in text
    assert "&lt;b&gt;" in text
    assert "empty" not in text
    assert ">gap low</th>" in text  # an end without its mean is a column like others


def test_who_plays_comes_first():
    rows = pd.DataFrame([{"dataset": "d", "group": "g", "method": "m", "psnr": 1, "name": "M"}])
    text = str(table_html(rows, Entrants({})))
    head = re.findall(r">(\w+)</th>", text)
    assert head == ["dataset", "method", "name", "group", "psnr"]


def test_words_come_first_then_charts_in_the_order_of_their_tables(tmp_path):
    for name in ("complexity.csv", "observed.csv", "extrapolation.csv", "words.md"):
        write_text(tmp_path / name, "a\n")
    names = [exhibit.name for exhibit in _exhibits(tmp_path)]
    assert names == ["words", "extrapolation", "observed", "complexity"]


def test_pages_without_a_chart_have_none(tmp_path):
    path = tmp_path / "a.html"
    path.write_text("<p>const nothing = 1</p>")
    assert chart_of(path) is None
    path.write_text('<script>const spec = {"mark": "bar"};\nmore()</script>')
    assert chart_of(path) == {"mark": "bar"}


def test_the_ablations_method_is_shown_first(reported):
    run, page = reported
    assert embedded(page, "compare-data")["featured"] == "geo-evs"
    assert f"geoevs why extrapolation geo-evs sparse_psnr --run {run.name}" in page.read_text()


def test_the_same_run_gives_the_same_page(reported):
    run, page = reported
    assert make_page(run) == page.read_text()


def test_a_run_without_rows_says_what_is_missing(tmp_path):
    with pytest.raises(GeoEvsError, match=r"manifest\.json is missing; make or copy"):
        make_page(tmp_path)
