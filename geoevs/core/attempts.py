"""How often a step was tried, so that a fault of the machine is no method's fault for ever.

An outcome on disk has the number of its `attempt`, which the step was told. A fault of the machine
writes the next odd one instead: the workflow tells the step what the file says, finds another
number than the last time, and runs the step again. Then the number is odd already and stays.
A step that ran out of time is tried again when its limit has changed.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any


def next_attempt(files: Iterable[Path], limits: Mapping[str, float | None]) -> int:
    """The number of the attempt that outcomes on disk ask for; another than theirs is a rerun.

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

    >>> attempt_after(0, False), attempt_after(0, True), attempt_after(1, True)
    (0, 1, 1)
    """
    return attempt | 1 if machine_fault else attempt


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
