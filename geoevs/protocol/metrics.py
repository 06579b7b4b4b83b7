"""Masked image metrics as sums: update with images, compute once (paper section 3.5).

Every metric takes `preds` and `target`, (H, W, C) in [0, 1], and `mask`, (H, W) bool, the valid
pixels; what other pixels hold, NaN included, never matters. A full mask gives the usual dense
metric. No valid pixel at all gives NaN.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import cv2
import numpy as np


@dataclass
class MaskedMean(ABC):
    """A mean over valid pixels, or windows, of any number of images.

    Attributes:
        total: the sum so far.
        count: how many values it sums.
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
        """Add one image."""

    def compute(self) -> float:
        """The metric over everything added; NaN where nothing was."""
        return self.finish(self.total / self.count) if self.count else math.nan

    def finish(self, mean: float) -> float:
        """From the mean to the metric's own unit."""
        return mean


class MaskedPixelMean(MaskedMean):
    """Mean over valid pixels of an error of each pixel alone; subclasses say which."""

    def update(
        self,
        preds: np.ndarray,  # [H, W, C]
        target: np.ndarray,  # [H, W, C]
        mask: np.ndarray,  # [H, W] bool
    ) -> None:
        """Add one image's valid pixels."""
        difference = preds[mask].astype(np.float64) - target[mask]
        self.total += float(self.error(difference).sum())
        self.count += len(difference)

    @abstractmethod
    def error(self, difference: np.ndarray) -> np.ndarray:
        """(N, C) differences to (N,) errors."""


class MAE(MaskedPixelMean):
    """Mean absolute error per channel."""

    higher_is_better = False

    def error(self, difference: np.ndarray) -> np.ndarray:
        """(N, C) differences to (N,) errors."""
        return np.abs(difference).mean(axis=1)


class RMSE(MaskedPixelMean):
    """Root mean squared error per channel."""

    higher_is_better = False

    def error(self, difference: np.ndarray) -> np.ndarray:
        """(N, C) differences to (N,) errors."""
        return np.square(difference).mean(axis=1)

    def finish(self, mean: float) -> float:
        """The root."""
        return math.sqrt(mean)


class PSNR(MaskedPixelMean):
    """Peak signal-to-noise ratio in dB, squared error averaged over channels; exact = infinity.

    >>> metric = PSNR()
    >>> metric.update(np.full((1, 2, 3), 0.6), np.full((1, 2, 3), 0.5), np.ones((1, 2), bool))
    >>> round(metric.compute(), 6)  # 10 log10(1 / 0.1 ** 2)
    20.0
    """

    def error(self, difference: np.ndarray) -> np.ndarray:
        """(N, C) differences to (N,) errors."""
        return np.square(difference).mean(axis=1)

    def finish(self, mean: float) -> float:
        """Decibels."""
        return math.inf if mean == 0 else 10 * math.log10(self.data_range**2 / mean)


class PSNRSum(PSNR):
    """The paper's literal S-PSNR: the squared norm summed over channels (4.77 dB lower)."""

    def error(self, difference: np.ndarray) -> np.ndarray:
        """(N, C) differences to (N,) errors."""
        return np.square(difference).sum(axis=1)


SSIM_SIGMA = 1.5
SSIM_RADIUS = 5
SSIM_K1, SSIM_K2 = 0.01, 0.03
# A window with one effective pixel has no variance and scores luminance alone. Kish's effective
# count, (sum w)^2 / sum w^2, is 1 there and 28 under a full mask.
SSIM_MIN_EFFECTIVE_PIXELS = 3.0


def _gaussian() -> np.ndarray:
    offsets = np.arange(-SSIM_RADIUS, SSIM_RADIUS + 1)
    weights = np.exp(-0.5 * np.square(offsets / SSIM_SIGMA))
    return weights / weights.sum()


_KERNEL = _gaussian()


