"""The diffusion process: what is predicted, how noise rises, and how a latent is sampled."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import diffusers
import torch
from torch import Tensor

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.settings import OneOf, check_fields
from geoevs.diffusion.sampling import PREDICTIONS, SAMPLERS, SCHEDULES, TIMESTEPS

LARGEST_LATENT = 10.0  # normalised latents have unit variance


@dataclass(frozen=True)
class Diffusion:
    """A diffusion process over latents, in diffusers' terms (paper section 3.3).

    Args:
        prediction: what the network predicts, one of PREDICTIONS; `epsilon` is the paper's.
        schedule: of the noise, one of SCHEDULES.
        beta_start, beta_end: of the schedules that have them.

    Raises:
        GeoEvsError: there is no such prediction or schedule.
    """

    prediction: Annotated[str, OneOf(PREDICTIONS)] = "v_prediction"
    schedule: Annotated[str, OneOf(SCHEDULES)] = "squaredcos_cap_v2"
    beta_start: float = 0.00085
    beta_end: float = 0.012

    def __post_init__(self) -> None:
        check_fields("the diffusion process", self)

    def scheduler(self, sampler: str = "ddim") -> diffusers.SchedulerMixin:
        """A diffusers scheduler of this process.

        The last timestep is pure noise wherever the prediction can be made from that: sampling
        starts there, and a network that never saw it would have to guess.

        Raises:
            GeoEvsError: there is no such sampler.
        """
        if sampler not in SAMPLERS:
            raise GeoEvsError(f"there is no sampler '{sampler}'; {did_you_mean(sampler, SAMPLERS)}")
        settings = {
            "num_train_timesteps": TIMESTEPS,
            "beta_schedule": self.schedule,
            "beta_start": self.beta_start,
            "beta_end": self.beta_end,
            "prediction_type": self.prediction,
            "timestep_spacing": "trailing",
            "rescale_betas_zero_snr": self.prediction != "epsilon",
        }
        if sampler == "ddim":  # it clips to [-1, 1] by default, which latents exceed
            settings["clip_sample"] = False
        return getattr(diffusers, SAMPLERS[sampler])(**settings)

    @cached_property
    def _noise(self) -> diffusers.SchedulerMixin:
        """What adds noise: the same whichever way it is removed."""
        return self.scheduler()

    def timesteps(self, steps: int, sampler: str) -> Tensor:
        """[steps] int64: the timesteps that sampling visits."""
        scheduler = self.scheduler(sampler)
        scheduler.set_timesteps(steps)
        return scheduler.timesteps.long()

    def noisy(
        self,
        clean: Tensor,  # [B, L, h, w]
        noise: Tensor,  # [B, L, h, w]
        timesteps: Tensor,  # [B] int64
    ) -> tuple[Tensor, Tensor]:
        """z_t, and what the network should predict from it."""
        scheduler = self._noise
        mixed = scheduler.add_noise(clean, noise, timesteps)
        if self.prediction == "epsilon":
            return mixed, noise
        if self.prediction == "sample":
            return mixed, clean
        return mixed, scheduler.get_velocity(clean, noise, timesteps)

    def sample(
        self,
        predict: Callable[[Tensor, Tensor], Tensor],
        noise: Tensor,  # [B, L, h, w]
        steps: int,
        sampler: str = "ddim",
    ) -> Tensor:
        """Denoise pure noise.

        Args:
            predict: the network: ([B, L, h, w] noisy, [] timestep) to the prediction.
            noise: standard normal.
            steps: T of the paper.
            sampler: one of SAMPLERS.

        Returns:
            [B, L, h, w] a clean latent.
        """
        scheduler = self.scheduler(sampler)
        scheduler.set_timesteps(steps, device=noise.device)
        latent = noise * scheduler.init_noise_sigma
        for timestep in scheduler.timesteps:
            shown = scheduler.scale_model_input(latent, timestep)
            predicted = predict(shown, timestep)
            if self.prediction == "epsilon":
                signal = scheduler.alphas_cumprod[int(timestep)].to(noise.device)
                predicted = _bound_clean(predicted, shown, signal)
            latent = scheduler.step(predicted, timestep, latent).prev_sample
        return latent


def _bound_clean(
    noise: Tensor,  # [B, L, h, w] predicted
    noisy: Tensor,  # [B, L, h, w]
    signal: Tensor,  # [] alpha bar, the clean latent's share of the variance
) -> Tensor:
    """The noise prediction nearest to this one whose clean latent is within LARGEST_LATENT.

    Almost pure noise divided by its trace of signal makes a small error a huge latent, from which
    no later step recovers: 0.01 becomes 200 at the last timestep of the cosine schedule.
    """
    share, rest = signal.sqrt(), (1 - signal).sqrt()
    clean = ((noisy - rest * noise) / share).clamp(-LARGEST_LATENT, LARGEST_LATENT)
    return (noisy - share * clean) / rest


def guided(
    predict: Callable[[Tensor, Tensor, Tensor], Tensor],
    features: Tensor,  # [B, C, h, w]
    null: Tensor,  # [1, C, 1, 1]
    scale: float,
) -> Callable[[Tensor, Tensor], Tensor]:
    """Classifier-free guidance (paper section 3.3), its two passes in one batch.

    Args:
        predict: ([B, L, h, w], [B] timesteps, [B, C, h, w] features) to the prediction.
        features: of the condition.
        null: the null condition.
        scale: s_cfg; at 1 the null condition is not asked.
    """
    if scale == 1:
        return lambda noisy, t: predict(noisy, t.expand(len(noisy)), features)
    both = torch.cat([null.expand_as(features), features])

    def with_guidance(noisy: Tensor, timestep: Tensor) -> Tensor:
        twice = predict(torch.cat([noisy, noisy]), timestep.expand(2 * len(noisy)), both)
        without, with_condition = twice.chunk(2)
        return without + scale * (with_condition - without)

    return with_guidance
