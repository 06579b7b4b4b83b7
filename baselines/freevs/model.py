"""The trained networks: from pseudo-images of a clip to its views, on disk and off."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
import torch
from diffusers import UNet2DConditionModel
from torch import Tensor

from baselines.freevs.denoiser import ClipDenoiser
from baselines.freevs.encoder import PseudoImageEncoder, filled_latents
from baselines.freevs.sampling import Sampling
from geoevs.core.networks import (
    best_device,
    built_as_described,
    load_weights,
    mixed_precision,
    read_network,
    save_network,
)
from geoevs.diffusion.autoencoder import Autoencoder, to_arrays, to_conditions
from geoevs.diffusion.prior import AUTOENCODER_FILE, load_autoencoder, save_autoencoder
from geoevs.diffusion.process import Diffusion, guided

DENOISER_FILE = "denoiser.safetensors"
REMAKE = "make it again with `geoevs train freevs`"


@dataclass(frozen=True)
class ClipGenerator:
    """An autoencoder and a denoiser of its latents."""

    autoencoder: Autoencoder
    denoiser: ClipDenoiser

    @property
    def middle(self) -> int:
        """The index of the view of a clip that is shown: it has neighbours on both sides."""
        return self.denoiser.frames // 2

    @torch.inference_mode()
    def generate(
        self,
        images: np.ndarray,  # [B * frames, H, W, 3] float32 in [0, 1], zero where invalid
        valid: np.ndarray,  # [B * frames, H, W] bool
        sampling: Sampling,
        random: torch.Generator,
    ) -> np.ndarray:
        """Sample clips; (B, H, W, 3) float32 in [0, 1], the middle view of each.

        Args:
            images: pseudo-images of any size.
            valid: which of their pixels hold a point.
            sampling: steps, guidance, ...
            random: on the CPU, so that every device starts from the same noise.
        """
        device = next(self.denoiser.parameters()).device
        height, width = valid.shape[1:]
        shown, mask = to_conditions(images, valid, self.autoencoder)
        with mixed_precision(device):
            filled = filled_latents(self.autoencoder, shown, mask)
            condition = filled + self.denoiser.encoder(shown, mask).float()
            condition = condition.repeat(sampling.average, 1, 1, 1)
            noise = torch.randn(condition.shape, generator=random).to(device)
            nothing = torch.zeros_like(condition[:1, :, :1, :1])
            predict = guided(self.denoiser, condition, nothing, sampling.guidance)
            latents = sample(predict, noise, sampling)
            decoded = self.autoencoder.decode(latents[self.middle :: self.denoiser.frames])
        views = decoded.float().unflatten(0, (sampling.average, -1)).mean(0)
        return to_arrays(views[..., :height, :width])

    def save(self, folder: Path) -> None:
        """Write both networks into an existing folder."""
        denoiser = self.denoiser
        config = denoiser.unet.config.items()
        settings = {
            "unet": {name: value for name, value in config if not name.startswith("_")},
            "encoder": {name: getattr(denoiser.encoder, name) for name in ("width", "depth")},
            "prior": asdict(denoiser.prior),
            "frames": denoiser.frames,
            "spread": denoiser.spread,
        }
        save_autoencoder(folder / AUTOENCODER_FILE, self.autoencoder)
        save_network(folder / DENOISER_FILE, denoiser, settings)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote, onto the GPU if there is one."""
        device, path = best_device(), folder / DENOISER_FILE
        autoencoder = load_autoencoder(folder / AUTOENCODER_FILE)
        settings, weights = read_network(path)
        with built_as_described(path, REMAKE):
            denoiser = ClipDenoiser(
                UNet2DConditionModel.from_config(settings["unet"]),
                PseudoImageEncoder(
                    autoencoder.factor, autoencoder.latent_channels, **settings["encoder"]
                ),
                Diffusion(**settings["prior"]),
                settings["frames"],
                settings["spread"],
            )
        load_weights(denoiser, weights, path, REMAKE)
        return cls(autoencoder.to(device), denoiser.eval().to(device))


def sample(
    predict: Callable[[Tensor, Tensor], Tensor],
    noise: Tensor,  # [B, L, h, w] standard normal
    sampling: Sampling,
) -> Tensor:
    """[B, L, h, w] a clean latent, by Euler steps along the probability flow (Karras et al. 2022).

    Args:
        predict: ([B, L, h, w] noisy, [] sigma) to the clean latent.
        noise: what it starts from.
        sampling: how.
    """
    sigmas = sampling.sigmas()
    latent = noise * sigmas[0]
    for sigma, following in pairwise(sigmas):
        clean = predict(latent, torch.tensor(sigma, device=noise.device))
        latent = clean + (latent - clean) * (following / sigma)
    return latent
