"""How latents are diffused and sampled, as settings: they are checked without a network."""

from dataclasses import dataclass
from typing import Annotated

from geoevs.core.settings import AtLeast, Count, OneOf, Within, check_fields

TIMESTEPS = 1000
PREDICTIONS = ("epsilon", "v_prediction", "sample")
SCHEDULES = ("squaredcos_cap_v2", "scaled_linear", "linear")
SAMPLERS = {
    "ddim": "DDIMScheduler",
    "dpm-solver": "DPMSolverMultistepScheduler",
    "euler": "EulerDiscreteScheduler",
}
"""Samplers by name, and diffusers' classes of them."""

Steps = Annotated[int, Within(1, TIMESTEPS)]
Guidance = Annotated[float, AtLeast(0)]
Sampler = Annotated[str, OneOf(SAMPLERS)]


@dataclass(frozen=True)
class Sampling:
    """Settings by which an image is sampled (paper section 4.1).

    Args:
        steps: T, denoising steps.
        guidance: s_cfg.
        sampler: one of SAMPLERS.
        average: samples whose mean is shown; the mean of several is nearer to the truth than any.

    Raises:
        GeoEvsError: a number is out of range, or there is no such sampler.
    """

    steps: Steps = 30
    guidance: Guidance = 1.5
    sampler: Sampler = "ddim"
    average: Count = 1

    def __post_init__(self) -> None:
        check_fields("sampling", self)
