"""Training the denoiser: the unconditional prior, and Geo-EVS on artifact-injected conditions."""

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.adapter import Rng
from geoevs.conditions.injection import ArtifactInjection
from geoevs.conditions.pairs import Pairs
from geoevs.errors import GeoEvsError, did_you_mean
from geoevs.generator.autoencoder import Autoencoder, random_crops, to_arrays, to_tensor
from geoevs.generator.condition import ConditionEncoder, FrozenEncoder
from geoevs.generator.denoiser import Denoiser, widen
from geoevs.generator.diffusion import TIMESTEPS, Diffusion
from geoevs.generator.generator import Generator, Sampling
from geoevs.generator.prior import Prior
from geoevs.training import mixed_precision

CONDITION_ENCODERS = ("trained", "frozen")
WEIGHTINGS = ("uniform", "support")
ENCODED_AT_ONCE = 32


def denoising_losses(
    denoiser: Denoiser,
    diffusion: Diffusion,
    clean: Tensor,  # [B, L, h, w]
    features: Tensor | None,  # [B, C, h, w]
    rng: Rng,
) -> Tensor:
    """[B] squared errors of one prediction at one random timestep each (paper section 3.3)."""
    noise = torch.randn(clean.shape, generator=rng.torch).to(clean.device)
    timesteps = torch.randint(TIMESTEPS, (len(clean),), generator=rng.torch).to(clean.device)
    noisy, wanted = diffusion.noisy(clean, noise, timesteps)
    with mixed_precision(clean.device):
        predicted = denoiser(noisy, timesteps, features)
    return (predicted.float() - wanted).square().mean(dim=(1, 2, 3))


class PriorTask:
    """Denoise latents of images, unconditionally.

    Args:
        model: a denoiser without a condition encoder.
        autoencoder: frozen.
        diffusion: the process.
        images: (N, H, W, 3) uint8.
        batch: images a step, half of them mirrored.
    """

    def __init__(
        self,
        model: Denoiser,
        autoencoder: Autoencoder,
        diffusion: Diffusion,
        images: np.ndarray,
        batch: int,
    ) -> None:
        self.model, self._images, self._batch = model, images, batch
        self._autoencoder, self._diffusion = autoencoder, diffusion

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """The denoising loss of one batch."""
        device = next(self.model.parameters()).device
        images = random_crops(self._images, self._batch, self._images.shape[1:3], rng.numpy)
        with torch.no_grad(), mixed_precision(device):
            clean = self._autoencoder.encode(images.to(device)).float()
        losses = denoising_losses(self.model, self._diffusion, clean, None, rng)
        return {"loss": losses.mean()}

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """Eight streets that nobody has seen."""
        device = next(model.parameters()).device
        factor = self._autoencoder.factor
        height, width = self._images.shape[1] // factor, self._images.shape[2] // factor
        shape = 8, self._autoencoder.latent_channels, height, width
        noise = torch.randn(shape, generator=torch.Generator().manual_seed(0)).to(device)
        with mixed_precision(device):
            latents = self._diffusion.sample(
                lambda noisy, t: model(noisy, t.expand(len(noisy))).float(), noise, steps=30
            )
            images = to_arrays(self._autoencoder.decode(latents))
        rows = [np.concatenate(list(images[k : k + 4]), axis=1) for k in (0, 4)]
        return np.concatenate(rows)


