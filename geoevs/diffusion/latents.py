"""Latents of many images, and the loss of denoising them (paper section 3.3)."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from geoevs.core.mapped import Stack
from geoevs.core.networks import mixed_precision
from geoevs.core.randomness import Rng
from geoevs.diffusion.autoencoder import Autoencoder, to_tensor
from geoevs.diffusion.denoiser import Denoiser
from geoevs.diffusion.process import Diffusion

ENCODED_AT_ONCE = 32


def denoising_losses(
    denoiser: Denoiser,
    diffusion: Diffusion,
    clean: Tensor,  # [B, L, h, w]
    features: Tensor | None,  # [B, C, h, w]
    choices: Tensor,  # [K] int64
    rng: Rng,
) -> Tensor:
    """[B] squared errors of one prediction at one timestep of `choices` each (section 3.3)."""
    noise = torch.randn(clean.shape, generator=rng.torch).to(clean.device)
    picked = torch.randint(len(choices), (len(clean),), generator=rng.torch)
    timesteps = choices[picked].to(clean.device)
    noisy, wanted = diffusion.noisy(clean, noise, timesteps)
    with mixed_precision(clean.device):
        predicted = denoiser(noisy, timesteps, features)
    return (predicted.float() - wanted).square().mean(dim=(1, 2, 3))


def encode_images(
    autoencoder: Autoencoder,
    images: np.ndarray | Stack,  # [N, H, W, 3] uint8
) -> Tensor:
    """[N, L, h, w] latents of all images, for a training that sees them at many steps."""
    device = next(autoencoder.parameters()).device
    return encode_in_parts(
        lambda part: autoencoder.encode(to_tensor(images[part]).to(device)), len(images), device
    )


@torch.no_grad()
def encode_in_parts(encode: Callable[[slice], Tensor], count: int, device: torch.device) -> Tensor:
    """(count, ...) what `encode` gives for `count` samples, asked for a few at once."""
    parts = []
    for start in range(0, count, ENCODED_AT_ONCE):
        with mixed_precision(device):
            parts.append(encode(slice(start, start + ENCODED_AT_ONCE)).float())
    return torch.cat(parts)
