"""Where in a run's config a mistake stands: the last file that sets a key, and the line."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import yaml

from geoevs.config.files import KIND, MERGE, read_nodes
from geoevs.core.errors import GeoEvsError
from geoevs.core.settings import SettingError

Key = tuple[str | int, ...]


@dataclass(frozen=True)
class ConfigFile:
    """A config file and its sections."""

    path: Path
    root: yaml.MappingNode

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read and check a file (see `read_nodes`)."""
        return cls(path, read_nodes(path))


Origin = ConfigFile | Mapping[str, Any]
"""A config file, or the values that `--config` gave."""

COMMAND_LINE = "--config"
"""The place of what the command line gave."""


def merge_order(own: Sequence[str | Path], given: Sequence[str | Path]) -> list[Path]:
    """The files that Snakemake merges to one config, later ones winning.

    A file that is named twice has the last place alone. Files below the current folder are named
    from there.

    Args:
        own: those that the Snakefile names.
        given: those behind `--configfile`, which override them.
    """
    here = Path.cwd()
    paths = [(here / path) for path in (*own, *given)]
    last = list(reversed(dict.fromkeys(reversed(paths))))
    return [path.relative_to(here) if path.is_relative_to(here) else path for path in last]


def locate(key: Key, origins: Sequence[Origin]) -> str:
    """`FILE:LINE` of a key in the last origin that sets it, else the name of the first alone.

    Args:
        key: names of sections and, in lists, numbers.
        origins: what the config was merged from, later ones winning.
    """
    place = _place(key, origins)
    if place is not None or not origins:
        return place or "config"
    first = origins[0]
    return str(first.path) if isinstance(first, ConfigFile) else COMMAND_LINE


@contextmanager
def located(key: Key, origins: Sequence[Origin]) -> Iterator[None]:
    """Put the place of `key` before the sentence of a mistake found in the block.

    A mistake in a setting stands below that key (see SettingError). Where the key is missing, the
    place is that of the section which it is missing from.
    """
    try:
        yield
    except GeoEvsError as mistake:
        inner = mistake.key if isinstance(mistake, SettingError) else ()
        whole = (*key, *inner)
        shorter = (whole[:length] for length in range(len(whole), 0, -1))
        found = (_place(part, origins) for part in shorter)
        place = next((place for place in found if place), None) or locate(key, origins)
        raise GeoEvsError(f"{place}: {mistake}") from mistake


def _place(key: Key, origins: Sequence[Origin]) -> str | None:
    for origin in reversed(origins):
        if not isinstance(origin, ConfigFile):
            if _given(origin, key):
                return COMMAND_LINE
        elif (line := _line_of(origin.root, key)) is not None:
            return f"{origin.path}:{line}"
    return None


def _given(values: Any, key: Key) -> bool:
    """Whether values have a key of their own; a list's items are its own."""
    for part in key:
        if isinstance(values, list):
            return True
        if not isinstance(values, Mapping) or part not in values:
            return False
        values = values[part]
    return bool(key)


def _line_of(node: yaml.Node, key: Key) -> int | None:
    line = None
    for part in key:
        found = _child(node, part)
        if found is None:
            return None
        line, node = found
    return line


def _child(node: yaml.Node, part: str | int) -> tuple[int, yaml.Node] | None:
    """The line and the value of a key or of a list's item; a section's own keys before merged."""
    if isinstance(node, yaml.SequenceNode):
        inside = isinstance(part, int) and part < len(node.value)
        return (node.value[part].start_mark.line + 1, node.value[part]) if inside else None
    if not isinstance(node, yaml.MappingNode):
        return None
    for name, value in node.value:
        if name.tag == f"{KIND}str" and name.value == str(part):
            return name.start_mark.line + 1, value
    for name, value in node.value:
        if name.tag == MERGE:
            sections = value.value if isinstance(value, yaml.SequenceNode) else [value]
            for section in sections:
                if found := _child(section, part):
                    return found
    return None
