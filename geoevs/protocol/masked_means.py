"""Means over valid pixels of any number of images: what every image metric is made of."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import cv2
import numpy as np


@dataclass
class MaskedMean(ABC):
    """A mean over valid pixels, or windows, of any number of images.

    Every valid value weighs the same, whichever image it comes from.

    Attributes:
        data_range: the largest value of an image minus the smallest one it could have.
        total: the sum so far.
        count: how many values it sums.
        higher_is_better: whether a larger value is the better one.
    """

    data_range: float = 1.0
    total: float = field(default=0.0, init=False)
    count: int = field(default=0, init=False)
    higher_is_better: ClassVar[bool] = True

    @abstractmethod
    def update(
        self,
        preds: np.ndarray,  # [H, W, C]
        target: np.ndarray,  # [H, W, C]
        mask: np.ndarray,  # [H, W] bool
    ) -> None:
        """Add one image; values outside the mask do not count.

        Args:
            preds: the picture to score.
            target: the truth, of the same shape; `data_range` is said of both.
            mask: the valid pixels, all channels of each.
        """

    def compute(self) -> float:
        """The metric over everything added; NaN where nothing was."""
        return self.finish(self.total / self.count) if self.count else math.nan

    def finish(self, mean: float) -> float:
        """The metric in its own unit, from the mean over all that was added."""
        return mean

    @classmethod
    def missing(cls) -> str:
        """The reason why this machine cannot compute it, in one sentence; empty where it can."""
        return ""


def precision_of(*images: np.ndarray) -> np.dtype:
    """What arithmetic on images runs in: float32, unless one has more; sums are always float64."""
    return np.result_type(np.float32, *images)


def sum_of(values: np.ndarray) -> float:
    """The sum of values of any shape, in float64 whatever their type."""
    return float(values.sum(dtype=np.float64))


class MaskedPixelMean(MaskedMean):
    """Mean over valid pixels of an error that needs no neighbours; subclasses say which.

    Attributes:
        norm: OpenCV's name of the error that is summed over pixels and channels.
        per_channel: whether the error is averaged over channels, not summed.
    """

    norm: ClassVar[int]
    per_channel: ClassVar[bool] = True

    def update(
        self,
        preds: np.ndarray,  # [H, W, C]
        target: np.ndarray,  # [H, W, C]
        mask: np.ndarray,  # [H, W] bool
    ) -> None:
        """Add one image's valid pixels."""
        precision = precision_of(preds, target)
        x, y = (np.ascontiguousarray(image, precision) for image in (preds, target))
        error = cv2.norm(x, y, self.norm, None if mask.all() else mask.astype(np.uint8))
        self.total += error / preds.shape[-1] if self.per_channel else error
        self.count += int(mask.sum())
