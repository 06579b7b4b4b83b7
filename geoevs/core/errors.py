"""The one error a user can mend, and the word they probably meant."""

import difflib
from collections.abc import Iterable


class GeoEvsError(Exception):
    """Bad input or configuration. Its text is one sentence that names the culprit and the fix."""


def did_you_mean(word: str, allowed: Iterable[str]) -> str:
    """The tail of an error sentence: the nearest allowed word, and all of them.

    >>> did_you_mean("strete", ["pandaset", "street"])
    "did you mean 'street'? (one of: pandaset, street)"
    """
    allowed = sorted(allowed)
    nearest = difflib.get_close_matches(word, allowed, n=1, cutoff=0.5)
    choices = f"one of: {', '.join(allowed)}"
    return f"did you mean '{nearest[0]}'? ({choices})" if nearest else choices
