"""Masked image metrics as sums: update with images, compute once (paper section 3.5).

Every metric takes `preds` and `target`, (H, W, C) in [0, 1], and `mask`, (H, W) bool, the valid
pixels; what other pixels hold, NaN included, never matters. A full mask gives the usual dense
metric. No valid pixel at all gives NaN.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

import cv2
import numpy as np

from geoevs.protocol.weights import missing_weights


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

    @classmethod
    def missing(cls) -> str:
        """Why this machine cannot compute it, in one sentence; empty where it can."""
        return ""


def _precision(*images: np.ndarray) -> np.dtype:
    """What arithmetic on images runs in: float32, unless one has more; sums are always float64."""
    return np.result_type(np.float32, *images)


def _sum(values: np.ndarray) -> float:
    return float(values.sum(dtype=np.float64))


class MaskedPixelMean(MaskedMean):
    """Mean over valid pixels of an error of each pixel alone; subclasses say which.

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
        precision = _precision(preds, target)
        x, y = (np.ascontiguousarray(image, precision) for image in (preds, target))
        error = cv2.norm(x, y, self.norm, None if mask.all() else mask.astype(np.uint8))
        self.total += error / preds.shape[-1] if self.per_channel else error
        self.count += int(mask.sum())


class MAE(MaskedPixelMean):
    """Mean absolute error per channel."""

    higher_is_better = False
    norm = cv2.NORM_L1


class RMSE(MaskedPixelMean):
    """Root mean squared error per channel."""

    higher_is_better = False
    norm = cv2.NORM_L2SQR

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

    norm = cv2.NORM_L2SQR

    def finish(self, mean: float) -> float:
        """Decibels."""
        return math.inf if mean == 0 else 10 * math.log10(self.data_range**2 / mean)


class PSNRSum(PSNR):
    """The paper's literal S-PSNR: the squared norm summed over channels (4.77 dB lower)."""

    per_channel = False


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
    blurred = cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
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
        if mask.all():
            norm, centres = None, mask[SSIM_RADIUS:-SSIM_RADIUS, SSIM_RADIUS:-SSIM_RADIUS]
        else:
            norm, centres = _windows(mask)
            valid = mask[..., None]
            preds, target = np.where(valid, preds, 0.0), np.where(valid, target, 0.0)
        precision = _precision(preds, target)
        similarity = self._similarity(preds.astype(precision), target.astype(precision), norm)
        self.total += _sum(similarity if norm is None else similarity[centres]) / preds.shape[-1]
        self.count += int(centres.sum())

    def _similarity(self, x: np.ndarray, y: np.ndarray, norm: np.ndarray | None) -> np.ndarray:
        """(H - 10, W - 10, C) SSIM map of zero-filled images, given the windows' weight sums.

        Without sums all of them are one. It needs the sum of both variances alone, and steps work
        in place: at 512 x 512, making arrays takes as long as filling them.
        """
        mean_x, mean_y, variances, covariance = (_blur(z) for z in (x, y, x * x + y * y, x * y))
        if norm is not None:
            for windows in (mean_x, mean_y, variances, covariance):
                windows /= norm
        c1, c2 = (SSIM_K1 * self.data_range) ** 2, (SSIM_K2 * self.data_range) ** 2
        product = mean_x * mean_y
        squares = np.square(mean_x, out=mean_x)
        squares += np.square(mean_y, out=mean_y)
        covariance -= product
        variances -= squares
        numerator = _scale_shift(product, 2, c1)
        numerator *= _scale_shift(covariance, 2, c2)
        squares += c1
        variances += c2
        squares *= variances
        numerator /= squares
        return numerator


def _scale_shift(values: np.ndarray, scale: float, shift: float) -> np.ndarray:
    """In place."""
    values *= scale
    values += shift
    return values


