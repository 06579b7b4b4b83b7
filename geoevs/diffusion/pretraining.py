"""Pretraining on images alone: the autoencoder, and the unconditional prior over its latents.

They stand in for Stable Diffusion's where its weights are not on the machine.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.images import to_uint8
from geoevs.core.networks import best_device, mixed_precision, seeded
from geoevs.core.optimising import Optimisation, fingerprint, finish, optimise
from geoevs.core.progress import training_bar
from geoevs.core.randomness import Rng
from geoevs.diffusion.autoencoder import (
    NANO_BLOCK,
    Autoencoder,
    nano_autoencoder,
    to_arrays,
    to_tensor,
)
from geoevs.diffusion.denoiser import Denoiser, nano_unet
from geoevs.diffusion.latents import denoising_losses, encode_images
from geoevs.diffusion.prior import load_autoencoder, save_autoencoder, save_denoiser
from geoevs.diffusion.process import Diffusion
from geoevs.diffusion.sampling import TIMESTEPS
from geoevs.scenes.store import Scene

KL_WEIGHT = 1e-5
CROP = 64, 64
"""Height and width of the autoencoder's crops, pixels."""

STATISTICS = 128
"""Fewest images that give the autoencoder's first weights and its latents' scale."""


@dataclass(frozen=True)
class Images:
    """Images that the autoencoder and the prior are pretrained on, with their names."""

    rgb: np.ndarray  # [N, H, W, 3] uint8
    names: list[str]  # scene/camera/frame

    def __len__(self) -> int:
        return len(self.rgb)


def read_images(scenes: Sequence[Path]) -> Images:
    """Every image of scenes.

    Raises:
        GeoEvsError: their resolutions differ.
    """
    images, names = [], []
    for scene in map(Scene, scenes):
        for frame in scene.frames:
            for camera in scene.cameras:
                images.append(to_uint8(scene.image(camera, frame)))
                names.append(f"{scene.info.name}/{camera}/{frame}")
    sizes = sorted({image.shape[:2] for image in images})
    if len(sizes) > 1:
        listing = ", ".join(f"{height} x {width}" for height, width in sizes)
        raise GeoEvsError(f"scenes differ in resolution ({listing}); train on those of one")
    return Images(np.stack(images), names)


