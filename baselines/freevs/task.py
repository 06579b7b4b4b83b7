"""How FreeVS is trained: denoise clips of recorded views from their pseudo-images."""

import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from baselines.freevs.clips import SHIFTS, Clips
from baselines.freevs.denoiser import ClipDenoiser, Preconditioning
from baselines.freevs.encoder import filled_latents
from baselines.freevs.model import ClipGenerator
from baselines.freevs.training import Settings
from geoevs.core.networks import best_device, mixed_precision, seeded
from geoevs.core.optimising import Optimisation, fingerprint, optimise
from geoevs.core.randomness import Rng
from geoevs.diffusion.autoencoder import Autoencoder, to_tensor
from geoevs.diffusion.latents import encode_in_parts
from geoevs.diffusion.prior import Prior, load_prior


def train_freevs(
    settings: Settings,
    clips: Clips,
    weights: Path,
    seed: int,
    work: Path,
    report: Callable[[float], None],
) -> ClipGenerator:
    """Train the networks.

    Args:
        settings: how.
        clips: on what.
        weights: the folder of this suite's pretrained weights.
        seed: decides first weights and every batch.
        work: the training's own folder (see `optimise`).
        report: called after every step with its loss.

    Raises:
        GeoEvsError: the prior is not on the machine, no scene is as long as a clip, the images do
            not divide into latents, or the training diverged.
    """
    began = time.monotonic()
    prior = load_prior(settings.prior, weights)
    prior.autoencoder.to(best_device())
    task = FreeVSTask(prior, clips, settings, seed)
    optimisation = Optimisation(settings.steps, settings.learning_rate)
    model = optimise(task, optimisation, seed, "freevs", work, report, began)
    return ClipGenerator(prior.autoencoder, model)


class FreeVSTask:
    """Denoise latents of clips, some of them shown by other frames' points or by none.

    Args:
        prior: the weights to start from; its denoiser is widened and trained, the rest is frozen.
        clips: the training set.
        settings: those of the prior and the optimiser do not count here.
        seed: of new layers' first weights.

    Raises:
        GeoEvsError: no scene is as long as a clip, the sampling is none, or the images do not
            divide into latents.
    """

    def __init__(self, prior: Prior, clips: Clips, settings: Settings, seed: int) -> None:
        self._autoencoder = prior.autoencoder.requires_grad_(False)
        self._clips, self._settings = clips, settings
        self._sampling = settings.sampling
        self._starts = clips.starts(settings.frames)
        self._latents = _encode(self._autoencoder, partial(_targets, clips), len(clips))
        filled = _encode(self._autoencoder, partial(_shown, clips), len(clips) * len(SHIFTS))
        self._filled = filled.unflatten(0, (len(clips), len(SHIFTS)))
        spread = float((self._latents[:, None] - self._filled).std())
        with seeded(seed, "freevs"):
            made = ClipDenoiser.from_prior(prior, settings.frames, spread)
        self.model = made.to(self._latents.device)
        data = clips.rgb, clips.valid, self._latents
        self.identity = fingerprint(asdict(settings), asdict(prior.diffusion), *data)

    def batch(self, rng: Rng) -> list[str]:
        """The first views of the clips that one batch holds, as scene/camera/frame."""
        clips = self._clips
        return [f"{clips.scene[n]}/{clips.camera[n]}/{clips.frame[n]}" for n in self._pick(rng)]

    def _pick(self, rng: Rng) -> np.ndarray:
        return rng.numpy.choice(self._starts, self._settings.batch)

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """EDM's loss of one batch: squared errors of the network's own target."""
        settings, device = self._settings, self._latents.device
        frames, picked = settings.frames, self._pick(rng)
        count = len(picked)
        dropped = rng.numpy.random(count) < settings.drop
        other = rng.numpy.integers(1, len(SHIFTS), size=count)
        shown = np.where(rng.numpy.random(count) < settings.simulated, other, 0).repeat(frames)
        views = (picked[:, None] + np.arange(frames)).ravel()
        exponent = torch.randn(count, generator=rng.torch) * settings.noise.std
        sigma = (settings.noise.mean + exponent).exp().repeat_interleave(frames).to(device)
        clean = self._latents[views]
        noise = torch.randn(clean.shape, generator=rng.torch).to(device)
        valid = torch.from_numpy(self._clips.valid[views, shown][:, None]).to(device)
        images = to_tensor(self._clips.rgb[views, shown]).to(device)
        kept = torch.from_numpy(~dropped.repeat(frames)).to(device)[:, None, None, None]
        with mixed_precision(device):
            condition = self._filled[views, shown] + self.model.encoder(images, valid).float()
            noisy = clean + sigma[:, None, None, None] * noise
            predicted = self.model(noisy, sigma, condition * kept)
        weight = Preconditioning.at(sigma, self.model.spread).weight
        loss = (weight * (predicted - clean).square()).mean()
        return {"loss": loss, "condition": (condition.detach() - clean).square().mean()}

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """Clips' middle views: pseudo-image, sample, the same by other frames' points, target."""
        frames = self._settings.frames
        picked = self._starts[np.linspace(0, len(self._starts) - 1, 6).astype(int)]
        views = (picked[:, None] + np.arange(frames)).ravel()
        generator = ClipGenerator(self._autoencoder, model)
        middle = views[generator.middle :: frames]
        columns = []
        for shown in (0, len(SHIFTS) - 1):
            images = self._clips.rgb[views, shown].astype(np.float32) / 255
            random = torch.Generator().manual_seed(0)
            valid = self._clips.valid[views, shown]
            samples = generator.generate(images, valid, self._sampling, random)
            columns += [images[generator.middle :: frames], samples]
        columns.append(self._clips.target[middle].astype(np.float32) / 255)
        return np.concatenate([np.concatenate(list(column)) for column in columns], axis=1)


Images = tuple[np.ndarray, np.ndarray]
"""Some images, [M, H, W, 3] uint8, and which of their pixels count, [M, H, W] bool."""


def _targets(clips: Clips, part: slice) -> Images:
    """Some of the recorded views."""
    target = clips.target[part]
    return target, np.ones(target.shape[:-1], bool)


def _shown(clips: Clips, part: slice) -> Images:
    """Some of all views' pseudo-images, those of a view one behind the other."""
    count = len(SHIFTS)
    views = slice(part.start // count, -(-part.stop // count))
    inside = slice(part.start - views.start * count, part.stop - views.start * count)
    rgb, valid = clips.rgb[views], clips.valid[views]
    return rgb.reshape(-1, *rgb.shape[2:])[inside], valid.reshape(-1, *valid.shape[2:])[inside]


def _encode(autoencoder: Autoencoder, read: Callable[[slice], Images], count: int) -> Tensor:
    """[count, L, h, w] latents of filled images, once: they are the same at every step."""
    device = next(autoencoder.parameters()).device

    def encode(part: slice) -> Tensor:
        images, valid = read(part)
        shown = to_tensor(images).to(device)
        return filled_latents(autoencoder, shown, torch.from_numpy(valid)[:, None].to(device))

    return encode_in_parts(encode, count, device)
