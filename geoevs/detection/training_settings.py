"""The settings that detectors are trained and tested in: which pictures they see, and for how long.

All but LONGER take equal steps.
"""

from collections.abc import Sequence

BLIND, NATIVE, LONGER, AUGMENTED = "blind", "native", "longer", "augmented"
"""Grey pictures; the recorded ones; these for as long as steps with generated views take; these,
mirrored and jittered."""

RECORDED = (BLIND, NATIVE, LONGER, AUGMENTED)
"""Settings without generated views."""

WITH = "with-"
"""Before an entrant's label: the recorded pictures and its views between them."""


def settings_with(labels: Sequence[str]) -> list[str]:
    """All settings of a run, by the labels of its entrants.

    >>> settings_with(["geo-evs"])
    ['blind', 'native', 'longer', 'augmented', 'with-geo-evs']
    """
    return [*RECORDED, *(f"{WITH}{label}" for label in labels)]


def views_label(setting: str) -> str | None:
    """The entrant whose views a setting has; None of those without.

    >>> views_label("with-geo-evs.wide"), views_label("blind")
    ('geo-evs.wide', None)
    """
    return setting.removeprefix(WITH) if setting.startswith(WITH) else None