def pretrain_autoencoder(
    scenes: Sequence[Path],
    batch: int,
    steps: int,
    learning_rate: float,
    seed: int,
    work: Path,
    out: Path,
    crop: tuple[int, int] = CROP,
) -> None:
    """Train this suite's autoencoder on the images of scenes; weights are stored as float16.

    Its first weights are the best linear code of the images, which training starts from: weight
    decay would pull it away from that.

    Args:
        scenes: scene stores of one resolution.
        batch: crops a step.
        steps: of the optimiser.
        learning_rate: its peak.
        seed: decides first weights and every batch.
        work: the training's own folder (see `optimise`).
        out: the weights' file.
        crop: height and width of crops, pixels.

    Raises:
        GeoEvsError: resolutions differ, crops do not fit, or a loss or gradient is not finite.
    """
    images = read_images(scenes)
    with seeded(seed, "autoencoder"):
        autoencoder = Autoencoder(nano_autoencoder(), NANO_BLOCK)
    some = to_tensor(images.rgb[:: max(1, len(images) // STATISTICS)])
    autoencoder.fit_linear(some)
    device = best_device()
    task = AutoencoderTask(autoencoder.to(device), images, batch, crop)
    with training_bar(f"autoencoder on {len(images)} images", steps) as report:
        optimisation = Optimisation(steps, learning_rate, weight_decay=0.0)
        trained = optimise(task, optimisation, seed, "autoencoder", work, report)
    trained.fit_statistics(some.to(device))
    save_autoencoder(out, trained, torch.float16)
    finish(work)


def pretrain_prior(
    scenes: Sequence[Path],
    autoencoder: Path,
    batch: int,
    steps: int,
    learning_rate: float,
    seed: int,
    work: Path,
    out: Path,
) -> None:
    """Train the unconditional denoiser on the images of scenes; weights are stored as float16.

    Args:
        scenes: scene stores of one resolution.
        autoencoder: what `pretrain_autoencoder` wrote.
        batch: images a step.
        steps: of the optimiser.
        learning_rate: its peak.
        seed: decides first weights and every batch.
        work: the training's own folder (see `optimise`).
        out: the weights' file.

    Raises:
        GeoEvsError: resolutions differ, or a loss or gradient is not finite.
    """
    device = best_device()
    images, frozen = read_images(scenes), load_autoencoder(autoencoder).to(device)
    with seeded(seed, "prior"):
        denoiser = Denoiser(nano_unet(frozen.latent_channels), None).to(device)
    task = PriorTask(denoiser, frozen, Diffusion(), images, batch)
    with training_bar(f"prior on {len(images)} images", steps) as report:
        trained = optimise(task, Optimisation(steps, learning_rate), seed, "prior", work, report)
    save_denoiser(out, trained, Diffusion(), torch.float16)
    finish(work)


class AutoencoderTask:
    """Reconstruct random crops: L1, and a little Kullback-Leibler divergence.

    Args:
        model: what is trained.
        images: on what.
        batch: crops a step.
        crop: their height and width.

    Raises:
        GeoEvsError: crops are larger than the images.
    """

    def __init__(
        self, model: Autoencoder, images: Images, batch: int, crop: tuple[int, int]
    ) -> None:
        height, width = images.rgb.shape[1:3]
        if crop[0] > height or crop[1] > width:
            raise GeoEvsError(
                f"crops of {crop[0]} x {crop[1]} do not fit into images of {height} x {width}; "
                "choose a smaller crop"
            )
        self.model, self._batch, self._crop = model, batch, crop
        self._images, self._names = images.rgb, images.names
        self.identity = fingerprint(batch, crop, images.rgb)

    def batch(self, rng: Rng) -> list[str]:
        """The images of one batch, as scene/camera/frame."""
        return [self._names[number] for number in _pick(self._images, self._batch, rng.numpy)]

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """Losses of one batch of crops, half of them mirrored."""
        device = next(self.model.parameters()).device
        crops = random_crops(self._images, self._batch, self._crop, rng.numpy).to(device)
        with mixed_precision(device):
            posterior = self.model.posterior(crops)
            noise = torch.randn(posterior.mean.shape, generator=rng.torch).to(device)
            decoded = self.model.decode_raw(posterior.mean + posterior.std * noise)
        error = (decoded.float() - crops).abs().mean()
        mean, logvar = posterior.mean.float(), posterior.logvar.float()
        divergence = 0.5 * (mean.square() + logvar.exp() - 1 - logvar).mean()
        return {"loss": error + KL_WEIGHT * divergence, "l1": error, "divergence": divergence}

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """(2 H, N W, 3) picture: N images, six at most, above their reconstructions."""
        picked = self._images[:: max(1, len(self._images) // 6)][:6]
        images = to_tensor(picked).to(next(model.parameters()).device)
        decoded = model.decode_raw(model.posterior(images).mean)
        rows = [torch.cat(list(part), dim=2) for part in (images, decoded)]
        return to_arrays(torch.cat(rows, dim=1)[None])[0]


class PriorTask:
    """Denoise latents of images, unconditionally.

    Args:
        model: a denoiser without a condition encoder.
        autoencoder: frozen.
        diffusion: the process.
        images: on what.
        batch: images a step, half of them mirrored.
    """

    def __init__(
        self,
        model: Denoiser,
        autoencoder: Autoencoder,
        diffusion: Diffusion,
        images: Images,
        batch: int,
    ) -> None:
        self.model, self._batch = model, batch
        self._images, self._names = images.rgb, images.names
        self._autoencoder, self._diffusion = autoencoder, diffusion
        both_ways = images.rgb, images.rgb[:, :, ::-1]
        self._latents = torch.stack([encode_images(autoencoder, shown) for shown in both_ways])
        frozen = autoencoder.state_dict().values()
        self.identity = fingerprint(batch, asdict(diffusion), images.rgb, *frozen)

    def batch(self, rng: Rng) -> list[str]:
        """The images of one batch, as scene/camera/frame."""
        return [self._names[number] for number in _pick(self._images, self._batch, rng.numpy)]

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """The denoising loss of one batch."""
        picked = _pick(self._images, self._batch, rng.numpy)
        mirrored = rng.numpy.integers(2, size=self._batch)
        clean = self._latents[mirrored, picked]
        losses = denoising_losses(
            self.model, self._diffusion, clean, None, torch.arange(TIMESTEPS), rng
        )
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


def random_crops(
    images: np.ndarray,  # [N, H, W, 3] uint8
    count: int,
    crop: tuple[int, int],
    rng: np.random.Generator,
) -> Tensor:
    """[count, 3, h, w] random crops in [0, 1], half of them mirrored."""
    height, width = crop
    picked = _pick(images, count, rng)
    tops = rng.integers(images.shape[1] - height + 1, size=count)
    lefts = rng.integers(images.shape[2] - width + 1, size=count)
    mirrored = rng.random(count) < 0.5
    crops = [
        images[i, top : top + height, left : left + width][:, :: -1 if flip else 1]
        for i, top, left, flip in zip(picked, tops, lefts, mirrored, strict=True)
    ]
    return to_tensor(np.stack(crops))


def _pick(images: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count,) numbers of random images: the first thing that a batch draws."""
    return rng.integers(len(images), size=count)
