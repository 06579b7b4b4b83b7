"""Training detectors, and first the backbone that all of them share."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import best_device
from geoevs.core.optimising import Optimisation, fingerprint, finish, optimise, training_seconds
from geoevs.core.progress import training_bar
from geoevs.core.randomness import Rng
from geoevs.detection.bevformer.backbone import (
    Backbone,
    load_backbone,
    new_backbone,
    pretrained_backbone,
    save_backbone,
)
from geoevs.detection.bevformer.detecting import found_boxes
from geoevs.detection.bevformer.features import GEOMETRY, check_features
from geoevs.detection.bevformer.inputs import FeatureFrame, RigFrame, in_scenes
from geoevs.detection.bevformer.losses import detection_losses, wanted
from geoevs.detection.bevformer.network import (
    BevFormer,
    new_bevformer,
    save_bevformer,
)
from geoevs.detection.bevformer.pictures import draw_frame
from geoevs.detection.bevformer.settings import Detector, Fitting
from geoevs.detection.rules import CLASSES

GAINS, OFFSETS = (0.8, 1.2), (-15 / 255, 15 / 255)
"""Of a jittered view's brightness."""

SHOWN = 0.3
"""Lowest score of the boxes in a preview."""


def train_backbone(
    frames: Sequence[RigFrame],
    detector: Detector,
    fitting: Fitting,
    seed: int,
    work: Path,
    out: Path,
    weights: Path,
    device: str | None = None,
) -> None:
    """Write the backbone of a detector: a new one that learns here, or a pretrained one.

    The backbone `cnn` learns with a detector that is then thrown away.

    Args:
        frames: with the recorded views; not looked at where the backbone is pretrained.
        detector: says which.
        fitting: how; `backbone_steps` says how long, and 0 steps leave a new one untrained.
        seed: decides its first weights and every batch.
        work: the training's own folder (see `optimise`).
        out: the file.
        weights: the folder of this suite's pretrained weights.
        device: where; None: the GPU if there is one.

    Raises:
        GeoEvsError: weights are not on this machine, or the training diverged.
    """
    if detector.backbone != "cnn":
        save_backbone(out, pretrained_backbone(detector.backbone, weights))
        return
    backbone = new_backbone(detector, seed)
    fitting = replace(fitting, steps=fitting.backbone_steps, end_to_end=True)
    model = _trained(frames, backbone, detector, fitting, CLASSES, seed, work, "backbone", device)
    save_backbone(out, model.backbone)
    finish(work)


def train(
    frames: Sequence[RigFrame] | Sequence[FeatureFrame],
    backbone: Path,
    detector: Detector,
    fitting: Fitting,
    seed: int,
    work: Path,
    out: Path,
    classes: Sequence[str] = CLASSES,
    device: str | None = None,
) -> float:
    """Train a detector, and write it with its backbone.

    A killed training goes on to the same bytes. `work` gets `losses.csv`, `previews/` and, while it
    lasts, its state.

    Args:
        frames: what it sees and is to find, all scenes one after the other; with features it is
            faster, and pictures can be mirrored.
        backbone: what `train_backbone` wrote.
        detector: sizes.
        fitting: how.
        seed: decides its first weights and every batch.
        work: the training's own folder (see `optimise`).
        out: the .safetensors file.
        classes: whose places the frames' `classes` are.
        device: where; None: the GPU if there is one.

    Returns:
        Wall seconds, those of killed parts among them.

    Raises:
        GeoEvsError: frames lack what the training needs, or a loss or gradient is not finite.
    """
    network = load_backbone(backbone)
    if network.kind != detector.backbone:
        raise GeoEvsError(
            f"{backbone} is the backbone '{network.kind}', and the detector's is "
            f"'{detector.backbone}'; make it again"
        )
    model = _trained(frames, network, detector, fitting, classes, seed, work, "detector", device)
    save_bevformer(out, model)
    seconds = training_seconds(work)
    finish(work)
    return seconds


def _trained(
    frames: Sequence[RigFrame] | Sequence[FeatureFrame],
    backbone: Backbone,
    detector: Detector,
    fitting: Fitting,
    classes: Sequence[str],
    seed: int,
    work: Path,
    key: str,
    device: str | None,
) -> BevFormer:
    model = new_bevformer(detector, classes, backbone, seed).to(device or best_device())
    task = DetectorTask(model, frames, fitting)
    optimisation = Optimisation(fitting.steps, fitting.learning_rate, fitting.warmup)
    views = sum(len(frame.recorded) for frame in frames) / len(frames)
    title = f"{key} on {len(frames)} frames of {views:.0f} views"
    with training_bar(title, fitting.steps) as report:
        return optimise(task, optimisation, seed, key, work, report)


