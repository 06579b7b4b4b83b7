"""What a file was made with, written into it, so that no other record is needed to tell."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.core.hashes import text_hash

Stamp = Mapping[str, str]
"""Hashes of what a file was made with, by what that is called in a sentence."""

NOTHING: Stamp = MappingProxyType({})
"""The stamp of what nobody is going to check."""

MADE_WITH = "made_with"
"""What a stamp is called in the files that carry one."""


def settings_hash(settings: Any) -> str:
    """Hash of JSON-able settings, the same however their keys are ordered."""
    return text_hash(json.dumps(settings, sort_keys=True))


def check_stamp(path: Path, found: Any, expected: Stamp) -> None:
    """Refuse a file that was made with something else than what is asked for or lies beside it.

    Args:
        path: the file.
        found: the stamp in it; None in files of versions without.
        expected: what it should be made with; other parts of its stamp do not matter.

    Raises:
        GeoEvsError: it was not; the sentence names the first thing that differs.
    """
    if not isinstance(found, dict):
        raise GeoEvsError(
            f"{path} does not say what it was made with; delete it and run again, which makes it"
        )
    for name, value in expected.items():
        if found.get(name) != value:
            raise GeoEvsError(
                f"{path} was made with {'other' if name in found else 'unknown'} {name} than this "
                "run has now; delete it and run again, which makes it and what depends on it"
            )
