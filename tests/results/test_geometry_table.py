"""The geometry table from rows by hand."""

import math

import pandas as pd
import pytest

from geoevs.protocol.depth_scoring import DEPTH_SCORE_TYPES
from geoevs.results.geometry_table import geometry_latex, geometry_markdown, make_geometry_table
from geoevs.results.settings import TableSettings

# With two frames a scene, redrawn sums have the chances 1/4, 1/2 and 1/4: tails of 0.025 are the
# frames themselves.
SETTINGS = TableSettings([], [], 1000, 0.95, "geo-evs")


def rows(*changes):
    usual = {
        **{"dataset": "d_1", "scene": "s", "frame": 0, "camera": "front", "model": "vggt-nano"},
        **{"stage": "pretrained", "scale": "none", "truth": "dense", "metric": "abs_rel"},
        **{"value": 0.5, "valid_pixels": 9, "seconds": 0.2, "parameters": 4100000, "status": "ok"},
    }
    made = [{**usual, **change} for change in changes]
    return pd.DataFrame(made, columns=list(DEPTH_SCORE_TYPES)).astype(DEPTH_SCORE_TYPES)


def views(stage, values, **more):
    """Rows of two frames with two cameras each, from four values."""
    places = [(frame, camera) for frame in (0, 1) for camera in ("front", "left")]
    return [
        {"frame": frame, "camera": camera, "stage": stage, "value": value, **more}
        for (frame, camera), value in zip(places, values, strict=True)
    ]


@pytest.fixture
def table():
    lidar = {"model": "lidar", "scale": "lidar", "parameters": 0}
    return make_geometry_table(
        rows(
            *views("pretrained", (0.4, 0.6, 0.8, 1.0)),
            *views("fine-tuned", (0.1, 0.5, 0.2, 0.4), seconds=0.5),
            *views("pretrained", (2.0, 4.0, 6.0, 8.0), metric="rmse"),
            *views("control", (0.1, math.nan, 0.1, 0.1), **lidar),
        ),
        SETTINGS,
    ).set_index("stage")


def test_means_are_over_frames_and_changes_over_the_same_views(table):
    before, after = table.loc["pretrained"], table.loc["fine-tuned"]
    assert before[["abs_rel", "abs_rel_low", "abs_rel_high"]].tolist() == pytest.approx(
        [0.7, 0.5, 0.9]
    )
    assert before["rmse"] == pytest.approx(5.0)
    assert after[["abs_rel", "abs_rel_low", "abs_rel_high"]].tolist() == pytest.approx(
        [0.3, 0.3, 0.3]
    )
    # Of the frames: (-0.3 - 0.1) / 2 and (-0.6 - 0.6) / 2.
    change = ["abs_rel_change", "abs_rel_change_low", "abs_rel_change_high"]
    assert after[change].tolist() == pytest.approx([-0.4, -0.6, -0.2])
    assert before[change].isna().all()
    assert math.isnan(after["rmse"])


def test_costs_and_counts(table):
    assert table["n"].to_dict() == {"pretrained": 4, "fine-tuned": 4, "control": 3}
    assert table["seconds"].tolist() == [0.2, 0.5, 0.2]
    assert table["parameters"].tolist() == [4100000, 4100000, 0]


def test_seconds_are_the_median_frames():
    made = make_geometry_table(
        rows(
            *({"frame": 0, "camera": camera, "seconds": 9.0} for camera in "abc"),
            {"frame": 1, "seconds": 1.0},
            {"frame": 2, "seconds": 2.0},
        ),
        SETTINGS,
    )
    assert made["seconds"].tolist() == [2.0]


def test_pairs_keep_to_their_data_set_scene_and_scale():
    other = {"dataset": "e", "scale": "lidar", "scene": "t"}
    made = make_geometry_table(
        rows(
            {"value": 1.0},
            {"value": 2.0, **other},
            {"stage": "fine-tuned", "value": 1.5},
            {"stage": "fine-tuned", "value": 1.0, **other},
        ),
        SETTINGS,
    ).set_index(["dataset", "stage"])
    assert made["abs_rel_change"].dropna().to_dict() == {
        ("d_1", "fine-tuned"): 0.5,
        ("e", "fine-tuned"): -1.0,
    }


def test_a_view_scored_twice_is_refused():
    with pytest.raises(pd.errors.MergeError):
        make_geometry_table(rows({}, {}, {"stage": "fine-tuned"}), SETTINGS)


def test_markdown_and_latex_by_hand(table):
    markdown = geometry_markdown(table.reset_index()).splitlines()
    assert markdown[4:9] == [
        "| model | stage | scale | abs_rel ↓ | abs_rel change | rmse ↓ | truth | n | s / frame | "
        "parameters |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        "| vggt-nano | pretrained | none | 0.700 [0.500, 0.900] |  | 5.000 [3.000, 7.000] | dense "
        "| 4 | 0.2 | 4,100,000 |",
        "| vggt-nano | fine-tuned | none | 0.300 [0.300, 0.300] | -0.400 [-0.600, -0.200] |  | "
        "dense | 4 | 0.5 | 4,100,000 |",
        "| *lidar* | control | lidar | 0.100 [0.100, 0.100] |  |  | dense | 3 | 0.2 | 0 |",
    ]
    latex = geometry_latex(table.reset_index()).splitlines()
    assert latex[2] == "% d_1"
    assert latex[3] == r"\begin{tabular}{lccccccccc}"
    assert latex[-4:] == [
        r"\midrule",
        r"lidar & control & lidar & 0.100 [0.100, 0.100] &  &  & dense & 3 & 0.2 & 0 \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_no_change_is_not_negative():
    made = make_geometry_table(rows({}, {"stage": "fine-tuned", "value": 0.4999}), SETTINGS)
    assert "| +0.000 |" in geometry_markdown(made)


def test_coverage_stands_beside_what_it_limits():
    whole = {"metric": "coverage", "value": 1.0}
    lidar = {"model": "lidar", "stage": "control", "scale": "lidar"}
    made = make_geometry_table(
        rows(
            {},
            whole,
            {"stage": "fine-tuned", "value": 0.4},
            {"stage": "fine-tuned", **whole},
            {**lidar, "value": 0.1},
            {**lidar, **whole, "value": 0.75},
        ),
        SETTINGS,
    )
    assert made["coverage"].tolist() == [1.0, 1.0, 0.75]
    header, _, *lines = geometry_markdown(made).splitlines()[4:9]
    # A network gives every pixel a depth before and after, which is no change to show.
    columns = "abs_rel ↓ | abs_rel change | coverage ↑ | truth"
    assert columns in header
    assert [line.split(" | ")[5] for line in lines] == ["1.000", "1.000", "0.750"]


def test_the_control_alone_has_no_changes():
    made = make_geometry_table(
        rows({"model": "lidar", "stage": "control", "scale": "lidar", "truth": "lidar"}), SETTINGS
    )
    assert made["abs_rel"].tolist() == [0.5]
    assert made["abs_rel_change"].isna().all()
    assert "change |" not in geometry_markdown(made).split("\n\n")[2]
