"""Second attempts: after faults of the machine, and with other limits; then no more."""

import json

import pytest

from geoevs.core.attempts import attempt_after, next_attempt

LIMITS = {"fit": 10, "render": 10, "training": None}


def outcome(attempt, **more):
    return {"status": "failed", "stage": "fit", "attempt": attempt, **more}


@pytest.fixture
def asked(tmp_path):
    """The attempt that a file with these outcomes asks for."""

    def of(*outcomes, limits=LIMITS, **by_sources):
        files = [tmp_path / f"{number}.json" for number in range(len(outcomes))]
        for file, one in zip(files, outcomes, strict=True):
            file.write_text(json.dumps(one))
        (tmp_path / "fit.json").write_text(json.dumps(by_sources))
        return next_attempt([*files, tmp_path / "fit.json"], limits)

    return of


def test_a_fault_of_the_machine_has_one_more_attempt(asked):
    def ends(told, machine_fault):
        """What the next attempt is told, and whether there is one without other cause."""
        after = asked(outcome(attempt_after(told, machine_fault)))
        return after, after // 2 != told // 2

    told, again = ends(asked(), machine_fault=True)
    assert again
    assert not ends(told, machine_fault=True)[1]  # the second in succession stays
    told, again = ends(told, machine_fault=False)
    assert not again
    told, again = ends(told, machine_fault=True)  # long after, when something else had changed
    assert again
    told, again = ends(told, machine_fault=True)
    assert not again
    assert not ends(told, machine_fault=True)[1]  # and by force
    told, again = ends(told, machine_fault=False)
    assert not again
    assert not ends(told, machine_fault=False)[1]


def test_one_of_several_outcomes_is_enough(asked):
    assert asked(a=outcome(0), b=outcome(3)) == 3
    assert asked(outcome(0), outcome(3)) == 3
    assert asked(a=outcome(0), b=outcome(0)) == 0


def test_another_limit_concerns_what_ran_into_the_one_before(asked):
    hung = outcome(0, limit=5)
    again = asked(hung)
    assert again // 2 != 0
    assert asked(outcome(again, limit=10)) == again  # it hung again: that is all
    assert asked({**outcome(again), "status": "ok"}) == again
    assert asked(outcome(0, limit=10)) == 0
    assert asked(outcome(0, limit=10), limits={**LIMITS, "fit": None}) != 0
    assert asked(outcome(0), limits={**LIMITS, "fit": None}) == 0


@pytest.mark.parametrize(
    "text", ["", "[]", "{", "3", '{"attempt": "1"}', '{"a": {"attempt": true}}']
)
def test_what_is_no_outcome_asks_for_nothing(tmp_path, text):
    (tmp_path / "fit.json").write_text(text)
    assert next_attempt([tmp_path / "fit.json", tmp_path / "missing", tmp_path], LIMITS) == 0
