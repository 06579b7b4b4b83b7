"""The detector: backbone, encoder, decoder; frames to batches, and its file."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import (
    built_as_described,
    load_weights,
    read_network,
    save_network,
    seeded,
)
from geoevs.core.settings import make_settings
from geoevs.detection.bevformer.attention import Past
from geoevs.detection.bevformer.backbone import Backbone, described_backbone
from geoevs.detection.bevformer.decoder import Decoder, Found, HeatMap
from geoevs.detection.bevformer.encoder import Encoder, Grid, Views
from geoevs.detection.bevformer.inputs import FeatureFrame, RigFrame
from geoevs.detection.bevformer.settings import Detector

RETRAIN = "train the detector again"


class Memory(NamedTuple):
    """What a detector keeps of a frame until the next one."""

    frame: RigFrame | FeatureFrame
    bev: Tensor  # [Q, C]


class BevFormer(nn.Module):
    """Frames to boxes.

    Args:
        detector: sizes.
        classes: names of what is detected.
        backbone: of its features.
    """

    def __init__(self, detector: Detector, classes: Sequence[str], backbone: Backbone) -> None:
        super().__init__()
        self.detector, self.classes = detector, tuple(classes)
        self.grid = Grid(detector)
        self.backbone = backbone
        self.encoder = Encoder(detector, backbone.channels)
        self.decoder = Decoder(detector, len(self.classes))
        self.heat = HeatMap(detector.channels, len(self.classes), self.grid.size)

    @property
    def device(self) -> torch.device:
        """Where the network computes: the device of its weights."""
        return self.encoder.queries.device

    def views(self, frames: Sequence[RigFrame | FeatureFrame]) -> Views:
        """The views of all frames; features are made where they were not before.

        Raises:
            GeoEvsError: features are of pictures of another size.
        """
        projected, features = [], []
        for frame in frames:
            if isinstance(frame, RigFrame):
                frame = frame.resized(self.detector.image)
                images = np.ascontiguousarray(frame.images.transpose(0, 3, 1, 2), np.float32)
                features.append(self.backbone(torch.from_numpy(images).to(self.device)))
            elif frame.size != self.detector.image:
                raise GeoEvsError(
                    f"{frame.name}: its features are of pictures of {frame.size[0]} x "
                    f"{frame.size[1]}, and the detector's are {self.detector.image[0]} x "
                    f"{self.detector.image[1]}; make the features again"
                )
            else:
                features.append(torch.from_numpy(frame.features.astype(np.float32)).to(self.device))
            projection = torch.from_numpy(frame.image_from_vehicle).to(self.device)
            projected.append(self.grid.project(projection, self.detector.image))
        counts = torch.tensor([len(frame.recorded) for frame in frames])
        recorded = np.concatenate([frame.recorded for frame in frames])
        places, visible = (torch.cat(parts) for parts in zip(*projected, strict=True))
        return Views(
            features=torch.cat(features),
            item=torch.arange(len(frames)).repeat_interleave(counts).to(self.device),
            recorded=torch.from_numpy(recorded).to(self.device),
            places=places.float(),
            visible=visible,
            items=len(frames),
        )

    def past(
        self, frames: Sequence[RigFrame | FeatureFrame], memories: Sequence[Memory | None]
    ) -> Past:
        """What is remembered, as each frame's BEV has it; None of the first frames of scenes."""
        past = self.encoder.no_past(len(frames))
        for item, (frame, memory) in enumerate(zip(frames, memories, strict=True)):
            if memory is None:
                continue
            move = np.linalg.inv(memory.frame.world_from_vehicle) @ frame.world_from_vehicle
            places, motion = self.grid.from_here(move)
            motion = np.append(motion, frame.seconds - memory.frame.seconds)
            past.bev[item], past.present[item] = memory.bev, True
            past.from_here[item] = torch.from_numpy(places)
            past.motion[item] = torch.from_numpy(motion)
        return past

    def bev(
        self, frames: Sequence[RigFrame | FeatureFrame], memories: Sequence[Memory | None]
    ) -> Tensor:
        """(B, Q, C) the BEV of every frame."""
        return self.encoder(self.views(frames), self.past(frames, memories))

    @torch.no_grad()
    def remember(self, frames: Iterable[RigFrame | FeatureFrame]) -> Memory | None:
        """What is left of frames of one scene, in their order; no gradient goes back there."""
        memory = None
        for frame in frames:
            memory = Memory(frame, self.bev([frame], [memory])[0])
        return memory

    def forward(
        self, frames: Sequence[RigFrame | FeatureFrame], memories: Sequence[Memory | None]
    ) -> tuple[Found, Tensor]:
        """What the decoder's layers find in every frame, and the heat maps' logits."""
        bev = self.bev(frames, memories)
        return self.decoder(bev), self.heat(bev)


def new_bevformer(
    detector: Detector, classes: Sequence[str], backbone: Backbone, seed: int
) -> BevFormer:
    """An untrained detector upon a backbone."""
    with seeded(seed, "detector"):
        return BevFormer(detector, classes, backbone)


def save_bevformer(path: Path, model: BevFormer) -> None:
    """Write a detector with its backbone, whole or not at all."""
    settings = {
        "detector": asdict(model.detector),
        "classes": list(model.classes),
        "backbone": model.backbone.settings,
    }
    save_network(path, model, settings)


def load_bevformer(path: Path) -> BevFormer:
    """Read what `save_bevformer` wrote, on the CPU, in evaluation mode.

    Raises:
        GeoEvsError: the file is missing, damaged, or no detector.
    """
    settings, weights = read_network(path)
    if not isinstance(settings, dict) or set(settings) != {"detector", "classes", "backbone"}:
        raise GeoEvsError(f"{path} holds no detector; {RETRAIN}")
    backbone = described_backbone(path, settings["backbone"])
    with built_as_described(path, RETRAIN):
        detector = make_settings("its detector", Detector, settings["detector"])
        classes = [str(name) for name in settings["classes"]]
        model = BevFormer(detector, classes, backbone)
    load_weights(model, weights, path, RETRAIN)
    return model.eval()
