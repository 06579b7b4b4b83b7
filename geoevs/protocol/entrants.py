"""What entrants say of themselves, as data: the judge and the tables import no method."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from geoevs.core.text import clean
from geoevs.methods.contract import CONTROL, ORACLES, MethodInfo
from geoevs.methods.finding import make_method, method_class
from geoevs.protocol.entries import MethodEntry


def describe_entrants(options: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, str]]:
    """The fields of every entrant's MethodInfo as text of one line, words between spaces.

    Args:
        options: of each entrant, by its name in the config, METHOD or METHOD.VARIANT.
    """
    return {name: _as_text(_info(name, own)) for name, own in options.items()}


def _info(name: str, options: Mapping[str, Any]) -> MethodInfo:
    """What an entrant says of itself; the bare name of one that cannot be imported."""
    method = MethodEntry.parse(name, {}, 0).method
    if method in ORACLES:
        return MethodInfo(method.capitalize(), CONTROL, extra_prior="the answer")
    info = MethodInfo(method, paradigm="", extra_prior="", sees="")
    # A method's module may raise anything, or exit: its fits fail and say why.
    with suppress(Exception, SystemExit):
        info = method_class(method).info
        info = make_method(method, dict(options)).info  # which options may change
    return info if isinstance(info, MethodInfo) else MethodInfo(method, "", "", sees="")


def _as_text(info: MethodInfo) -> dict[str, str]:
    return {field: clean(_words(value)) for field, value in vars(info).items()}


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, (tuple, list)) else str(value)
