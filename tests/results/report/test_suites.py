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
