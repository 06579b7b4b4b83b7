"""What options of methods of Gaussians may be: checked without torch, before a scene is read."""

from geoevs.core.errors import GeoEvsError, did_you_mean

FEWEST = 100
"""Gaussians of a background, and points that a source of them must give: fewer leave most of a
scene without any to grow from, or, where those in boxes are left out, none at all."""

STRATEGIES = ("mcmc", "gradient")


def check_least(name: str, value: float | None, least: int) -> None:
    """Check an option that is a number, or None for the method's own choice.

    Raises:
        GeoEvsError: the number is lower than `least`.
    """
    if value is not None and not value >= least:
        raise GeoEvsError(f"the option '{name}' is {value}; make it {least} or more")


def check_densification(name: str) -> None:
    """Check the name of a strategy.

    Raises:
        GeoEvsError: there is no such strategy; the sentence names the nearest one.
    """
    if name not in STRATEGIES:
        raise GeoEvsError(f"there is no densification '{name}'; {did_you_mean(name, STRATEGIES)}")
