"""What a training left behind, as methods that take its weights find it."""

from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import link_file, read_json

FAILURE_FILE = "failure.json"
"""The file that says why a training failed; it lies in place of the networks."""

SECONDS_FILE = "seconds.json"
"""The file that says how long networks in a folder were trained, by training."""

ATTEMPT_FILE = "attempt.json"
"""The file of a training that was tried again: which attempt it was (see `core.attempts`)."""

UNCOUNTED_FILES = (SECONDS_FILE, ATTEMPT_FILE)
"""Files beside networks that are no part of a model's size: they differ from run to run."""

GEOMETRY_FILE = "geometry.safetensors"
"""The file of the depth network's weights, beside networks that learned from its depth."""


def read_trained(folder: Path) -> dict[str, Any]:
    """The settings beside a training's networks.

    Raises:
        GeoEvsError: it failed, and the sentence has its reason; or the settings are missing.
    """
    failure = folder / FAILURE_FILE
    if failure.exists():
        raise GeoEvsError(f"its training failed: {read_json(failure)['reason']}")
    return read_json(folder / "settings.json")


def seconds_file(networks: Path) -> Path:
    """The path of the file that says how long networks, a folder or one file, were trained.

    It lies beside them and not in their settings, because no two trainings share it.
    """
    return networks / SECONDS_FILE if networks.is_dir() else networks.with_suffix(".seconds.json")


def trained_seconds(networks: Path) -> float | None:
    """Wall seconds of all trainings that made networks; None where nothing says so."""
    path = seconds_file(networks)
    return sum(read_json(path).values()) if path.exists() else None


def link_trained(folder: Path, copy: Path) -> None:
    """Give a training's files second names in another folder: many scenes share its weights."""
    for path in folder.iterdir():
        if path.is_file():
            link_file(path, copy / path.name)
