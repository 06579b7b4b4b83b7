"""What a training left behind, as methods that take its weights find it."""

import math
from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import link_file, read_json, whole_file
from geoevs.core.text import clean

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
        with whole_file(failure):
            reason = clean(str(read_json(failure)["reason"]))
        raise GeoEvsError(f"its training failed: {reason}")
    settings = read_json(folder / "settings.json")
    if not isinstance(settings, dict):
        raise GeoEvsError(f"{folder / 'settings.json'} holds no settings; train again")
    return settings


def seconds_file(networks: Path) -> Path:
    """The path of the file that says how long networks, a folder or one file, were trained.

    It lies beside them and not in their settings, because no two trainings share it.
    """
    return networks / SECONDS_FILE if networks.is_dir() else networks.with_suffix(".seconds.json")


def trained_seconds(networks: Path) -> float | None:
    """Wall seconds of all trainings that made networks; None where nothing says so."""
    path = seconds_file(networks)
    if not path.exists():
        return None
    with whole_file(path):
        seconds = list(read_json(path).values())
        if not all(type(value) in (int, float) and 0 <= value < 2**63 for value in seconds):
            raise ValueError("it says something else than seconds")
        return math.fsum(seconds)


def link_trained(folder: Path, copy: Path) -> None:
    """Give a training's files second names in another folder: many scenes share its weights."""
    for path in folder.iterdir():
        if path.is_file():
            link_file(path, copy / path.name)
