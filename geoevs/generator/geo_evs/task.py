"""Training Geo-EVS: denoise targets from artifact-injected conditions (sections 3.3, 3.4)."""

import math
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.conditions.artifact_masks import MaskLibrary
from geoevs.conditions.injection import ArtifactInjection
from geoevs.conditions.pairs import Pairs
from geoevs.core.mapped import Stack, pieces
from geoevs.core.networks import best_device, mixed_precision, seeded
from geoevs.core.optimising import Optimisation, fingerprint, optimise
from geoevs.core.randomness import Rng
from geoevs.diffusion.autoencoder import to_tensor
from geoevs.diffusion.condition_encoder import ConditionEncoder, FrozenEncoder
from geoevs.diffusion.denoiser import Denoiser, conditioned
from geoevs.diffusion.latents import denoising_losses, encode_images, encode_in_parts
from geoevs.diffusion.prior import Prior, load_prior
from geoevs.diffusion.sampling import TIMESTEPS
from geoevs.generator.geo_evs.model import Generator
from geoevs.generator.geo_evs.training import Settings


def train_geo_evs(
    settings: Settings,
    pairs: Pairs,
    library: MaskLibrary,
    weights: Path,
    seed: int,
    work: Path,
    report: Callable[[float], None],
) -> Generator:
    """Train a generator.

    Args:
        settings: how.
        pairs: on what.
        library: artifact masks of training scenes.
        weights: the folder of this suite's pretrained weights.
        seed: decides the condition encoder's first weights and every batch.
        work: the training's own folder (see `optimise`).
        report: called after every step with its loss.

    Raises:
        GeoEvsError: the prior is not on the machine, the images do not divide into latents, or the
            training diverged.
    """
    began = time.monotonic()
    injection = ArtifactInjection(
        settings.masks, settings.probability, *pairs.target.shape[1:3], library
    )
    prior = load_prior(settings.prior, weights)
    changed = {name: getattr(settings, name) for name in ("prediction", "schedule")}
    changed = {name: value for name, value in changed.items() if value is not None}
    prior = replace(prior, diffusion=replace(prior.diffusion, **changed))
    device = best_device()
    prior.autoencoder.to(device)
    task = GeoEvsTask(prior, pairs, injection, settings, seed)
    optimisation = Optimisation(settings.steps, settings.learning_rate)
    model = optimise(task, optimisation, seed, "geo-evs", work, report, began)
    return Generator(prior.autoencoder, model, prior.diffusion)


