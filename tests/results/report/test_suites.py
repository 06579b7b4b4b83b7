"""What the audit and the stability suite say in words, on tables made by hand."""

import math

import pandas as pd
import pytest

from geoevs.core.files import write_text
from geoevs.results.audit import AGREEMENT_COLUMNS
from geoevs.results.report.suites import summarise_suites

AGREEMENT = {"dataset": "d", "metric": "sparse_psnr", "share": 1.0, "support": 0.06, "bias": -1.25}
AGREEMENT |= {"tau": 0.9, "tau_low": 0.82, "tau_high": 1.0, "gap": 2.04, "entrants": 4}
LEVELS = {"support": ["clean", "0.1", "0.05", "0.01"], "yaw": ["0", "45"]}


def write_agreement(run, *rows):
    table = pd.DataFrame([AGREEMENT | row for row in rows], columns=AGREEMENT_COLUMNS)
    write_text(run / "audit/agreement.csv", table.to_csv(index=False))


def write_stability(run, broken):
    """Curves without values, and where each method breaks under support and yaw."""
    key = {"dataset": "d", "variant": "default", "metric": "psnr"}
    points, curves = [], []
    for method, levels in broken.items():
        for (stressor, all_levels), level in zip(LEVELS.items(), levels, strict=True):
            mine = {**key, "method": method, "stressor": stressor}
            points.append({**mine, "level": level, "name": method.title()})
            numbers = [math.nan if one == "clean" else float(one) for one in all_levels]
            curves += [{**mine, "level": number} for number in numbers]
    for name, rows in (("breaking_points", points), ("stability", curves)):
        write_text(run / f"stability/{name}.csv", pd.DataFrame(rows).to_csv(index=False))


def test_a_run_without_them_says_nothing(tmp_path):
    assert summarise_suites(tmp_path) == []


def test_it_says_when_sparse_psnr_can_be_trusted(tmp_path):
    write_agreement(tmp_path, {}, {"share": 0.5, "gap": 9.0}, {"metric": "sparse_ssim", "gap": 8})
    gap, rank = summarise_suites(tmp_path)
    assert gap.startswith("On d, entrants whose sparse PSNR in one frame differs by 2.0 dB or more")
    assert "sparse PSNR ranks 4 entrants as dense PSNR does (Kendall's tau 0.90 [0.82, " in rank
    assert "its level is -1.25 dB from dense PSNR's" in rank


def test_it_says_where_it_cannot(tmp_path):
    write_agreement(tmp_path, {"tau_low": 0.79, "gap": math.nan})
    gap, rank = summarise_suites(tmp_path)
    assert gap.startswith("On d, no difference in sparse PSNR in one frame is surely in the order")
    assert "sparse PSNR does not surely rank 4 entrants" in rank


def test_data_without_truth_has_no_verdict(tmp_path):
    write_agreement(tmp_path)
    assert summarise_suites(tmp_path) == []


def test_it_says_who_breaks_first_and_last(tmp_path):
    broken = {"late": ("none", "45"), "middle": ("0.05", "45")}
    broken |= {"early": ("clean", "0"), "too-early": ("clean", "0")}
    write_stability(tmp_path, broken)
    (sentence,) = summarise_suites(tmp_path)
    # Under support all of 4 levels, under yaw 1 of 2.
    assert "the best control: Late, after 75 % of the levels (mean of 2 stressors)" in sentence
    assert ", and never under support; the first: Early, Too-Early, after 0 %;" in sentence


@pytest.mark.parametrize(
    ("level", "share", "never"),
    [("clean", 0, False), ("0.1", 12, False), ("0.01", 38, False), ("none", 50, True)],
)
def test_one_method_is_compared_with_nobody(tmp_path, level, share, never):
    write_stability(tmp_path, {"mine": (level, "0")})
    (sentence,) = summarise_suites(tmp_path)
    assert f"Mine, after {share} % of the levels" in sentence
    assert "the first" not in sentence
    assert ("never under support" in sentence) == never


def test_a_stressor_that_no_control_could_judge_counts_for_nobody(tmp_path):
    write_stability(tmp_path, {"mine": ("", "45"), "other": ("", "0")})
    (sentence,) = summarise_suites(tmp_path)
    assert "the best control: Mine, after 50 % of the levels (mean of 1 stressors)" in sentence


def write_detection(run, *settings, offsets=((0, "recorded", 40.0), (-3, "Mine", 30.0))):
    """Table 3 of some settings, each (name, LET-mAPL, gain, its ends), and task metrics."""
    rows = []
    for name, value, *gain in settings:
        recorded = not name.startswith("with-")
        row = {"setting": name, "name": name if recorded else "recorded + Mine", "failed": 0}
        row |= {"group": "recorded" if recorded else "generated", "views": 5 if recorded else 45}
        row |= {"truths": 99, "seeds": 3, "note": ""}
        ends = ("", "_low", "_high")
        row |= {f"let_mapl{end}": value + step for end, step in zip(ends, (0, -1, 1), strict=True)}
        row |= dict(
            zip((f"let_mapl_gain{end}" for end in ends), gain or [math.nan] * 3, strict=True)
        )
        rows.append(row)
    write_text(run / "tables/detection.csv", pd.DataFrame(rows).to_csv(index=False))
    task = [{"offset": metres, "name": name, "nta_iou": value} for metres, name, value in offsets]
    write_text(run / "tables/task_offsets.csv", pd.DataFrame(task).to_csv(index=False))


def test_it_says_whether_generated_views_help(tmp_path):
    write_detection(tmp_path, ("blind", 2.0), ("native", 12.0), ("with-mine", 14.0, 2.0, -0.5, 4.5))
    native, views, moved = summarise_suites(tmp_path)
    assert "has LET-mAPL 12.0 [11.0, 13.0] percent, 2.0 if it sees grey pictures alone" in native
    assert "With Mine in 40 more views it changes by +2.0 [-0.5, +4.5]: no more than" in views
    assert moved.endswith("NTA-IoU of 40.0 percent on recorded pictures; from 3 m aside, 30.0 on "
                          "pictures of Mine.")  # fmt: skip
    write_detection(
        tmp_path, ("blind", 2.0), ("native", 12.0), ("with-mine", 9.0, -3.0, -4.0, -2.0)
    )
    assert "by -3.0 [-4.0, -2.0]: more than chance" in summarise_suites(tmp_path)[1]


def test_it_says_that_nobody_learned(tmp_path):
    write_detection(tmp_path, ("blind", 2.0), ("native", 12.0), offsets=[(-3, "Mine", math.nan)])
    assert len(summarise_suites(tmp_path)) == 1
    table = pd.read_csv(tmp_path / "tables/detection.csv").assign(failed=3, note="loss is nan")
    write_text(tmp_path / "tables/detection.csv", table.to_csv(index=False))
    (sentence,) = summarise_suites(tmp_path)
    assert sentence == (
        "No detector of the recorded views could be trained: loss is nan; see Detection."
    )
