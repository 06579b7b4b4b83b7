"""What a detector is made of and how it learns: sections of the config, with their defaults.

Torch is not imported here, because configs are checked without it.
"""

from dataclasses import dataclass
from typing import Annotated

from geoevs.core.errors import GeoEvsError
from geoevs.core.settings import Count, OneOf, Positive, Share, Within, check_fields

BACKBONES = ("cnn", "vggt-nano", "autoencoder", "efficientnet")
"""What makes features of pictures: a small network that learns with a detector of recorded views;
this suite's depth network; its autoencoder; EfficientNet-Lite0. The last three are pretrained."""

STRIDE = 8
"""Pixels of a picture per place of its features, each way."""

HEADS, GROUPS = 4, 8
"""Of every attention, and of every group normalisation; channels divide by both."""

Side = Annotated[int, Within(STRIDE, 8192)]
Cells = Annotated[int, Within(2, 1000)]
Layers = Annotated[int, Within(1, 12)]


@dataclass(frozen=True)
class Detector:
    """The network; the default learns within minutes of a core.

    Args:
        image: height and width that pictures are resized to, multiples of STRIDE.
        backbone: of BACKBONES.
        channels: of features, queries and BEV.
        range: x, y and z from, then x, y and z to: metres in the vehicle's frame, where boxes'
            centres may lie.
        grid: cells along x and along y.
        encoder: layers from pictures to BEV.
        heights: points of a cell's pillar that are looked up in the pictures.
        points: places that an attention head looks at in a picture, a multiple of `heights`.
        history: earlier frames whose BEV goes into that of a training frame; 0: none is kept.
        decoder: layers from BEV to boxes.
        queries: boxes that are looked for, each of any class.
        predictions: the most that are told of a frame, by falling score.

    Raises:
        GeoEvsError: a value is out of bounds, or values do not fit together.
    """

    image: tuple[Side, Side] = (64, 96)
    backbone: Annotated[str, OneOf(BACKBONES)] = "cnn"
    channels: Annotated[int, Within(8, 2048)] = 48
    range: tuple[float, float, float, float, float, float] = (-4.0, -18.0, -0.4, 32.0, 18.0, 2.6)
    grid: tuple[Cells, Cells] = (24, 24)
    encoder: Layers = 1
    heights: Annotated[int, Within(1, 16)] = 4
    points: Annotated[int, Within(1, 64)] = 8
    history: Annotated[int, Within(0, 10)] = 1
    decoder: Layers = 2
    queries: Annotated[int, Within(1, 10_000)] = 40
    predictions: Annotated[int, Within(1, 10_000)] = 60

    def __post_init__(self) -> None:
        check_fields("a detector", self)
        for name in ("image", "range", "grid"):  # which a config has as lists
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if any(side % STRIDE for side in self.image):
            raise GeoEvsError(
                f"a detector's image of {self.image[0]} x {self.image[1]} does not divide into "
                f"features; choose multiples of {STRIDE}"
            )
        if self.channels % (2 * HEADS) or self.channels % GROUPS:
            raise GeoEvsError(
                f"a detector cannot have {self.channels} channels; choose a multiple of {GROUPS}"
            )
        if self.points % self.heights:
            raise GeoEvsError(
                f"a detector's {self.points} points do not divide among {self.heights} heights; "
                f"choose a multiple of {self.heights}"
            )
        if any(low >= high for low, high in zip(self.range[:3], self.range[3:], strict=True)):
            raise GeoEvsError(
                f"a detector's range {list(self.range)} is empty; write x, y and z from, then x, "
                "y and z to"
            )


@dataclass(frozen=True)
class Fitting:
    """How a detector learns.

    Args:
        steps, batch, learning_rate: of the optimiser, AdamW.
        warmup: share of the steps in which the learning rate rises.
        flip: whether every second frame is mirrored, with its boxes and cameras.
        jitter: whether the brightness of every view varies.
        backbone_steps: that the backbone `cnn` learns for, with a detector of its own.
        end_to_end: whether the backbone goes on learning with every detector.
    """

    steps: Count = 1600
    batch: Count = 1
    learning_rate: Positive = 2.0e-3
    warmup: Share = 0.05
    flip: bool = False
    jitter: bool = False
    backbone_steps: Count = 1600
    end_to_end: bool = False

    def __post_init__(self) -> None:
        check_fields("the training of a detector", self)

    @property
    def sees_pictures(self) -> bool:
        """Whether it needs pictures, where features that were made once do not do."""
        return self.flip or self.jitter or self.end_to_end
