"""The trained generator G: from a condition map to an image (paper equation 1), on disk and off."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import torch

from geoevs.core.networks import best_device, mixed_precision
from geoevs.diffusion.autoencoder import Autoencoder, to_arrays, to_conditions
from geoevs.diffusion.denoiser import Denoiser
from geoevs.diffusion.prior import (
    AUTOENCODER_FILE,
    load_autoencoder,
    load_denoiser,
    save_autoencoder,
    save_denoiser,
)
from geoevs.diffusion.process import Diffusion, guided
from geoevs.diffusion.sampling import Sampling

DENOISER_FILE = "denoiser.safetensors"


@dataclass(frozen=True)
class Generator:
    """An autoencoder, a denoiser conditioned on geometry, and their diffusion process."""

    autoencoder: Autoencoder
    denoiser: Denoiser
    diffusion: Diffusion

    @torch.inference_mode()
    def generate(
        self,
        conditions: np.ndarray,  # [B, H, W, 3] float32 in [0, 1], zero where invalid
        valid: np.ndarray,  # [B, H, W] bool
        sampling: Sampling,
        random: torch.Generator,
    ) -> np.ndarray:
        """Sample images of any size; (B, H, W, 3) float32 in [0, 1].

        Args:
            conditions: condition maps X, of any size.
            valid: their validity.
            sampling: steps, guidance, ...
            random: on the CPU, so that every device starts from the same noise.
        """
        device = next(self.denoiser.parameters()).device
        height, width = valid.shape[1:]
        shown, mask = to_conditions(conditions, valid, self.autoencoder)
        count = len(conditions) * sampling.average
        with mixed_precision(device):
            features = self.denoiser.features(shown, mask).float()
            features = features.repeat(sampling.average, 1, 1, 1)
            shape = count, self.autoencoder.latent_channels, *features.shape[2:]
            noise = torch.randn(shape, generator=random).to(device)
            predict = guided(
                lambda noisy, t, c: self.denoiser(noisy, t, c).float(),
                features,
                self.denoiser.null,
                sampling.guidance,
            )
            latents = self.diffusion.sample(predict, noise, sampling.steps, sampling.sampler)
            images = self.autoencoder.decode(latents)
        images = images.float().unflatten(0, (sampling.average, len(conditions))).mean(0)
        return to_arrays(images[..., :height, :width])

    def save(self, folder: Path) -> None:
        """Write both networks into an existing folder."""
        save_autoencoder(folder / AUTOENCODER_FILE, self.autoencoder)
        save_denoiser(folder / DENOISER_FILE, self.denoiser, self.diffusion)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote, onto the GPU if there is one."""
        device = best_device()
        autoencoder = load_autoencoder(folder / AUTOENCODER_FILE)
        denoiser, diffusion = load_denoiser(folder / DENOISER_FILE, autoencoder)
        return cls(autoencoder.to(device), denoiser.to(device), diffusion)
