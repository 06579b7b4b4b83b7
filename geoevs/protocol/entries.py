"""The entrants of a run, and how one of their steps can end."""

from dataclasses import dataclass, field
from typing import Any

REFERENCE = "reference"
"""The control that copies the reference. No adapter can see it, so it is none (see oracle)."""

OK, EMPTY_MASK, FAILED = "ok", "empty-mask", "failed"


@dataclass(frozen=True)
class MethodEntry:
    """One entrant of a run: a method, what it is called, its options and its seed."""

    method: str
    variant: str = "default"
    options: dict[str, Any] = field(default_factory=dict)
    seed: int = 0

    @property
    def label(self) -> str:
        """Its name in paths and tables: the method, then what differs from the default."""
        parts = [self.method]
        if self.variant != "default":
            parts.append(self.variant)
        if self.seed != 0:
            parts.append(f"seed{self.seed}")
        return ".".join(parts)

    @classmethod
    def parse(cls, name: str, options: dict[str, Any], seed: int) -> "MethodEntry":
        """An entry from its name in the config, `METHOD` or `METHOD.VARIANT`."""
        method, _, variant = name.partition(".")
        return cls(method, variant or "default", options, seed)