class GeoEvsTask:
    """Denoise latents of targets Y from condition maps X, some of them artifact-injected.

    Args:
        prior: the weights to start from; its denoiser is widened and trained, the rest is frozen.
        pairs: the training set.
        injection: which pixels of a condition are hidden (paper section 3.4).
        settings: those of the prior and the optimiser do not count here.
        seed: of the condition encoder's first weights.

    Raises:
        GeoEvsError: the images do not divide into latents.
    """

    def __init__(
        self,
        prior: Prior,
        pairs: Pairs,
        injection: ArtifactInjection,
        settings: Settings,
        seed: int,
    ) -> None:
        self._autoencoder = prior.autoencoder.requires_grad_(False)
        self._diffusion = prior.diffusion
        self._pairs, self._injection, self._settings = pairs, injection, settings
        self._sampling = settings.sampling
        self._timesteps = (
            torch.arange(TIMESTEPS)
            if settings.timesteps == "uniform"
            else prior.diffusion.timesteps(self._sampling.steps, self._sampling.sampler)
        )
        self._latents = encode_images(self._autoencoder, pairs.target)
        self.model = _conditional(prior, settings, seed)
        # Those without a mask, most of all that are seen, are the same at every step too.
        self._unmasked = self._condition_latents(pairs.rgb, pairs.valid)
        held = sum(np.count_nonzero(piece) for piece in pieces(pairs.valid))
        self._mean_support = held / math.prod(pairs.valid.shape)
        masks = [] if injection.library is None else [injection.library.packed]
        self.identity = fingerprint(
            asdict(settings), asdict(prior.diffusion), pairs.rgb, pairs.valid, self._latents, *masks
        )

    def batch(self, rng: Rng) -> list[str]:
        """The views whose pairs one batch holds, as scene/camera/frame."""
        pairs = self._pairs
        return [f"{pairs.scene[n]}/{pairs.camera[n]}/{pairs.frame[n]}" for n in self._pick(rng)]

    def _pick(self, rng: Rng) -> np.ndarray:
        return rng.numpy.integers(len(self._pairs), size=self._settings.batch)

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """L_train of one batch (paper section 3.3), and the mean support of its conditions.

        The masks are drawn last, so that trainings which differ in them alone share the rest.
        """
        device, count = self._latents.device, self._settings.batch
        picked = self._pick(rng)
        dropped = torch.from_numpy(rng.numpy.random(count) < self._settings.drop).to(device)
        keep = self._injection.inject(rng.numpy, count)
        valid = self._pairs.valid[picked] & keep
        rgb = self._pairs.rgb[picked] * valid[..., None]
        latents, masked = self._unmasked[picked], ~keep.all(axis=(1, 2))
        if masked.any():
            latents[masked] = self._condition_latents(rgb[masked], valid[masked])
        condition, mask = to_tensor(rgb).to(device), torch.from_numpy(valid)[:, None].to(device)
        with mixed_precision(device):
            features = self.model.features(condition, mask, dropped, latents)
        losses = denoising_losses(
            self.model, self._diffusion, self._latents[picked], features, self._timesteps, rng
        )
        support = mask.float().mean(dim=(1, 2, 3))
        if self._settings.weighting == "support":
            losses = losses * support / self._mean_support
        return {"loss": losses.mean(), "support": support.mean()}

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """Pairs side by side: condition with a mask of this training's kind, sample, target."""
        picked = np.linspace(0, len(self._pairs) - 1, 6).astype(int)
        always = replace(self._injection, probability=1.0)
        keep = always.inject(np.random.default_rng(0), len(picked))
        valid = self._pairs.valid[picked] & keep
        condition = self._pairs.rgb[picked].astype(np.float32) / 255 * valid[..., None]
        generator = Generator(self._autoencoder, model, self._diffusion)
        random = torch.Generator().manual_seed(0)
        samples = generator.generate(condition, valid, self._sampling, random)
        columns = condition, samples, self._pairs.target[picked].astype(np.float32) / 255
        return np.concatenate([np.concatenate(list(column)) for column in columns], axis=1)

    def _condition_latents(
        self,
        rgb: np.ndarray | Stack,  # [N, H, W, 3] uint8
        valid: np.ndarray | Stack,  # [N, H, W] bool
    ) -> Tensor:
        """[N, L, h, w] the encoder's latents of condition maps."""

        def encode(part: slice) -> Tensor:
            held = valid[part]
            condition = to_tensor(rgb[part] * held[..., None]).to(self._latents.device)
            mask = torch.from_numpy(held)[:, None].to(condition.device)
            return self.model.encoder.latent(condition, mask)

        return encode_in_parts(encode, len(rgb), self._latents.device)


def _conditional(prior: Prior, settings: Settings, seed: int) -> Denoiser:
    """The prior's denoiser behind a new condition encoder."""
    with seeded(seed, "geo-evs", "encoder"):
        encoder = (
            FrozenEncoder(prior.autoencoder)
            if settings.encoder == "frozen"
            else ConditionEncoder(
                prior.autoencoder, validity=settings.validity, filled=settings.filled
            )
        )
        denoiser = conditioned(prior.denoiser, encoder, prior.diffusion.prediction)
    return denoiser.to(next(prior.autoencoder.parameters()).device)
