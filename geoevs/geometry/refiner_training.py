"""Training the depth refiner on views whose dense depth is known (paper section 3.2)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import best_device, mixed_precision, seeded
from geoevs.core.optimising import Optimisation, fingerprint, finish, optimise
from geoevs.core.progress import progress_bar, training_bar
from geoevs.core.randomness import Rng
from geoevs.geometry.depth_loss import depth_loss
from geoevs.geometry.depth_models import NetworkDepth, VggtDepth
from geoevs.geometry.finetuning import BRIGHTEST, DARKEST, FAR
from geoevs.geometry.refinement import (
    CENTRE,
    COLOURS,
    FITTED,
    NANO_CHANNELS,
    DepthRefiner,
    refiner_inputs,
)
from geoevs.geometry.vggt import DepthPrediction, save_vggt
from geoevs.methods.contract import Views
from geoevs.scenes.depths import read_depths
from geoevs.scenes.store import Scene


@dataclass(frozen=True)
class RefinerViews:
    """Views as a refiner sees them, with their true depth."""

    inputs: np.ndarray  # [N, INPUTS, H, W] float16
    depths: np.ndarray  # [N, H, W] float16 metres, the sky at FAR
    names: list[str]

    def __len__(self) -> int:
        return len(self.inputs)


def train_depth_refiner(
    model: Path,
    scenes: Sequence[Path],
    depths: Sequence[Path],
    batch: int,
    optimisation: Optimisation,
    seed: int,
    work: Path,
    out: Path,
) -> None:
    """Train what refines a VGGT's depth by LiDAR; both are written together, as float16.

    Args:
        model: VGGT weights; a refiner that they have is left out.
        scenes: scene stores.
        depths: the folder of dense truth of each.
        batch: views a step.
        optimisation: how long and how fast.
        seed: decides first weights and every batch.
        work: the training's own folder (see `optimise`).
        out: the weights' file.

    Raises:
        GeoEvsError: a scene has no dense truth, or a loss or gradient is not finite.
    """
    if len(scenes) != len(depths):
        raise GeoEvsError(
            f"there are {len(scenes)} scenes and {len(depths)} folders of true depth; give one for "
            "each scene"
        )
    network = VggtDepth(model)
    network.model.refiner = None
    with progress_bar("depth of scenes", len(scenes)) as advance:
        views = read_refiner_views(scenes, depths, network, advance)
    with seeded(seed, "depth-refiner"):
        refiner = DepthRefiner(NANO_CHANNELS)
    refiner.to(best_device())
    with training_bar(f"depth refiner on {len(views)} views", optimisation.steps) as report:
        task = RefinementTask(refiner, views, batch)
        trained = optimise(task, optimisation, seed, "depth-refiner", work, report)
    network.model.set_refiner(trained, NANO_CHANNELS)
    save_vggt(network.model, out, torch.float16)
    finish(work)


def read_refiner_views(
    scenes: Sequence[Path],
    depths: Sequence[Path],
    model: NetworkDepth,
    advance: Callable[[], None] = lambda: None,
) -> RefinerViews:
    """All recorded views that LiDAR sees, with a network's depth fitted to it.

    Args:
        scenes: scene stores.
        depths: their folders of dense truth.
        model: a network that has no refiner yet.
        advance: called after each scene.

    Raises:
        GeoEvsError: a scene has no dense truth, or none has a view that LiDAR sees.
    """
    inputs, known, names = [], [], []
    for folder, truth in zip(scenes, depths, strict=True):
        views = Views(Scene(folder), Scene(folder).cameras, ("lidar",))
        for frame in views.frames:
            dense = read_depths(truth, frame)
            if not dense:
                raise GeoEvsError(f"{truth} has no dense depth; leave scenes without it out")
            fitted, points = model.depths(views, frame), views.lidar(frame).xyz
            for name, depth in fitted.items():
                image, camera = views.image(name, frame), views.camera(name, frame)
                seen = refiner_inputs(image, depth, points, camera)
                if seen is not None:
                    inputs.append(seen.astype(np.float16))
                    known.append(np.where(dense[name] > 0, np.minimum(dense[name], FAR), FAR))
                    names.append(f"{views.scene_name}/{name}/{frame}")
        advance()
    if not inputs:
        raise GeoEvsError("LiDAR sees none of these scenes' views; name scenes that have LiDAR")
    return RefinerViews(np.stack(inputs), np.array(known, np.float16), names)


class RefinementTask:
    """Refine the depth of random views, half of them mirrored, at random exposures.

    Args:
        model: what is trained.
        views: on what.
        batch: views a step.
    """

    def __init__(self, model: DepthRefiner, views: RefinerViews, batch: int) -> None:
        self.model, self._views, self._batch = model, views, batch
        self.identity = fingerprint(batch, views.inputs, views.depths)

    def batch(self, rng: Rng) -> list[str]:
        """The views of one batch, as scene/camera/frame."""
        return [self._views.names[number] for number in self._pick(rng)]

    def _pick(self, rng: Rng) -> np.ndarray:
        return rng.numpy.integers(len(self._views), size=self._batch)

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """The depth loss of one batch."""
        device = next(self.model.parameters()).device
        picked = self._pick(rng)
        inputs = torch.from_numpy(self._views.inputs[picked]).float()
        known = torch.from_numpy(self._views.depths[picked]).float()
        exposure = rng.numpy.uniform(DARKEST, BRIGHTEST)
        inputs[:, COLOURS] = ((inputs[:, COLOURS] + 1) * exposure - 1).clamp(-1, 1)
        if rng.numpy.random() < 0.5:
            inputs, known = inputs.flip(-1), known.flip(-1)
        inputs, known = inputs.to(device), known.to(device)
        with mixed_precision(device):
            depth = self.model(inputs).exp()
        relative = ((depth.detach() - known).abs() / known).mean()
        prediction = DepthPrediction(depth[None], torch.ones_like(depth)[None])
        return {"loss": depth_loss(prediction, known[None]), "relative_error": relative}

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """Views above their inverse depth: fitted, refined and true."""
        picked = np.linspace(0, len(self._views) - 1, 6).astype(int)
        inputs = torch.from_numpy(self._views.inputs[picked]).float()
        refined = model(inputs.to(next(model.parameters()).device)).exp().cpu().numpy()
        colours = (inputs[:, COLOURS].permute(0, 2, 3, 1).numpy() + 1) / 2
        fitted = np.exp(inputs[:, FITTED].numpy() + CENTRE)
        depths = fitted, refined, self._views.depths[picked].astype(np.float32)
        near = [np.repeat((4 / np.maximum(d, 4))[..., None], 3, axis=-1) for d in depths]
        return np.concatenate([np.concatenate(list(row), axis=1) for row in (colours, *near)])
