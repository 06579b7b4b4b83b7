"""Training VGGT on driving frames: all views of a frame at once, camera poses never predicted.

The paper fine-tunes with fixed camera poses, so depth alone is supervised (section 3.2): by dense
truth on procedural scenes, by LiDAR elsewhere.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_json
from geoevs.core.images import to_uint8
from geoevs.core.networks import best_device, mixed_precision
from geoevs.core.optimising import (
    Optimisation,
    fingerprint,
    finish,
    optimise,
    training_seconds,
)
from geoevs.core.progress import training_bar
from geoevs.core.randomness import Rng
from geoevs.geometry.depth_loss import depth_loss
from geoevs.geometry.vggt import (
    VGGT_NANO,
    DepthPrediction,
    Vggt,
    VggtConfig,
    load_vggt,
    new_vggt,
    save_vggt,
)
from geoevs.methods.trained import seconds_file
from geoevs.projection import zbuffer
from geoevs.scenes.camera import Camera
from geoevs.scenes.depths import read_depths
from geoevs.scenes.store import Scene

FAR = 200.0
"""Metres at which the sky is taught to lie, so that it is lifted like everything else."""

DARKEST, BRIGHTEST = 0.7, 1.3  # exposures that a frame is trained at
VIEWS = 3
"""Views of a frame that one step sees; the cost of global attention rises with their square."""


@dataclass(frozen=True)
class DepthFrames:
    """Frames with what is known of their depth."""

    images: np.ndarray  # [F, V, H, W, 3] uint8
    depths: np.ndarray  # [F, V, H, W] float16 metres, 0 = unknown
    names: list[str]  # scene/frame

    def __len__(self) -> int:
        return len(self.images)


def train_depth_network(
    scenes: Sequence[Path],
    depths: Sequence[Path],
    start: Path | None,
    batch: int,
    optimisation: Optimisation,
    seed: int,
    work: Path,
    out: Path,
    dtype: torch.dtype = torch.float32,
) -> None:
    """Fine-tune VGGT on driving scenes, or train a nano one from scratch (section 3.2).

    Wall seconds go beside the weights (see `seconds_file`).

    Args:
        scenes: scene stores.
        depths: their folders of dense truth; none: LiDAR supervises.
        start: VGGT weights to fine-tune; None: a new nano network.
        batch: frames a step.
        optimisation: how long and how fast.
        seed: decides a new network's weights and every batch.
        work: the training's own folder (see `optimise`).
        out: the weights' file.
        dtype: what they are stored as.

    Raises:
        GeoEvsError: scenes cannot be learned from together, or a loss or gradient is not finite.
    """
    model = load_vggt(start) if start else new_vggt(VGGT_NANO, Rng(seed, "vggt").torch)
    frames = read_depth_frames(scenes, depths, model.config)
    count = sum(parameter.numel() for parameter in model.parameters())
    described = f"{len(frames)} frames of {frames.images.shape[1]} views"
    print(
        f"VGGT: {described}, {count / 1e6:.1f} M parameters, {optimisation.steps} steps",
        file=sys.stderr,
    )
    model.to(best_device())
    with training_bar("VGGT", optimisation.steps) as report:
        trained = train_vggt(model, frames, batch, optimisation, seed, work, report)
    write_json(seconds_file(out), {"training": training_seconds(work)})
    save_vggt(trained, out, dtype)
    finish(work)


def train_vggt(
    model: Vggt,
    frames: DepthFrames,
    batch: int,
    optimisation: Optimisation,
    seed: int,
    work: Path,
    report: Callable[[float], None] = lambda loss: None,
) -> Vggt:
    """Train a network on frames, from the weights that it has; it goes on if it was killed.

    Args:
        model: on the device to train on.
        frames: what it learns from.
        batch: frames a step.
        optimisation: how long and how fast.
        seed: decides every batch.
        work: the training's own folder (see `optimise`).
        report: called after every step with its loss.

    Raises:
        GeoEvsError: a loss or gradient is not finite.
    """
    return optimise(GeometryTask(model, frames, batch), optimisation, seed, "vggt", work, report)


def read_depth_frames(
    scenes: Sequence[Path], depths: Sequence[Path], config: VggtConfig
) -> DepthFrames:
    """All frames of scenes: dense truth where `depths` has it (sky at FAR), else all LiDAR points.

    Args:
        scenes: scene stores.
        depths: their folders of dense truth, some of them empty; or none at all, for LiDAR alone.
        config: of the network, which says at what size it is shown images.

    Raises:
        GeoEvsError: there is no scene, the scenes differ in their cameras' number or size, or
            their folders of truth are fewer or more.
    """
    if depths and len(depths) != len(scenes):
        raise GeoEvsError(
            f"there are {len(scenes)} scenes and {len(depths)} folders of true depth; give one for "
            "each scene, or none"
        )
    images, known, names = [], [], []
    for folder, truth in zip(scenes, depths or [None] * len(scenes), strict=True):
        scene = Scene(folder)
        for frame in scene.frames:
            cameras = [scene.camera(name, frame) for name in scene.cameras]
            dense = read_depths(truth, frame) if truth is not None else {}
            points = None if dense else scene.points(frame).xyz
            recorded = [to_uint8(scene.image(one.name, frame)) for one in cameras]
            shown, windows = config.shown(recorded, cameras)
            depth = np.zeros(shown.shape[:3], np.float16)
            for whole, window, camera in zip(depth, windows, cameras, strict=True):
                seen = camera.resized(*whole[window].shape)
                whole[window] = _dense(dense[seen.name], seen) if dense else _sparse(points, seen)
            images.append(shown)
            known.append(depth)
            names.append(f"{scene.info.name}/{frame}")
    if not images:
        raise GeoEvsError("there are no frames to learn depth from; name scenes in the config")
    shapes = {np.shape(views) for views in images}
    if len(shapes) > 1:
        raise GeoEvsError(
            f"scenes differ in their views ({', '.join(map(str, sorted(shapes)))}); train on those "
            "of one rig and resolution"
        )
    return DepthFrames(np.array(images), np.array(known), names)


def _dense(depth: np.ndarray, camera: Camera) -> np.ndarray:
    size = camera.width, camera.height
    depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    return np.where(depth > 0, np.minimum(depth, FAR), FAR)


def _sparse(points: np.ndarray, camera: Camera) -> np.ndarray:
    return zbuffer(points, camera, visibility="footprint").depth


class GeometryTask:
    """Predict the depth of random frames, half of them mirrored, at random exposures.

    Args:
        model: what is trained.
        frames: on what.
        batch: frames a step.
    """

    def __init__(self, model: Vggt, frames: DepthFrames, batch: int) -> None:
        self.model, self._frames, self._batch = model, frames, batch
        self.identity = fingerprint(batch, frames.images, frames.depths)

    def batch(self, rng: Rng) -> list[str]:
        """The frames of one batch, as scene/frame."""
        return [self._frames.names[number] for number in self._pick(rng)]

    def _pick(self, rng: Rng) -> np.ndarray:
        return rng.numpy.integers(len(self._frames), size=self._batch)

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """The depth loss of one batch: VIEWS random views of each frame, in a random order."""
        device = next(self.model.parameters()).device
        picked, random = self._pick(rng), rng.numpy
        order = random.permutation(self._frames.images.shape[1])[:VIEWS]
        images = self._frames.images[picked][:, order].astype(np.float32) / 255
        depths = self._frames.depths[picked][:, order].astype(np.float32)
        if random.random() < 0.5:
            images, depths = images[:, :, :, ::-1], depths[:, :, :, ::-1]
        images = np.clip(images * random.uniform(DARKEST, BRIGHTEST), 0, 1)
        seen = torch.from_numpy(np.ascontiguousarray(images)).permute(0, 1, 4, 2, 3).to(device)
        known = torch.from_numpy(np.ascontiguousarray(depths)).to(device)
        with mixed_precision(device):
            prediction = self.model(seen)
        prediction = DepthPrediction(*(part.float() for part in prediction))
        with torch.no_grad():
            relative = ((prediction.depth - known).abs() / known)[known > 0]
            # Where LiDAR misses all views, the mean of nothing would stop the training.
            relative = relative.sum() / max(len(relative), 1)
        return {"loss": depth_loss(prediction, known), "relative_error": relative}

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """Views of one frame above what is known of their inverse depth, and what is predicted."""
        device = next(model.parameters()).device
        images = self._frames.images[len(self._frames) // 2].astype(np.float32) / 255
        known = self._frames.depths[len(self._frames) // 2].astype(np.float32)
        seen = torch.from_numpy(images).permute(0, 3, 1, 2)[None].to(device)
        predicted = model(seen).depth[0].cpu().numpy()
        near = np.where(known > 0, 4 / np.maximum(known, 4), 0), 4 / np.maximum(predicted, 4)
        rows = [images, *(np.repeat(part[..., None], 3, axis=-1) for part in near)]
        return np.concatenate([np.concatenate(list(row), axis=1) for row in rows])
