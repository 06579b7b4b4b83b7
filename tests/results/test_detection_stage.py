import math

import numpy as np
import pandas as pd
import pytest

from geoevs.detection.counts import FIELDS
from geoevs.detection.metrics import average_precisions
from geoevs.detection.outcomes import Outcome
from geoevs.detection.rows import BOX, PREDICTION_TYPES, TRUTH_TYPES
from geoevs.detection.rules import CENTRE, CUTOFFS, LET, PLAIN
from geoevs.detection.scoring import detection_counts
from geoevs.detection.setting_counts import SETTING_COUNT_TYPES
from geoevs.detection.task_rows import RECORDED, TASK_TYPES
from geoevs.results.detection_chart import chart_points, write_detection_chart
from geoevs.results.detection_page import write_detection_stage, write_task_offsets
from geoevs.results.detection_stage import GAINS, detection_stage_table
from geoevs.results.entrants import Entrants, Info
from geoevs.results.escaping import read_csv
from geoevs.results.settings import TableSettings
from geoevs.results.task_offsets import task_table

SETTINGS = TableSettings([0, 5], [0, 0.1], resamples=200, confidence=0.95, ablation="geo-evs")
ENTRIES = {"geo-evs": ("geo-evs", "default"), "mean-colour": ("mean-colour", "default")}
WHO = Entrants(
    {
        "geo-evs": Info("Geo-EVS", "diffusion", "none", "lidar tracks training"),
        "mean-colour": Info("Mean colour", "control"),
    }
)
SCENES = ("d/a", "d/b", "d/c")
SEEDS = (0, 1)


def boxes(scene, shift, classes=("vehicle", "pedestrian")):
    """A car 12 m ahead and somebody beside it, both `shift` m too near."""
    rows = []
    for label, y in zip(classes, (0.0, 4.0), strict=False):
        box = (12.0 - shift, y, 1.0, 4.0, 2.0, 1.5, 0.0)
        rows.append(
            {"scene": scene, "frame": 0, "class": label, **dict(zip(BOX, box, strict=True))}
        )
    return pd.DataFrame(rows)


def truths(scene, **kinds):
    rows = boxes(scene, 0.0, **kinds).assign(points=9, level=1, camera="front")
    return rows[list(TRUTH_TYPES)].astype(TRUTH_TYPES)


def counts(setting, seed, shift, scenes=SCENES):
    """Counts of a detector whose boxes are `shift` m too near in all but the first scene."""
    parts = []
    for scene in scenes:
        found = boxes(scene, 0.0 if scene == SCENES[0] else shift).assign(score=0.8, ignored=0)
        found = found[list(PREDICTION_TYPES)].astype(PREDICTION_TYPES)
        parts += [detection_counts(found, truths(scene), rules) for rules in (LET, PLAIN, CENTRE)]
    rows = pd.concat(parts, ignore_index=True).assign(setting=setting, seed=seed)
    return rows[list(SETTING_COUNT_TYPES)].astype(SETTING_COUNT_TYPES)


@pytest.fixture(scope="module")
def made():
    """`native` finds all in one scene of three; `with-geo-evs` in all; a placebo failed once."""
    shifts = {"blind": 9.0, "native": 9.0, "longer": 9.0, "augmented": 9.0, "with-geo-evs": 0.0}
    outcomes, parts = {}, []
    for setting, shift in [*shifts.items(), ("with-mean-colour", 9.0)]:
        for seed in SEEDS:
            outcome = Outcome(views=5, frames=3, training_seconds=9.0, detect_seconds=0.5)
            if setting.startswith("with"):
                outcome = Outcome("", "", 45, 3, 27.0, 1.0, 4.0)
            if (setting, seed) == ("with-mean-colour", 1):
                outcome = Outcome("loss is nan at step 7", "log", 45, 3)
            else:
                parts.append(counts(setting, seed, shift))
            outcomes[setting, seed] = outcome
    return pd.concat(parts, ignore_index=True), outcomes


@pytest.fixture(scope="module")
def table(made):
    return detection_stage_table(*made, SETTINGS, ENTRIES, WHO).set_index("setting")


def test_numbers_by_hand(table):
    native, views = table.loc["native"], table.loc["with-geo-evs"]
    for column in (*GAINS, "ap_2m_vehicle", "let_ap_vehicle", "let_ap_pedestrian"):
        assert views[column] == pytest.approx(100)
    # 2 of 6 found, and 4 predictions beside them: a third of the recall at a third's precision.
    one = np.zeros((len(CUTOFFS), len(FIELDS)))
    one[:81] = (3, 3, 1, 2, 2, 0, 1, 1)
    one[81:, 0], one[81:, 4] = 3, 3
    expected = 100 * average_precisions(one)["ap"]
    assert native["let_map"] == pytest.approx(expected) == pytest.approx(100 / 9, abs=0.1)
    assert native["let_ap_cyclist"] != native["let_ap_cyclist"]  # nobody has any
    assert native["let_mapl_to_30m"] == pytest.approx(native["let_mapl"])
    assert math.isnan(native["let_mapl_30_to_50m"])
    assert (native["truths"], native["predictions"], native["flipped"]) == (6, 6, 0)


