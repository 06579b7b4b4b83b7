"""What options of methods of Gaussians may be, for configs, which are checked without torch."""

from typing import Annotated

from geoevs.core.settings import OneOf

FEWEST = 100
"""Fewest Gaussians of a background, and fewest points that a source of them must give. Fewer leave
most of a scene without any to grow from, or none at all where those in boxes are left out."""

STRATEGIES = ("mcmc", "gradient")

Densification = Annotated[str, OneOf(STRATEGIES)]
