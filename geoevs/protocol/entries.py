"""The entrants of a run, and how one of their steps can end."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json
from geoevs.core.names import check_name
from geoevs.core.splits import PLAIN_SPLITS
from geoevs.methods.contract import DEFAULT, ORACLES
from geoevs.protocol.targets import Target

REFERENCE, TRUTH = ORACLES

FLOOR = "mean-colour"
"""The control that every method should beat; those that do not are flagged."""

OK, EMPTY_MASK, FAILED = "ok", "empty-mask", "failed"

FINE = {"status": OK, "stage": "", "reason": "", "log": ""}
"""The outcome of a step that went well (see `failed`)."""

SPLITS, SPLITS_FILE = "splits", "splits.json"
"""The key of an outcome with the splits that its method takes part in, all where it names none; and
the file where the fit says so."""

OUTCOME = {*FINE, "threads", "peak_memory", "gpu_memory"}
"""Keys that `fit.json` and `render.json` have for every set of sources, besides costs."""

NUMBERS = ("threads", "peak_memory", "gpu_memory", "bytes", "primitives", "parameters", "attempt")
"""Keys of an outcome that count something, besides those that end in `_seconds`."""


@dataclass(frozen=True)
class MethodEntry:
    """One entrant of a run: a method, what it is called, its options and its seed.

    `training` names the training whose weights it takes, as METHOD/VARIANT, with the entrant's
    seed; methods that learn nothing beforehand have none.
    """

    method: str
    variant: str = DEFAULT
    options: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    training: str = ""

    @property
    def name(self) -> str:
        """Its name in the config (see `name_of`)."""
        return name_of(self.method, self.variant)

    @property
    def label(self) -> str:
        """Its name in paths (see `label_of`)."""
        return label_of(self.method, self.variant, self.seed)

    @classmethod
    def parse(
        cls, name: str, options: dict[str, Any], seed: int, training: str = ""
    ) -> "MethodEntry":
        """An entry from its name in the config, `METHOD` or `METHOD.VARIANT`."""
        method, _, variant = name.partition(".")
        return cls(method, variant or DEFAULT, options, seed, training)


def name_of(method: str, variant: str = DEFAULT) -> str:
    """An entrant's name in the config, METHOD or METHOD.VARIANT.

    >>> name_of("mine"), name_of("mine", "wide")
    ('mine', 'mine.wide')
    """
    return method if variant == DEFAULT else f"{method}.{variant}"


def label_of(method: str, variant: str = DEFAULT, seed: int = 0) -> str:
    """An entrant's name in paths: that in the config, then the seed unless it is 0.

    >>> label_of("mine", "wide"), label_of("mine", seed=2)
    ('mine.wide', 'mine.seed2')
    """
    name = name_of(method, variant)
    return name if seed == 0 else f"{name}.seed{seed}"


def failed(stage: str, reason: str, log: Path | str) -> dict[str, Any]:
    """The outcome of a step that failed: its stage, the reason in one line, and its log."""
    return {"status": FAILED, "stage": stage, "reason": reason, "log": str(log)}


def read_splits(folder: Path) -> list[str]:
    """The splits that a fit says its method takes part in; none if it said nothing that is one."""
    try:
        return checked_splits(read_json(folder / SPLITS_FILE))
    except GeoEvsError:
        return []


def checked_splits(told: Any) -> list[str]:
    """What a method's process says of its splits; none if something is none."""
    known = isinstance(told, list) and all(name in PLAIN_SPLITS for name in told)
    return told if known else []


def takes_part(outcome: Mapping[str, Any], target: Target) -> bool:
    """Whether a method with this outcome is asked for a target.

    It is not where the target is of no split of its own, or is masked and the method has no
    condition map to mask. A method of which neither is known, as its fit failed, is.
    """
    of_mine = target.unmasked.split in (outcome.get(SPLITS) or PLAIN_SPLITS)
    return of_mine and (not target.masked or outcome.get("masked", True))


def cause(outcome: dict[str, Any]) -> dict[str, Any]:
    """The part of an outcome that rows take: stage, reason and log, all empty if it went well."""
    return {name: outcome[name] for name in ("stage", "reason", "log")}


def read_outcomes(path: Path) -> dict[str, dict[str, Any]]:
    """The outcome of every set of sources, from `fit.json` or `render.json`.

    Raises:
        GeoEvsError: the file is missing or of another shape, or names no set of sources.
    """
    outcomes = read_json(path)
    if not isinstance(outcomes, dict) or not all(map(_is_outcome, outcomes.values())):
        raise GeoEvsError(
            f"{path} does not say how each set of sources ended; delete its folder and rerun"
        )
    for sources in outcomes:
        check_name(sources, "set of sources", path)
    return outcomes


def _is_outcome(outcome: Any) -> bool:
    if not isinstance(outcome, dict) or not outcome.keys() >= OUTCOME:
        return False
    texts = [outcome[name] for name in FINE]
    texts += [outcome.get(name, "") for name in ("note", "host", "cpu")]
    counts = [outcome[name] for name in NUMBERS if name in outcome]
    seconds = [value for name, value in outcome.items() if name.endswith("_seconds")]
    return (
        all(isinstance(text, str) for text in texts)
        and outcome["status"] in (OK, FAILED)
        and all(type(count) is int and 0 <= count < 2**63 for count in counts)
        and all(
            value is None or (type(value) in (int, float) and 0 <= value < 2**63)
            for value in seconds
        )
    )
