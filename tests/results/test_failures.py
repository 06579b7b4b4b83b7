"""What failed, from cost rows and from the stability suite's score rows."""

import math

import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_bytes
from geoevs.protocol.rows import COST_TYPES, cost_frame
from geoevs.results.failures import fit_failures, known_failures, run_failures, stress_failures

ENDING = {"status": "failed", "stage": "fit", "reason": "no points", "log": "logs/a.log"}


def cost_row(**changes):
    blank = {"string": "", "int64": 0, "float64": math.nan}
    usual = {name: blank[kind] for name, kind in COST_TYPES.items()}
    usual |= {"dataset": "d", "scene": "s", "method": "mine", "variant": "v", "status": "ok"}
    return usual | {"sources": "all-cameras"} | changes


@pytest.fixture
def stressed(rows):
    """Two levels and draws of one stressor that failed alike, one that did not, another reason."""
    return rows(
        {"stressor": "support", "level": 0.1, "seed": 0},
        *[
            {"stressor": "support", "level": level, "seed": draw, "metric": metric, **ENDING}
            for level in (0.05, 0.01)
            for draw in (1, 0)
            for metric in ("psnr", "sparse_psnr")
        ],
        {"stressor": "yaw", "level": 30.0, "seed": 0, **ENDING},
        {"stressor": "yaw", "level": 45.0, "seed": 2, **ENDING, "reason": "no memory"},
    )


def test_a_failed_fit_says_from_what():
    (failure,) = fit_failures(cost_frame([cost_row(), cost_row(**ENDING)]))
    assert (failure.method, failure.variant, failure.stage) == ("mine", "v", "fit")
    assert failure.place == "d/s, from all-cameras"
    assert (failure.reason, failure.log, failure.stressed) == ("no points", "logs/a.log", False)


def test_stresses_that_ended_the_same_way_are_one_failure(stressed):
    first, second = stress_failures(stressed)
    assert first.place == "d/s, stressed by support 0.05, 0.01; yaw 30 (draws 0, 1)"
    assert second.place == "d/s, stressed by yaw 45 (draws 2)"
    assert (first.reason, second.reason) == ("no points", "no memory")
    assert (first.stage, first.log, first.stressed) == ("fit", "logs/a.log", True)


def test_a_run_has_those_of_both(stressed, tmp_path):
    with pytest.raises(GeoEvsError, match=r"costs\.parquet is missing"):
        run_failures(tmp_path)
    costs = cost_frame([cost_row(), cost_row(**ENDING)])
    write_bytes(tmp_path / layout.COSTS, costs.to_parquet(index=False))
    assert [failure.stressed for failure in run_failures(tmp_path)] == [False]
    write_bytes(tmp_path / layout.STABILITY_SCORES, stressed.to_parquet(index=False))
    assert [failure.stressed for failure in run_failures(tmp_path)] == [False, True, True]


def test_before_there_are_rows_there_are_no_failures(stressed, tmp_path):
    costs, stability = tmp_path / "costs.parquet", tmp_path / "stability.parquet"
    assert known_failures(costs, stability) == []
    write_bytes(stability, stressed.to_parquet(index=False))
    first, _ = known_failures(costs, stability)
    assert str(first) == (
        "mine (default) could not fit d/s, stressed by support 0.05, 0.01; yaw 30 (draws 0, 1): "
        "no points; log: logs/a.log"
    )