class GeoEvsTask:
    """Denoise latents of targets Y from condition maps X, some of them artifact-injected.

    Args:
        prior: the weights to start from; its UNet is widened and trained, the rest is frozen.
        pairs: the training set.
        injection: which pixels of a condition are hidden (paper section 3.4).
        batch: pairs a step.
        drop: share of conditions replaced by the null condition.
        encoder: E_geo, `trained` or `frozen`.
        validity: whether the trained encoder sees the validity mask beside X.
        weighting: per-sample weights w_i, `uniform` or `support` (the condition's support ratio
            over the batch's mean).
        rng: initial weights of the condition encoder.

    Raises:
        GeoEvsError: there is no such encoder or weighting, or the images do not divide into
            latents.
    """

    def __init__(
        self,
        prior: Prior,
        pairs: Pairs,
        injection: ArtifactInjection,
        rng: Rng,
        *,
        batch: int,
        drop: float,
        encoder: str,
        validity: bool,
        weighting: str,
    ) -> None:
        for what, value, allowed in (
            ("condition encoder", encoder, CONDITION_ENCODERS),
            ("weighting", weighting, WEIGHTINGS),
        ):
            if value not in allowed:
                raise GeoEvsError(f"there is no {what} '{value}'; {did_you_mean(value, allowed)}")
        self._autoencoder, self._diffusion = (
            prior.autoencoder.requires_grad_(False),
            prior.diffusion,
        )
        self._pairs, self._injection = pairs, injection
        self._batch, self._drop, self._weighting = batch, drop, weighting
        _check_size(pairs.target.shape[1:3], prior)
        self.model = _conditional(prior, encoder, validity, rng)
        self._latents = self._encode(pairs.target)

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """L_train of one batch (paper section 3.3)."""
        device = self._latents.device
        random = rng.numpy
        picked = random.integers(len(self._pairs), size=self._batch)
        valid = self._pairs.valid[picked] & self._injection.inject(random, self._batch)
        dropped = torch.from_numpy(random.random(self._batch) < self._drop).to(device)
        condition = to_tensor(self._pairs.rgb[picked] * valid[..., None]).to(device)
        mask = torch.from_numpy(valid)[:, None].to(device)
        with mixed_precision(device):
            features = self.model.features(condition, mask, dropped)
        losses = denoising_losses(self.model, self._diffusion, self._latents[picked], features, rng)
        support = mask.float().mean(dim=(1, 2, 3))
        weights = support / support.mean() if self._weighting == "support" else 1.0
        return {"loss": (weights * losses).mean(), "support": support.mean()}

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """Pairs side by side: condition with a mask of this training's kind, sample, target."""
        picked = np.linspace(0, len(self._pairs) - 1, 6).astype(int)
        keep = self._always_injected().inject(np.random.default_rng(0), len(picked))
        valid = self._pairs.valid[picked] & keep
        condition = self._pairs.rgb[picked].astype(np.float32) / 255 * valid[..., None]
        generator = Generator(self._autoencoder, model, self._diffusion)
        random = torch.Generator().manual_seed(0)
        samples = generator.generate(condition, valid, Sampling(steps=8), random)
        columns = condition, samples, self._pairs.target[picked].astype(np.float32) / 255
        return np.concatenate([np.concatenate(list(column)) for column in columns], axis=1)

    def _always_injected(self) -> ArtifactInjection:
        plain = self._injection
        return ArtifactInjection(plain.kind, 1.0, plain.height, plain.width, plain.library)

    @torch.no_grad()
    def _encode(self, targets: np.ndarray) -> Tensor:
        """[N, L, h, w] latents of all targets, once: they are the same at every step."""
        device = next(self._autoencoder.parameters()).device
        parts = []
        for start in range(0, len(targets), ENCODED_AT_ONCE):
            images = to_tensor(targets[start : start + ENCODED_AT_ONCE]).to(device)
            with mixed_precision(device):
                parts.append(self._autoencoder.encode(images).float())
        return torch.cat(parts)


def _conditional(prior: Prior, encoder: str, validity: bool, rng: Rng) -> Denoiser:
    """The prior's UNet behind a new condition encoder, whose weights come from `rng` alone."""
    if encoder == "frozen":
        made: nn.Module = FrozenEncoder(prior.autoencoder)
        widen(prior.unet, made.channels)
    else:
        with torch.random.fork_rng(devices=()):
            torch.manual_seed(int(rng.numpy.integers(2**62)))
            made = ConditionEncoder(prior.autoencoder.factor, validity=validity)
        widen(prior.unet, made.channels)
    device = next(prior.autoencoder.parameters()).device
    return Denoiser(prior.unet, made).to(device)


def _check_size(size: tuple[int, int], prior: Prior) -> None:
    halvings = len(prior.unet.config.block_out_channels) - 1
    step = prior.autoencoder.factor * 2**halvings
    if size[0] % step or size[1] % step:
        raise GeoEvsError(
            f"images of {size[0]} x {size[1]} do not divide into the denoiser's latents; choose a "
            f"resolution whose sides are multiples of {step}"
        )
