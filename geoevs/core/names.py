"""Names and paths that stand in files: none may lead out of the folder that it is joined to."""

import os
import re
from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.core.text import clean

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+~=-]*", re.ASCII)
LONGEST_NAME = 100
NAME_RULE = (
    f"letters, digits and `_ . + ~ = -`, no dot or dash first, at most {LONGEST_NAME} characters"
)
"""What a name in a file may be, in words."""


def check_name(name: Any, what: str, file: Path | str) -> str:
    """A name that is one part of a path, as it stands in a file of a run or of a scene.

    Args:
        name: what stands there; anything that a file can hold.
        what: it names, such as `camera`, for errors.
        file: where it stands, for errors.

    Raises:
        GeoEvsError: it is no text of NAME_RULE, so that it could leave its folder.
    """
    if not isinstance(name, str) or len(name) > LONGEST_NAME or not NAME.fullmatch(name):
        shown = clean(str(name), 60)
        raise GeoEvsError(f"{file}: {what} '{shown}' is not an allowed name; use {NAME_RULE}")
    return name


def expanded(path: str) -> Path:
    """A path that a config names: as it stands if there is such a one, else with `~` and `$NAME`.

    So a folder that is really called `a$HOME` is found, and a variable that is empty or unknown
    becomes no other folder.
    """
    if os.path.exists(path):
        return Path(path)
    return Path(os.path.expanduser(os.path.expandvars(path)) or path)


def inside(folder: Path, path: Any, file: Path | str) -> Path:
    """A relative path that stands in a file, joined to its folder; links are followed.

    Args:
        folder: which it must not leave.
        path: as it stands in the file.
        file: where it stands, for errors.

    Raises:
        GeoEvsError: it is no text, or leads out of the folder.
    """
    folder = Path(folder)
    shown = clean(str(path), 60)
    if not isinstance(path, str) or "\0" in path:
        raise GeoEvsError(f"{file}: '{shown}' is no path; write one relative to {folder}")
    joined = folder / path
    if not joined.resolve().is_relative_to(folder.resolve()):
        raise GeoEvsError(
            f"{file}: '{shown}' leads out of {folder}; put the file there and name it so"
        )
    return joined