def test_gains_are_paired(table):
    views = table.loc["with-geo-evs"]
    assert views["let_mapl_gain"] == pytest.approx(100 - table.loc["native", "let_mapl"])
    # Unpaired, scenes without a box for either could be drawn; paired, views never lose.
    assert 0 <= views["let_mapl_gain_low"] < views["let_mapl_gain"] <= views["let_mapl_gain_high"]
    for name in ("blind", "longer"):  # of the same boxes
        same = table.loc[name]
        assert [same[f"let_mapl_gain{end}"] for end in ("", "_low", "_high")] == [0, 0, 0]
    assert math.isnan(table.loc["native", "let_mapl_gain"])


def test_what_a_row_says_of_its_setting(table):
    views = table.loc["with-geo-evs"]
    assert (views["name"], views["group"]) == ("recorded + Geo-EVS", "generated")
    assert views["needs"] == "lidar training"
    assert views["note"] == "its tracks were withheld"
    assert (views["views"], views["frame_seconds"], views["training_seconds"]) == (45, 5.0, 27.0)
    assert table.loc["native", "let_mapl_paper"] == 34.9
    assert views["let_mapl_paper"] == 35.9
    assert math.isnan(table.loc["blind", "let_mapl_paper"])


def test_a_setting_of_which_a_seed_failed_has_a_reason_and_no_numbers(table):
    placebo = table.loc["with-mean-colour"]
    assert placebo["note"] == "1 of 2 seeds failed: loss is nan at step 7"
    assert placebo["group"] == "control"
    assert math.isnan(placebo["let_mapl"])
    assert math.isnan(placebo["let_mapl_gain"])


def test_one_scene_and_one_seed_have_no_interval(made):
    rows, outcomes = made
    rows = rows[(rows["seed"] == 0) & (rows["scene"] == SCENES[0])]
    outcomes = {key: outcome for key, outcome in outcomes.items() if key[1] == 0}
    table = detection_stage_table(rows, outcomes, SETTINGS, ENTRIES, WHO)
    assert table["let_mapl"].notna().all()
    assert table["let_mapl_low"].isna().all()


def test_where_everything_failed_there_is_a_table_still(made):
    rows, outcomes = made
    outcomes = dict.fromkeys(outcomes, Outcome("no disk"))
    table = detection_stage_table(rows[:0], outcomes, SETTINGS, ENTRIES, WHO)
    assert table["let_mapl"].isna().all()
    assert table["note"].str.startswith("2 of 2 seeds failed: no disk").all()


def test_tables_and_chart_are_written(table, tmp_path):
    table = table.reset_index()
    write_detection_stage(tmp_path / "detection", table)
    back = read_csv(tmp_path / "detection.csv")
    assert back["let_mapl"].tolist() == pytest.approx(table["let_mapl"].tolist(), nan_ok=True)
    words = (tmp_path / "detection.md").read_text()
    assert "| recorded + Geo-EVS | 45 | lidar training | 35.9 | 100.0" in words
    assert "| *recorded + Mean colour* |" in words
    assert "LET-mAPL ↑ paper" in words
    header = next(line for line in words.splitlines() if "LET-ap vehicle" in line)
    assert "LET-aph pedestrian" in header
    assert "LET-mapl to 30m" in header
    assert "cyclist" not in header
    assert (tmp_path / "detection.tex").read_text().count(r"\midrule") >= 2
    points = chart_points(table)
    assert set(points["setting"]) == {"blind", "native", "longer", "augmented", "with-geo-evs"}
    write_detection_chart(tmp_path / "chart", table)
    assert (tmp_path / "chart.png").stat().st_size > 1000


def task_frame(label, offset, scene, value, count, seed=0, reason=""):
    row = {"label": label, "scene": scene, "seed": seed, "frame": 0, "offset": float(offset)}
    return row | {"metric": "nta_iou", "value": value, "count": count, "reason": reason}


def test_task_metrics_are_means_over_vehicles(tmp_path):
    rows = pd.DataFrame(
        [
            task_frame(RECORDED, 0, "d/a", 3.0, 4),
            task_frame(RECORDED, 0, "d/b", 0.0, 1),
            task_frame("geo-evs", -1, "d/a", 1.0, 4),
            task_frame("geo-evs", -1, "d/b", 1.0, 1),
            task_frame("geo-evs", 1, "d/a", 1.0, 4),
            task_frame("geo-evs", 1, "d/b", np.nan, 0, reason="no picture"),
        ]
    ).astype(TASK_TYPES)
    table = task_table(rows, SETTINGS, ENTRIES, WHO).set_index(["label", "offset"])
    recorded = table.loc[RECORDED, 0.0]
    assert (recorded["nta_iou"], recorded["vehicles"], recorded["frames"]) == (60, 5, 2)
    assert (recorded["nta_iou_low"], recorded["nta_iou_high"]) == (0, 75)
    assert table.loc[("geo-evs", -1.0), "nta_iou"] == 40
    failed = table.loc["geo-evs", 1.0]
    assert failed["note"] == "1 of 2 frames failed: no picture"
    assert math.isnan(failed["nta_iou"])
    write_task_offsets(tmp_path / "task_offsets", table.reset_index())
    words = (tmp_path / "task_offsets.md").read_text()
    assert "| pictures | needs | -1 m | 0 | +1 m |" in words
