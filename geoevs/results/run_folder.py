"""A run's folder that somebody else may have made: what lies in it, and what only seems to."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from geoevs.core.errors import GeoEvsError
from geoevs.core.names import inside
from geoevs.core.text import printable

LOGS = "logs"

LOG_TAIL = 6000
"""Bytes of a log that a page shows."""


def entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    """All that lies below a folder, at any depth; links are not followed."""
    with os.scandir(folder) as found:
        for entry in sorted(found, key=lambda entry: entry.name):
            yield entry
            if entry.is_dir(follow_symlinks=False):
                yield from entries(Path(entry.path))


def leads_out(entry: os.DirEntry[str], run: Path) -> bool:
    """Whether something in a run is a link to what does not lie in it."""
    if not entry.is_symlink():
        return False
    try:
        return not Path(entry.path).resolve().is_relative_to(run.resolve())
    except (OSError, RuntimeError):  # links that go round in circles
        return True


def refuse_links_out(run: Path, parts: Iterable[Path] | None = None) -> None:
    """Refuse a run whose files lie elsewhere, before they are shown to others as the run's.

    Args:
        run: the run's folder.
        parts: files and folders of it, of which some may be missing; None: all of it.

    Raises:
        GeoEvsError: a link leads out of the run.
    """
    for part in [run] if parts is None else parts:
        out = not part.resolve().is_relative_to(run.resolve())
        below = entries(part) if part.is_dir() and not out else ()
        links = [str(part)] if out else (e.path for e in below if leads_out(e, run))
        for path in links:
            raise GeoEvsError(
                f"{printable(path)} is a link that leads out of the run; put what it names "
                "there, or delete it (what is shown of a run lies in it)"
            )


def log_tail(run: Path, log: str) -> str:
    """The end of a log that a row names, if it lies among the run's logs; else why not, or nothing.

    A run that was moved keeps its logs: only what stands from its folder of logs on counts.

    Args:
        run: the run's folder.
        log: as it stands in the row.
    """
    parts = Path(log).parts
    if LOGS not in parts:
        return "" if not log else "The log lies outside of this run and was not read."
    try:
        after = parts[len(parts) - parts[::-1].index(LOGS) :]
        path = inside(run / LOGS, "/".join(after), run)
    except GeoEvsError:
        return "The log lies outside of this run and was not read."
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - LOG_TAIL))
        lines = file.read(LOG_TAIL).decode("utf-8", errors="replace").splitlines()
    return "".join(f"{printable(line)}\n" for line in lines)
