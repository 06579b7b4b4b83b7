"""Scenes that a partition takes from a list file by index, as published splits name them."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import check_file
from geoevs.core.names import expanded
from geoevs.core.text import clean
from geoevs.scenes.scene import SceneRef

MOST_BYTES = 1_000_000
"""Of a list file: 10,000 names of 100 characters."""

INDEX_RANGE = re.compile(r"([0-9]{1,9})\.\.([0-9]{1,9})")


def listed_scenes(entry: Mapping[str, Any]) -> list[str]:
    """The scenes that an entry `{list: FILE, indices: FIRST..LAST}` of a partition stands for.

    A list file has one scene a line, NAME or NAME@FIRST-LAST. Index 0 is its first line. Indices
    are a range, both ends included, or a list of whole numbers. A relative path is taken from where
    the process runs.

    Raises:
        GeoEvsError: the file is missing, too large, no text, or has a line that is no scene; an
            index lies beyond its end; or indices are none, or no rising range.
    """
    path = expanded(entry["list"])
    lines = _read_lines(path)
    indices = _indices(entry["indices"])
    # A range's last one, for a slip of the keyboard makes long ones.
    last = indices[-1] if isinstance(indices, range) else max(indices, default=0)
    if last >= len(lines):
        raise GeoEvsError(
            f"{path} has {len(lines)} scenes, with indices 0 to {len(lines) - 1}, and index {last} "
            "is none of them; correct 'indices'"
        )
    return [_scene(path, index, lines[index]) for index in indices]


def _indices(given: Any) -> Sequence[int]:
    """What `indices` of an entry stands for."""
    if isinstance(given, list):
        return given
    match = INDEX_RANGE.fullmatch(given)
    if match is None or int(match[1]) > int(match[2]):
        raise GeoEvsError(
            f"indices '{clean(given, 40)}' are not of the form FIRST..LAST, such as 0..9, and no "
            "list of whole numbers"
        )
    return range(int(match[1]), int(match[2]) + 1)


def _read_lines(path: Path) -> list[str]:
    size = check_file(path).stat().st_size
    if size > MOST_BYTES:
        raise GeoEvsError(
            f"{path} has {size:,} bytes; a list of scenes has {MOST_BYTES:,} at most, so split it"
        )
    try:
        lines = path.read_bytes().decode("ascii").splitlines()
    except OSError as error:
        raise GeoEvsError(f"{path} cannot be read ({error.strerror}); mend its rights") from error
    except UnicodeDecodeError as error:
        raise GeoEvsError(
            f"{path} is no plain text of scenes, one a line; name a text file"
        ) from error
    if not lines:
        raise GeoEvsError(f"{path} has no scenes; write one a line")
    return lines


def _scene(path: Path, index: int, line: str) -> str:
    try:
        SceneRef.parse(line)
    except GeoEvsError as error:
        raise GeoEvsError(
            f"{path}:{index + 1}: '{clean(line, 60)}' is not of the form NAME or NAME@FIRST-LAST; "
            "write one scene a line"
        ) from error
    return line
