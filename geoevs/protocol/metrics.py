"""Masked image metrics as sums: update with images, compute once (paper section 3.5).

Every metric takes `preds` and `target`, (H, W, C) in [0, 1], and `mask`, (H, W) bool, the valid
pixels; what other pixels hold, NaN included, never matters. A full mask gives the usual dense
metric. No valid pixel at all gives NaN.

In the formulas below x and y are the predicted and the true image, M is the set of valid pixels of
all images added, |M| their number, C the number of channels and R the `data_range`; a sum over M
runs over the pixels' channels too.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np

from geoevs.protocol.learned_features import learned_features
from geoevs.protocol.masked_means import MaskedMean, MaskedPixelMean, precision_of, sum_of
from geoevs.protocol.weights import missing_efficientnet, missing_weights


class MAE(MaskedPixelMean):
    """Mean absolute error: sum over M of |x - y| / (C |M|)."""

    higher_is_better = False
    norm = cv2.NORM_L1


class RMSE(MaskedPixelMean):
    """Root mean squared error: sqrt(sum over M of (x - y)^2 / (C |M|))."""

    higher_is_better = False
    norm = cv2.NORM_L2SQR

    def finish(self, mean: float) -> float:
        """The root of the mean squared error."""
        return math.sqrt(mean)


class PSNR(MaskedPixelMean):
    """Peak signal-to-noise ratio in dB: 10 log10(R^2 / E), E = sum over M of (x - y)^2 / (C |M|).

    An exact copy has infinity. With a full mask this is scikit-image's `peak_signal_noise_ratio`.

    >>> metric = PSNR()
    >>> metric.update(np.full((1, 2, 3), 0.6), np.full((1, 2, 3), 0.5), np.ones((1, 2), bool))
    >>> round(metric.compute(), 6)  # 10 log10(1 / 0.1 ** 2)
    20.0
    """

    norm = cv2.NORM_L2SQR

    def finish(self, mean: float) -> float:
        """Decibels of the mean squared error."""
        return math.inf if mean == 0 else 10 * math.log10(self.data_range**2 / mean)


class PSNRSum(PSNR):
    """The paper's literal S-PSNR: 10 log10(R^2 / E), E = sum over M of (x - y)^2 / |M|.

    Section 3.5 of the paper sums the squared error over channels and does not average it: of three
    channels the value is 10 log10(3) = 4.77 dB below PSNR's.
    """

    per_channel = False


SSIM_SIGMA = 1.5
"""Standard deviation of a window's Gaussian weights, in pixels (Wang et al. 2004)."""
SSIM_RADIUS = 5
"""Pixels from a window's centre to its border: windows are 11 x 11 (Wang et al. 2004)."""
SSIM_K1, SSIM_K2 = 0.01, 0.03
"""Shares of the data range that keep SSIM's quotients finite (Wang et al. 2004)."""
SSIM_MIN_EFFECTIVE_PIXELS = 3.0
"""Fewest effective pixels of a window that counts, by Kish: (sum of w)^2 / sum of w^2.

A window with one effective pixel has no variance and scores luminance alone; under a full mask a
window has 28.
"""


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

    A window is 11 x 11 pixels with Gaussian weights w, and w = 0 at invalid pixels. For every
    window and channel::

        mx = sum of w x / sum of w                    my = sum of w y / sum of w
        vx = sum of w x^2 / sum of w - mx^2           vy = sum of w y^2 / sum of w - my^2
        c = sum of w x y / sum of w - mx my
        SSIM = (2 mx my + C1) (2 c + C2) / ((mx^2 + my^2 + C1) (vx + vy + C2))

    with C1 = (0.01 R)^2 and C2 = (0.03 R)^2 (Wang et al. 2004; normalised convolution is Knutsson
    and Westin's, 1993). The metric is its mean over channels and over windows that lie within the
    image, whose centre is valid and which hold SSIM_MIN_EFFECTIVE_PIXELS. With a full mask this is
    scikit-image's `structural_similarity(gaussian_weights=True, use_sample_covariance=False)`.
    torchmetrics' counts windows across the border too, over reflected pixels, and is up to 0.005
    higher.

    Images of at most 32 bits are filtered in float32 (see `precision_of`). There a variance is the
    small difference of large numbers: in flat windows, as of a dark street, SSIM is some 1e-6 off
    what float64 gives.
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
        precision = precision_of(preds, target)
        similarity = self._similarity(preds.astype(precision), target.astype(precision), norm)
        self.total += sum_of(similarity if norm is None else similarity[centres]) / preds.shape[-1]
        self.count += int(centres.sum())

    def _similarity(self, x: np.ndarray, y: np.ndarray, norm: np.ndarray | None) -> np.ndarray:
        """(H - 10, W - 10, C) SSIM of every window of zero-filled images: the class's formula.

        `norm` holds the windows' weight sums, (H - 10, W - 10, 1); None says that all of them are
        one. The two variances are only ever added, hence one blur of x^2 + y^2 gives vx + vy. The
        steps work in place: `product` becomes 2 mx my + C1, `covariance` 2 c + C2, `squares`
        mx^2 + my^2 + C1 and `variances` vx + vy + C2. At 512 x 512 making new arrays would take as
        long as filling them.
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
    """`values` themselves, made scale * values + shift in place."""
    values *= scale
    values += shift
    return values


def _windows(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight sums of the windows, (H - 10, W - 10, 1), and which windows count, (H - 10, W - 10).

    The sum of a window that does not count is one, so that it can be divided by.
    """
    weights = mask.astype(np.float64)
    norm = _blur(weights)
    effective = norm**2 / np.maximum(_blur(weights, _KERNEL**2), 1e-12)
    inner = slice(SSIM_RADIUS, -SSIM_RADIUS)
    centres = mask[inner, inner] & (effective >= SSIM_MIN_EFFECTIVE_PIXELS)
    return np.where(centres, norm, 1.0)[..., None], centres


class SSIMZeroFill(SSIM):
    """The naive reading of sparse SSIM: dense SSIM of both images with invalid pixels set to zero.

    It is SSIM's formula without a mask, averaged over every window within the image. Windows where
    both images are black score one, hence it inflates as support shrinks.
    """

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
"""T of the formula for images in [0, 1]: 170 / 255^2, from Xue et al.'s T = 170 of 8-bit images."""


class GMS(MaskedMean):
    """Mean gradient magnitude similarity of the luma at half resolution (Xue et al. 2014, GMSM).

    The mean of (2 gx gy + T) / (gx^2 + gy^2 + T), where gx and gy are the lengths of the two
    images' Prewitt gradients and T = GMS_STABILITY R^2. The luma is the mean of the channels,
    averaged over 2 x 2 pixels. The mean runs over pixels of the halved image whose 3 x 3
    neighbourhood is valid. Lost edges and added edges lower it; a copy has 1. It needs no weights.
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
        self.total += sum_of(similarity[whole])
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
    """Learned perceptual distance (Zhang et al. 2018), by AlexNet, whose weights must be here.

    The mean over M of d, a map as large as the image: d = sum over layers of the enlarged map
    sum over channels of w (f(x) - f(y))^2. There f are a layer's features, scaled to length one at
    every place, and w the learned weights of its channels. Invalid pixels are black in both images.
    """

    higher_is_better = False

    @classmethod
    def missing(cls) -> str:
        """The reason why this machine cannot compute it, in one sentence; empty where it can."""
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


class EfficientNetLayers(MaskedMean):
    """Distance of two pictures by the maps of EfficientNet-Lite0, without any learned weights.

    Its mean over pictures (see `geoevs.core.efficientnet.layer_distance`). The network was trained
    on ImageNet, and the distance was fitted to nobody's judgement: this is not LPIPS. Invalid
    pixels show the truth in both pictures.
    """

    higher_is_better = False

    @classmethod
    def missing(cls) -> str:
        """The reason why this machine cannot compute it, in one sentence; empty where it can."""
        return missing_efficientnet()

    def update(
        self,
        preds: np.ndarray,  # [H, W, C]
        target: np.ndarray,  # [H, W, C]
        mask: np.ndarray,  # [H, W] bool
    ) -> None:
        """Add one picture, if any of its pixels is valid."""
        if not mask.any():
            return
        from geoevs.core.efficientnet import layer_distance

        shown = np.where(mask[..., None], preds, target)
        x, y = (learned_features(image / self.data_range).layers for image in (shown, target))
        self.total += float(layer_distance(x, y))
        self.count += 1


@dataclass(frozen=True)
class MetricSpec:
    """A named metric: its kind, and which of a target's masks it runs over (see scoring).

    Args:
        kind: the metric.
        region: a name of the region.
        unit: what its numbers count.
        with_sets: whether it is scored with the distances of sets, whose features it shares, and
            on their splits alone.
    """

    kind: type[MaskedMean]
    region: str
    unit: str = ""
    with_sets: bool = False

    @property
    def higher_is_better(self) -> bool:
        """Whether a larger value is the better one."""
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
    "efficientnet_layers": MetricSpec(EfficientNetLayers, "dense", with_sets=True),
}
"""Every metric by its name in the rows, with the region of a target that it runs over.

Regions of the sparse reference are its valid pixels (`reference`), those of them that raw
reprojection leaves empty (`new`), and those whose point also passes the footprint test. Regions of
the dense truth, where there is one, are all its pixels (`dense`), those that raw reprojection
supports (`supported`), and the others (`new`).

Masked targets have regions of their own: pixels that the degraded condition still has
(`supported`), pixels that the mask took from it (`removed`), pixels that it never had (`never`),
and the last two together (`unsupported`). The stability suite tells pixels inside the boxes of
moving cars (`moving`) from all others (`still`).
"""
