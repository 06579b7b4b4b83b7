"""How a detector's training or test ended, and what it took."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json
from geoevs.core.text import clean

OUTCOME = "outcome.json"


@dataclass(frozen=True)
class Outcome:
    """What stands in OUTCOME of a detector's folder, and of its predictions'.

    Args:
        reason: why there is no detector, or no prediction; empty if all went well.
        log: where more stands of that.
        views: pictures of a frame.
        frames: that were learned from, or tested on.
        training_seconds: of wall time, of encoder and decoder alone.
        detect_seconds: a frame.
        render_seconds: a frame, of an entrant's views; its fit is a part of it, shared by the
            scene's frames.
    """

    reason: str = ""
    log: str = ""
    views: int = 0
    frames: int = 0
    training_seconds: float = 0.0
    detect_seconds: float = 0.0
    render_seconds: float = 0.0

    def write(self, folder: Path) -> None:
        """Write it into a detector's folder, or its predictions'."""
        write_json(folder / OUTCOME, asdict(self))

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The one that lies in a folder.

        Raises:
            GeoEvsError: there is none, or it is another thing.
        """
        path = folder / OUTCOME
        found = read_json(path)
        kinds = {field.name: field.type for field in fields(cls)}
        if not isinstance(found, dict) or found.keys() != kinds.keys():
            raise GeoEvsError(f"{path} does not say how a detector ended; delete its folder")
        return cls(**{name: _checked(found[name], kinds[name], path) for name in kinds})


def _checked(value: Any, kind: Any, path: Path) -> Any:
    if kind in (str, "str") and isinstance(value, str):
        return clean(value)
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and value >= 0
    if kind in (str, "str") or not number or value > 1e12:
        raise GeoEvsError(f"{path} has '{clean(str(value), 40)}', which is none; delete its folder")
    return value
