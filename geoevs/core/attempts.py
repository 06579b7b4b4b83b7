"""How often a step was tried, so that a fault of the machine is no method's fault for ever.

An outcome on disk has the number of its `attempt`. The step is told that number when it runs again,
and runs again when half of it, rounded down, is another than the last time. An odd number says that
the last try ended by a fault of the machine. So the first such fault writes the next odd number but
one, which is tried again; one that follows it writes the number that it was told, which is not; and
any other end writes the even number below, after which a fault is a first one again.
A step that ran out of time is tried again when its limit has changed.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any


def next_attempt(files: Iterable[Path], limits: Mapping[str, float | None]) -> int:
    """The number that a step is told by the outcomes on disk; another half of it is a rerun.

    Args:
        files: with outcomes; missing and damaged ones count as none.
        limits: the config's `budget.limits`.
    """
    outcomes = [outcome for file in files for outcome in _outcomes(file)]
    attempt = max((outcome["attempt"] for outcome in outcomes), default=0)
    changed = any(
        "limit" in outcome and outcome["limit"] != limits.get(outcome.get("stage"))
        for outcome in outcomes
    )
    return attempt + 2 if changed else attempt


def attempt_after(attempt: int, machine_fault: bool) -> int:
    """The number that a step writes which was told `attempt`.

    >>> attempt_after(0, False), attempt_after(0, True), attempt_after(3, True)
    (0, 3, 3)
    >>> attempt_after(3, False), attempt_after(2, True)
    (2, 5)
    """
    if not machine_fault:
        return attempt - attempt % 2
    return attempt if attempt % 2 else attempt + 3


def attempt_file(out: Path) -> Path:
    """Where the number of a step's attempt stands whose output is one file, and no outcome."""
    return out.with_name(f"{out.name}.attempt.json")


def _outcomes(file: Path) -> Iterator[dict[str, Any]]:
    """The outcomes in a file: it is one itself, or has one for each set of sources."""
    try:
        told = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return
    if isinstance(told, dict):
        for outcome in (told, *told.values()):
            if isinstance(outcome, dict) and type(outcome.get("attempt")) is int:
                yield outcome