class DetectorTask:
    """Find the boxes of random frames.

    Args:
        model: on the device to train on.
        frames: all scenes', each in its order of time.
        fitting: how.

    Raises:
        GeoEvsError: there are no frames or no boxes, a class is none, frames are not ordered in
            time, or they are features where pictures are needed, or of another backbone.
    """

    def __init__(
        self,
        model: BevFormer,
        frames: Sequence[RigFrame] | Sequence[FeatureFrame],
        fitting: Fitting,
    ) -> None:
        self.model, self._frames, self._fitting = model, frames, fitting
        self._earlier = {
            place: places[:order]
            for places in in_scenes(frames).values()
            for order, place in enumerate(places)
        }
        _check_frames(frames, len(model.classes), fitting)
        check_features(frames, model.backbone)
        model.backbone.requires_grad_(fitting.end_to_end)
        settings = asdict(model.detector), asdict(fitting), list(model.classes)
        self.identity = fingerprint(*settings, *map(_identity, frames))

    def batch(self, rng: Rng) -> list[str]:
        """The frames of one batch, as scene/frame."""
        return [self._frames[place].name for place in self._pick(rng)]

    def _pick(self, rng: Rng) -> np.ndarray:
        return rng.numpy.integers(len(self._frames), size=self._fitting.batch)

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """The losses of one batch; earlier frames are looked at without a gradient."""
        frames, memories = [], []
        for place in self._pick(rng):
            earlier, frame = self._queue(int(place), rng)
            frames.append(frame)
            memories.append(self.model.remember(earlier))
        found, heat = self.model(frames, memories)
        return detection_losses(found, heat, self._wanted(frames))

    def _queue(
        self, place: int, rng: Rng
    ) -> tuple[list[RigFrame | FeatureFrame], RigFrame | FeatureFrame]:
        """A frame and those before it, mirrored or not together, each view jittered by itself.

        Of one earlier frame more than are looked at, one is left out at random.
        """
        history = self.model.detector.history
        earlier = self._earlier[place][-history - 1 :] if history else []
        if len(earlier) > history:
            del earlier[int(rng.numpy.integers(len(earlier)))]
        queue = [self._frames[number] for number in (*earlier, place)]
        if self._fitting.flip and rng.numpy.random() < 0.5:
            queue = [frame.mirrored() for frame in queue if isinstance(frame, RigFrame)]
        if self._fitting.jitter:
            queue = [_jittered(frame, rng) for frame in queue if isinstance(frame, RigFrame)]
        return queue[:-1], queue[-1]

    def _wanted(self, frames: Sequence[RigFrame | FeatureFrame]) -> list:
        detector, count = self.model.detector, len(self.model.classes)
        return [
            wanted(frame.boxes, frame.classes, detector, count, self.model.device)
            for frame in frames
        ]

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """The recorded views of one frame with its boxes, what is found among them, and a map."""
        assert isinstance(model, BevFormer)
        frame = self._frames[len(self._frames) // 2]
        memory = model.remember(
            self._frames[place] for place in self._earlier[len(self._frames) // 2]
        )
        found, _ = model([frame], [memory])
        boxes, _, scores = found_boxes(found, model.detector)[0]
        return draw_frame(frame, boxes[scores >= SHOWN], model.detector.range)


def _identity(frame: RigFrame | FeatureFrame) -> str:
    pixels = frame.images if isinstance(frame, RigFrame) else frame.stack
    geometry = [np.asarray(getattr(frame, name)) for name in GEOMETRY]
    return fingerprint(frame.name, frame.seconds, pixels, *geometry)


def _check_frames(
    frames: Sequence[RigFrame | FeatureFrame], classes: int, fitting: Fitting
) -> None:
    for frame in frames:
        if fitting.sees_pictures and isinstance(frame, FeatureFrame):
            raise GeoEvsError(
                f"{frame.name} has features and no pictures, which flip, jitter and end_to_end "
                "need; give frames with pictures, or turn these off"
            )
        if len(frame.classes) and not 0 <= min(frame.classes) <= max(frame.classes) < classes:
            raise GeoEvsError(
                f"{frame.name} has a box of a class that is none of {classes}; give places in the "
                "detector's classes"
            )
    if not any(len(frame.classes) for frame in frames):
        raise GeoEvsError(
            f"none of the {len(frames)} frames has a box to learn from; name scenes with labels"
        )


def _jittered(frame: RigFrame, rng: Rng) -> RigFrame:
    shape = len(frame.images), 1, 1, 1
    gains = rng.numpy.uniform(*GAINS, shape).astype(np.float32)
    offsets = rng.numpy.uniform(*OFFSETS, shape).astype(np.float32)
    return replace(frame, images=np.clip(frame.images * gains + offsets, 0, 1))
