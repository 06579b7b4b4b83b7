import re
import shlex

import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.results.why import explain
from geoevs.results.why_lookup import Cell


def test_a_cell_leads_to_rows_pictures_config_and_command(reported):
    run, _ = reported
    lines = explain(Cell("extrapolation", "grey", "sparse_psnr"), run)
    text = "\n".join(lines)
    # Two frames of four views each, 9 and 10 dB.
    assert lines[0] == "cell      extrapolation grey sparse_psnr = 9.5 [9, 10] on d"
    assert lines[1] == "entrant   Grey; paradigm reconstruction; extra prior none"
    assert f"rows      8 in {run}/scores.parquet, as pandas" in text
    assert "method == 'grey' and variant == 'default' and metric == 'sparse_psnr'" in text
    lowest = re.findall(r"lowest +9: (\S+)", text)
    assert len(lowest) == 3
    assert all(path.endswith("/000000.png") and "/grey/" in path for path in lowest)
    assert "commit    abc, seed 0, protocol 7 (fingerprint f)" in text
    command = shlex.split(lines[-1].removeprefix("rerun"))
    assert command[:3] == ["snakemake", "--cores", "2"]
    assert command[3:6] == ["--configfile", "config.yaml", "other.yaml"]
    assert f"{run}/parts/d/s/grey.scores.parquet" in command
    assert command[-1] == f"{run}/tables/extrapolation.csv"


def test_the_named_pictures_exist(reported):
    run, _ = reported
    lines = explain(Cell("extrapolation", "grey", "sparse_psnr"), run)
    paths = [line.split(": ")[1] for line in lines if line.startswith(("lowest", "highest"))]
    assert paths
    for path in paths:
        assert (run / path).exists()


@pytest.mark.parametrize(
    "cell",
    [
        Cell("extrapolation", "grey", "psnr"),
        Cell("pose_offset", "grey", "psnr", "0-15"),
        Cell("pose_offset", "grey", "psnr", "15-30"),
        Cell("sparsity", "grey", "sparse_psnr", "0-0.1"),
        Cell("masked", "grey", "psnr", "masked-observed"),
    ],
)
def test_the_query_finds_the_rows_behind_the_number(reported, cell):
    run, _ = reported
    lines = explain(cell, run)
    query = lines[[line.startswith("rows") for line in lines].index(True) + 1].strip()
    rows = pd.read_parquet(run / layout.SCORES).query(query)
    value = float(re.search(r" = (\S+) ", lines[0])[1])
    assert rows.groupby(["scene", "frame"])["value"].mean().mean() == pytest.approx(value, rel=1e-5)
    assert len(rows) == int(re.search(r"^rows +(\d+)", "\n".join(lines), re.MULTILINE)[1])


def test_who_plays_is_said_as_far_as_it_is_known(reported):
    cell = Cell("extrapolation", "broken", "sparse_psnr")
    assert "entrant   broken" in explain(cell, reported[0])


def test_the_papers_number_and_bins(reported):
    run, _ = reported
    cell = explain(Cell("extrapolation", "geo-evs", "sparse_psnr"), run)[0]
    assert cell.endswith("on d; the paper prints 23.65")
    cell = explain(Cell("pose_offset", "grey", "psnr", "15-30"), run)[0]
    assert cell.startswith("cell      pose_offset grey psnr 15-30 = ")


@pytest.mark.parametrize(
    ("cell", "sentence"),
    [
        (Cell("extrapolaton", "grey", "psnr"), "no table 'extrapolaton' here; did you mean 'extra"),
        (Cell("extrapolation", "gray", "psnr"), "no entrant 'gray' here; did you mean 'grey'"),
        (Cell("extrapolation", "grey", "pnsr"), "no metric 'pnsr' here; did you mean 'psnr'"),
        (Cell("pose_offset", "grey", "psnr"), "no bin '' here; one of: 0-15, 15-30"),
        (Cell("observed", "grey", "psnr", dataset="e"), "no data set 'e' here; one of: d"),
    ],
)
def test_a_cell_that_is_none_is_named(reported, cell, sentence):
    with pytest.raises(GeoEvsError, match=re.escape(sentence)):
        explain(cell, reported[0])


def test_a_bin_may_be_written_as_in_csv_files(reported):
    lines = [
        explain(Cell("pose_offset", "grey", "psnr", label), reported[0])
        for label in ("15-30", "15 to 30")
    ]
    assert lines[0][1:] == lines[1][1:]
