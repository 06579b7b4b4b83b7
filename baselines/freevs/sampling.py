"""How clips are sampled, as settings: they are checked without a network."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from geoevs.core.settings import Above, AtLeast, Count, check_fields

SIGMA_MIN, RHO = 0.002, 7.0
"""EDM's least noise before zero, and the exponent that spaces its steps, as Stable Video
Diffusion's."""

Guidance = Annotated[float, AtLeast(0)]
SigmaMax = Annotated[float, Above(SIGMA_MIN)]


@dataclass(frozen=True)
class Sampling:
    """Settings by which a clip is sampled.

    Args:
        steps: of denoising.
        guidance: scale of classifier-free guidance; at 1 nothing is sampled without its condition.
        sigma_max: standard deviation of the noise that sampling starts from.
        average: samples whose mean is shown; the mean of several is nearer to the truth than any.

    Raises:
        GeoEvsError: a number is out of range.
    """

    steps: Count = 25
    guidance: Guidance = 2.0
    sigma_max: SigmaMax = 700.0
    average: Count = 1

    def __post_init__(self) -> None:
        check_fields("sampling", self)

    def sigmas(self) -> list[float]:
        """The noise before each step, and zero after the last (Karras et al. 2022, equation 5)."""
        shares = np.linspace(0, 1, self.steps)
        high, low = self.sigma_max ** (1 / RHO), SIGMA_MIN ** (1 / RHO)
        return [*((high + shares * (low - high)) ** RHO).tolist(), 0.0]
