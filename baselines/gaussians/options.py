"""What options of methods of Gaussians may be, for configs, which are checked without torch."""

from typing import Annotated

from geoevs.core.settings import OneOf

FEWEST = 100
"""Gaussians of a background, and points that a source of them must give: fewer leave most of a
scene without any to grow from, or, where those in boxes are left out, none at all."""

STRATEGIES = ("mcmc", "gradient")

Densification = Annotated[str, OneOf(STRATEGIES)]
