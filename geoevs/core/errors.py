"""The one error a user can mend, why anything failed, and the word that was probably meant."""

import difflib
from collections.abc import Iterable

from geoevs.core.text import clean

MOST_CHOICES = 50
"""Allowed words that a sentence lists."""


class GeoEvsError(Exception):
    """Bad input or configuration. Its text is one sentence that names the culprit and the fix."""


def reason_of(error: BaseException) -> str:
    """The reason of a failure in one line: a GeoEvsError's sentence, or the type and its message.

    >>> reason_of(ValueError("two" + chr(10) + "lines"))
    'ValueError: two lines'
    """
    try:
        message = clean(str(error)) or "no message"
    except Exception:  # a stranger's __str__
        message = "no message"
    return message if isinstance(error, GeoEvsError) else f"{type(error).__name__}: {message}"


def did_you_mean(word: str, allowed: Iterable[str]) -> str:
    """The tail of an error sentence: the nearest allowed word, and all of them.

    >>> did_you_mean("strete", ["pandaset", "street"])
    "did you mean 'street'? (one of: pandaset, street)"
    """
    allowed = sorted(allowed)
    nearest = difflib.get_close_matches(word[:100], allowed, n=1, cutoff=0.5)
    more = f" and {len(allowed) - MOST_CHOICES} more" if len(allowed) > MOST_CHOICES else ""
    choices = f"one of: {', '.join(allowed[:MOST_CHOICES])}{more}"
    return f"did you mean '{nearest[0]}'? ({choices})" if nearest else choices
