import math

import pandas as pd
import pytest

from geoevs.protocol.entries import FAILED
from geoevs.results.costs import cost_markdown, make_cost_table
from geoevs.results.entrants import Entrants, Info
from geoevs.results.formats import LEGEND, to_latex, to_markdown
from geoevs.results.table_specs import TableSpec

SPEC = TableSpec("A title", "observed", ("psnr", "mae"), set_metrics=("fid",))
FID = ("fid", "fid_low", "fid_high", "fid_floor")
NONE = dict.fromkeys(("mae", "mae_low", "mae_high", *FID), math.nan) | {
    "unmeasured": "",
    "partial": "",
}
TABLE = pd.DataFrame(
    [
        {
            **{"dataset": "d_1", "group": "paper", "method": "geo-evs", "variant": "default"},
            **{"psnr_paper": 23.4, "psnr": 24.126, "psnr_low": 23.0, "psnr_high": 25.0},
            **{**NONE, "fid_paper": 3.9, "n": 4, "failed": 0, "below_floor": "", "note": ""},
            **{"name": "Geo-EVS", "paradigm": "diffusion", "extra_prior": "a | b"},
        },
        {
            **{"dataset": "d_1", "group": "control", "method": "mean-colour", "variant": "v"},
            **{"psnr_paper": math.nan, "psnr": math.inf, "psnr_low": 1.0, "psnr_high": math.inf},
            **{**NONE, "fid_paper": math.nan, "mae": 0.1236, "n": 0, "failed": 1},
            **{"below_floor": "mae", "note": "50% & more"},
            **{"name": "{#1} (v)", "paradigm": "control", "extra_prior": "none"},
        },
    ]
)


def test_markdown_by_hand():
    assert to_markdown(SPEC, TABLE) == (
        "# A title\n\n## d_1\n\n"
        "| method | paradigm | extra prior | psnr ↑ paper | psnr ↑ | mae ↓ | fid ↓ paper | fid ↓ |"
        " n | note |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n"
        "| Geo-EVS | diffusion | a \\| b | 23.40 | 24.13 [23.00, 25.00] |  | 3.90 |  | 4 |  |\n"
        "| *{#1} (v)* | control | none |  | ∞ | 0.124 ▼ |  |  |  | 50% & more |\n\n" + LEGEND
    )


# The line of the header is broken here.
LATEX = r"""% A title

% d_1
\begin{tabular}{lccccccccc}
\toprule
method & paradigm & extra prior & psnr $\uparrow$ paper & psnr $\uparrow$ & mae $\downarrow$ &
 fid $\downarrow$ paper & fid $\downarrow$ & n & note \\
\midrule
Geo-EVS & diffusion & a \textbar{} b & 23.40 & 24.13 [23.00, 25.00] &  & 3.90 &  & 4 &  \\
\midrule
\{\#1\} (v) & control & none &  & $\infty$ & 0.124 $\blacktriangledown$ &  &  &  & 50\% \& more \\
\bottomrule
\end{tabular}
"""


def test_latex_by_hand():
    assert to_latex(SPEC, TABLE) == LATEX.replace("&\n", "&")


def test_a_column_without_paper_or_value_is_left_out():
    bare = TABLE.drop(columns=["psnr_paper", "fid_paper"])
    header = to_markdown(SPEC, bare.assign(mae=math.nan)).splitlines()[4]
    assert header == "| method | paradigm | extra prior | psnr ↑ | n | note |"


def test_bins_have_their_column_and_data_sets_their_own_tables():
    spec = TableSpec("T", "pose-sweep", ("sparse_psnr",), bins="pose_offset", edges="pose_bins")
    values = {"sparse_psnr": 20.0, "sparse_psnr_low": math.nan, "sparse_psnr_high": math.nan}
    usual = {"group": "method", "method": "m", "name": "M", "variant": "default", "bin": "0-5"}
    rest = {**values, "n": 1, "failed": 0, "below_floor": "", "unmeasured": "", "note": ""}
    rest["partial"] = ""
    table = pd.DataFrame([{"dataset": name, **usual, **rest} for name in ("b", "a")])
    text = to_markdown(spec, table)
    assert text.index("## b") < text.index("## a")
    assert text.count("| M | 0-5 | 20.00 | 1 |  |") == 2
    latex = to_latex(spec, table)
    assert latex.count(r"method & bin & sparse\_psnr $\uparrow$ & n & note \\") == 2
    assert latex.count(r"\midrule") == 2  # below each header; one group each


ENTRANTS = Entrants(
    {
        "mean-colour": Info("Mean colour", "control"),
        "reproject": Info("Reprojection", "control", "none", "lidar"),
    }
)