def _blur(image: np.ndarray, kernel: np.ndarray = _KERNEL) -> np.ndarray:
    """Separable filter of (H, W, C) or (H, W), cropped to windows that lie within the image."""
    blurred = cv2.sepFilter2D(image, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
    inner = slice(SSIM_RADIUS, -SSIM_RADIUS)
    return blurred[inner, inner]


class SSIM(MaskedMean):
    """Structural similarity by normalised convolution: window sums run over valid pixels only.

    Gaussian 11 x 11 windows, sigma 1.5, averaged over valid centres whose window lies within the
    image and holds SSIM_MIN_EFFECTIVE_PIXELS. With a full mask this is scikit-image's
    `structural_similarity(gaussian_weights=True, use_sample_covariance=False)`.
    """

    def update(
        self,
        preds: np.ndarray,  # [H, W, C]
        target: np.ndarray,  # [H, W, C]
        mask: np.ndarray,  # [H, W] bool
    ) -> None:
        """Add one image's valid windows."""
        if min(mask.shape) <= 2 * SSIM_RADIUS or not mask.any():
            return
        weights = mask.astype(np.float64)
        norm = _blur(weights)
        effective = norm**2 / np.maximum(_blur(weights, _KERNEL**2), 1e-12)
        inner = slice(SSIM_RADIUS, -SSIM_RADIUS)
        centres = mask[inner, inner] & (effective >= SSIM_MIN_EFFECTIVE_PIXELS)
        norm = np.where(centres, norm, 1.0)[..., None]
        x = np.where(mask[..., None], preds, 0.0).astype(np.float64)
        y = np.where(mask[..., None], target, 0.0).astype(np.float64)
        similarity = self._similarity(x, y, norm)
        self.total += float(similarity[centres].mean(axis=1).sum())
        self.count += int(centres.sum())

    def _similarity(self, x: np.ndarray, y: np.ndarray, norm: np.ndarray) -> np.ndarray:
        """(H - 10, W - 10, C) SSIM map of zero-filled images, given the windows' weight sums."""
        mean_x, mean_y = _blur(x) / norm, _blur(y) / norm
        variance_x = _blur(x * x) / norm - mean_x**2
        variance_y = _blur(y * y) / norm - mean_y**2
        covariance = _blur(x * y) / norm - mean_x * mean_y
        c1, c2 = (SSIM_K1 * self.data_range) ** 2, (SSIM_K2 * self.data_range) ** 2
        luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
        return luminance * (2 * covariance + c2) / (variance_x + variance_y + c2)


class SSIMZeroFill(SSIM):
    """The naive reading: dense SSIM of zero-filled images. It inflates as support shrinks."""

    def update(
        self,
        preds: np.ndarray,  # [H, W, C]
        target: np.ndarray,  # [H, W, C]
        mask: np.ndarray,  # [H, W] bool
    ) -> None:
        """Add one image, every window of it."""
        if not mask.any():
            return
        valid = mask[..., None]
        zero_filled = (np.where(valid, preds, 0.0), np.where(valid, target, 0.0))
        super().update(*zero_filled, np.ones_like(mask))


@dataclass(frozen=True)
class MetricSpec:
    """A named metric: its kind, and which of a target's masks it runs over (see scoring)."""

    kind: type[MaskedMean]
    region: str
    unit: str = ""

    @property
    def higher_is_better(self) -> bool:
        """The better direction."""
        return self.kind.higher_is_better


METRICS = {
    "sparse_psnr": MetricSpec(PSNR, "reference", "dB"),
    "sparse_psnr_sum": MetricSpec(PSNRSum, "reference", "dB"),
    "sparse_psnr_new": MetricSpec(PSNR, "reference-new", "dB"),
    "sparse_psnr_footprint": MetricSpec(PSNR, "reference-footprint", "dB"),
    "sparse_mae": MetricSpec(MAE, "reference"),
    "sparse_rmse": MetricSpec(RMSE, "reference"),
    "sparse_ssim": MetricSpec(SSIM, "reference"),
    "sparse_ssim_zero_fill": MetricSpec(SSIMZeroFill, "reference"),
    "psnr": MetricSpec(PSNR, "dense", "dB"),
    "psnr_new": MetricSpec(PSNR, "dense-new", "dB"),
    "psnr_supported": MetricSpec(PSNR, "dense-supported", "dB"),
    "psnr_removed": MetricSpec(PSNR, "dense-removed", "dB"),
    "psnr_never": MetricSpec(PSNR, "dense-never", "dB"),
    "psnr_unsupported": MetricSpec(PSNR, "dense-unsupported", "dB"),
    "psnr_moving": MetricSpec(PSNR, "dense-moving", "dB"),
    "psnr_still": MetricSpec(PSNR, "dense-still", "dB"),
    "sparse_psnr_removed": MetricSpec(PSNR, "reference-removed", "dB"),
    "ssim": MetricSpec(SSIM, "dense"),
    "mae": MetricSpec(MAE, "dense"),
}
"""Every metric by its name in the rows. Regions: the sparse reference's valid pixels, those of
them that raw reprojection leaves empty (`new`), those whose point also passes the footprint test,
and the dense truth's pixels, where there is one, `supported` by raw reprojection or not (`new`).
Masked targets have other ones: pixels that the degraded condition still has (`supported`), that the
mask took from it (`removed`), that it never had (`never`), and both of these (`unsupported`). The
stability suite tells pixels inside boxes of moving cars (`moving`) from others (`still`)."""