def _windows(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight sums of the windows (H - 10, W - 10, 1), and which of them count; one where not."""
    weights = mask.astype(np.float64)
    norm = _blur(weights)
    effective = norm**2 / np.maximum(_blur(weights, _KERNEL**2), 1e-12)
    inner = slice(SSIM_RADIUS, -SSIM_RADIUS)
    centres = mask[inner, inner] & (effective >= SSIM_MIN_EFFECTIVE_PIXELS)
    return np.where(centres, norm, 1.0)[..., None], centres


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


GMS_STABILITY = 0.0026


class GMS(MaskedMean):
    """Mean gradient magnitude similarity of the luma at half resolution (Xue et al. 2014, GMSM).

    What is left of edges, and what edges were added: a perceptual metric without weights. It runs
    over pixels of the halved image whose 3 x 3 neighbourhood is valid.
    """

    def update(
        self,
        preds: np.ndarray,  # [H, W, C]
        target: np.ndarray,  # [H, W, C]
        mask: np.ndarray,  # [H, W] bool
    ) -> None:
        """Add one image's valid neighbourhoods."""
        x, y = (self._gradients(np.where(mask[..., None], image, 0)) for image in (preds, target))
        stability = GMS_STABILITY * self.data_range**2
        similarity = (2 * x * y + stability) / (x * x + y * y + stability)
        valid = (_sum_of_halves(mask.astype(np.uint8)) == 4).astype(np.uint8)
        whole = cv2.erode(valid, np.ones((3, 3)))[1:-1, 1:-1] == 1
        self.total += _sum(similarity[whole])
        self.count += int(whole.sum())

    @staticmethod
    def _gradients(image: np.ndarray) -> np.ndarray:
        """(H // 2 - 2, W // 2 - 2) Prewitt magnitudes of the halved luma, off its border.

        In NumPy: the last bits of OpenCV's filters depend on where an image lies in memory.
        """
        luma = _sum_of_halves(image.mean(axis=-1, dtype=np.float64)) / 4
        down = luma[:-2] + luma[1:-1] + luma[2:]
        across = luma[:, :-2] + luma[:, 1:-1] + luma[:, 2:]
        dx, dy = (down[:, :-2] - down[:, 2:]) / 3, (across[:-2] - across[2:]) / 3
        return np.sqrt(dx * dx + dy * dy)


def _sum_of_halves(image: np.ndarray) -> np.ndarray:
    """Sums of 2 x 2 pixels of (H, W); an odd last row or column is dropped."""
    height, width = (2 * (side // 2) for side in image.shape)
    whole = image[:height, :width]
    return whole[::2, ::2] + whole[1::2, ::2] + whole[::2, 1::2] + whole[1::2, 1::2]


class LPIPS(MaskedMean):
    """Learned perceptual distance (Zhang et al. 2018) with AlexNet, where its weights are here."""

    higher_is_better = False

    @classmethod
    def missing(cls) -> str:
        """Why this machine cannot compute it."""
        return missing_weights("lpips", "alexnet-owt-7be5be79.pth")

    def update(
        self,
        preds: np.ndarray,  # [H, W, C]
        target: np.ndarray,  # [H, W, C]
        mask: np.ndarray,  # [H, W] bool
    ) -> None:
        """Add the distance at one image's valid pixels; invalid ones are black in both."""
        import torch

        x, y = (
            torch.from_numpy(np.where(mask[..., None], image, 0).astype(np.float32))
            .permute(2, 0, 1)[None]
            .div(self.data_range)
            for image in (preds, target)
        )
        with torch.inference_mode():
            distance = _alexnet_distance()(x, y, normalize=True)[0, 0].numpy()
        self.total += float(distance[mask].sum(dtype=np.float64))
        self.count += int(mask.sum())


@cache
def _alexnet_distance() -> Any:
    import lpips

    return lpips.LPIPS(net="alex", spatial=True, verbose=False).eval()


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
    "gms": MetricSpec(GMS, "dense"),
    "lpips": MetricSpec(LPIPS, "dense"),
}
"""Every metric by its name in the rows. Regions: the sparse reference's valid pixels, those of
them that raw reprojection leaves empty (`new`), those whose point also passes the footprint test,
and the dense truth's pixels, where there is one, `supported` by raw reprojection or not (`new`).
Masked targets have other ones: pixels that the degraded condition still has (`supported`), that the
mask took from it (`removed`), that it never had (`never`), and both of these (`unsupported`). The
stability suite tells pixels inside boxes of moving cars (`moving`) from others (`still`)."""