@pytest.fixture
def costs():
    usual = {
        **{"dataset": "d", "method": "mine", "variant": "default", "sources": "all-cameras"},
        **{"status": "ok", "fit_seconds": 1.0, "render_seconds": 0.5, "peak_memory": 3_000_000},
        **{"gpu_memory": 0, "primitives": 10, "parameters": 0, "bytes": 2_000_000},
        **{"device": "cpu", "threads": 2, "scene": "s", "note": "", "training_seconds": math.nan},
        **{"load_seconds": 0.25, "warm_up_seconds": 0.75, "host": "a", "cpu": "EPYC"},
    }
    return lambda *changes: pd.DataFrame([{**usual, **change} for change in changes])


def test_costs_are_means_of_what_went_well(costs):
    broken = {"status": FAILED, "fit_seconds": math.nan, "peak_memory": 0, "bytes": 0}
    made = make_cost_table(
        costs({}, {"fit_seconds": 3.0}, broken, {"sources": "front-side", "fit_seconds": 99.0}),
        ENTRANTS,
    )
    (row,) = made.to_dict("records")
    assert (row["fit_seconds"], row["render_seconds"]) == (2.0, 0.5)
    assert (row["peak_memory_mb"], row["size_mb"], row["primitives"]) == (3.0, 2.0, 10.0)
    assert (row["n"], row["failed"], row["device"], row["threads"]) == (2, 1, "cpu", 2)
    assert (row["name"], row["paradigm"], row["needs"]) == ("mine", "", "")


def test_costs_of_a_method_that_always_fails_are_empty(costs):
    broken = {"status": FAILED, "method": "mean-colour", "fit_seconds": math.nan}
    text = cost_markdown(make_cost_table(costs({}, broken), ENTRANTS))
    assert text.split("\n\n")[2].splitlines()[-2:] == [
        "| mine | 1 |  | 0.25 | 0.75 | 0.5 | 3 | 0 | 10 | 0 | 2 | cpu | 2 | 1 | 0 |",
        "| *Mean colour* |  |  |  |  |  |  |  |  |  |  |  | 2 | 0 | 1 |",
    ]


def test_training_is_a_cost_of_its_own(costs):
    seeds = [{"training_seconds": 100.0}, {"training_seconds": 140.0, "seed": 1}]
    made = make_cost_table(costs(*seeds, {"method": "untrained"}), ENTRANTS)
    assert made["training_seconds"].tolist()[0] == 120.0
    assert math.isnan(made["training_seconds"].tolist()[1])
    assert made["fit_seconds"].tolist() == [1.0, 1.0]
    text = cost_markdown(made)
    assert "| mine | 1 | 120 | 0.25 | 0.75 | 0.5 |" in text
    assert "once for all scenes, and in no `fit s`" in text.replace("\n", " ")


def test_notes_of_fits_that_agree_are_one(costs):
    same = [{"scene": scene, "note": "no LiDAR"} for scene in "st"]
    broken = {"scene": "u", "status": FAILED, "note": "unheard of"}
    other = {"method": "reproject", "note": "no LiDAR"}
    made = make_cost_table(costs(*same, broken, other, {"method": "silent"}), ENTRANTS)
    assert made["note"].tolist() == ["no LiDAR", "no LiDAR", ""]
    notes = [line for line in cost_markdown(made).splitlines() if line.startswith("- ")]
    assert notes == ["- mine, *Reprojection*: no LiDAR"]


def test_notes_that_differ_name_their_scenes(costs):
    fits = [("s", "9 points"), ("t", ""), ("u", "9 points"), ("s", "9 points"), ("v", "8 points")]
    rows = costs(*({"scene": scene, "note": note} for scene, note in fits))
    made = make_cost_table(rows, ENTRANTS)
    assert made["note"].tolist() == ["s, u: 9 points | v: 8 points"]
    assert "\n- mine: s, u: 9 points | v: 8 points\n" in cost_markdown(made)


def test_seconds_of_several_machines_do_not_stand_side_by_side_without_a_word(costs):
    one = make_cost_table(costs({}, {"scene": "t"}), ENTRANTS)
    assert one[["machines", "timed_on"]].to_numpy().tolist() == [["EPYC (a)", ""]]
    assert "Timed on" not in cost_markdown(one)

    more = [{"scene": host, "host": host} for host in "bcde"]
    alike = make_cost_table(costs({}, *more), ENTRANTS)
    said = "Timed on 5 machines with one processor: EPYC (a, b, c, 2 more)."
    assert alike["timed_on"].tolist() == [said]
    assert f"\n**{said}**\n" in cost_markdown(alike)

    other = {"method": "reproject", "host": "x", "cpu": "Xeon * 2"}
    failing = {"method": "reproject", "host": "y", "cpu": "ARM", "status": FAILED}
    mixed = make_cost_table(costs({}, other, failing), ENTRANTS)
    assert mixed["machines"].tolist() == ["EPYC (a)", "Xeon * 2 (x)"]
    said = "Timed on 2 machines with 2 processors, whose seconds do not compare: "
    assert set(mixed["timed_on"]) == {f"{said}EPYC (a), Xeon * 2 (x)."}
    assert f"\n**{said}EPYC (a), Xeon \\* 2 (x).**\n" in cost_markdown(mixed)
