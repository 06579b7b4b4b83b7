"""Distances between what a method renders and what is true, as sets of images.

The real FID and KID run where their network is on the machine. `efficientnet_fd` and
`efficientnet_kd` are their formulas on the features of another network, whose weights a package
ships: their numbers compare with nobody's FID or KID. `texture_energy` needs no weights: it is the
energy distance, estimated as KID is, of statistics of derivatives at several scales.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from statistics import NormalDist
from typing import Any

import cv2
import numpy as np
from scipy.spatial.distance import cdist

from geoevs.protocol.learned_features import learned_features
from geoevs.protocol.weights import missing_efficientnet, missing_weights

INCEPTION = "weights-inception-2015-12-05-6726825d.pth"
"""The file of Inception's weights, as torch-fidelity names it."""
LEVELS = 4
"""Most levels of the pyramid on which texture is measured."""
SMALLEST_SIDE = 8
"""Pixels that the shorter side of the pyramid's coarsest level has at least."""
MOST_PAIRS = 2**24
"""Pairs of views whose kernel is in memory at once: those of 4,096 views, 128 MB a matrix."""
DARKEST = 0.25 / 255
"""Added to deviations so that logarithms stay finite; less than 8 bits can tell."""


def texture_features(image: np.ndarray) -> np.ndarray:
    """(D,) statistics of an (H, W, 3) image in [0, 1]: its colours, and its texture at each scale.

    The first six are, with e = DARKEST, each channel's mean and log(standard deviation + e). Then
    follow, for every level of a Gaussian pyramid, axis and channel, with d the differences of
    neighbouring pixels, 0.5 log(mean(d^2) + e^2) and log(mean(|d|) + e). Blur lowers these,
    noise raises them, and holes pull the two apart.
    """
    level: np.ndarray = image.astype(np.float32)
    features = [level.mean(axis=(0, 1)), np.log(level.std(axis=(0, 1)) + DARKEST)]
    for _ in range(LEVELS):
        for axis in (0, 1):
            derivative = np.diff(level, axis=axis).reshape(-1, 3)
            features.append(0.5 * np.log(np.square(derivative).mean(axis=0) + DARKEST**2))
            features.append(np.log(np.abs(derivative).mean(axis=0) + DARKEST))
        if min(level.shape[:2]) < 2 * SMALLEST_SIDE:
            break
        level = cv2.pyrDown(level)
    return np.concatenate(features).astype(np.float64)


def inception_features(image: np.ndarray) -> np.ndarray:
    """(2048,) pool features of torch-fidelity's Inception of an (H, W, 3) image in [0, 1]."""
    import torch

    from geoevs.core.images import to_uint8

    pixels = torch.from_numpy(to_uint8(image)).permute(2, 0, 1)[None]
    with torch.inference_mode():
        return _inception()(pixels)[0][0].double().numpy()


def efficientnet_features(image: np.ndarray) -> np.ndarray:
    """(1280,) features of EfficientNet-Lite0 of an (H, W, 3) image in [0, 1]."""
    return learned_features(image).whole.astype(np.float64)


@cache
def _inception() -> Any:
    from torch_fidelity.feature_extractor_inceptionv3 import FeatureExtractorInceptionV3

    return FeatureExtractorInceptionV3("inception-v3-compat", ["2048"])


@dataclass(frozen=True)
class Estimate:
    """A distance between two sets of images, and the ends of its interval (NaN: it has none)."""

    value: float
    low: float = np.nan
    high: float = np.nan


def unbiased_mmd(
    x: np.ndarray,  # [N, D]
    y: np.ndarray,  # [N, D] paired: features of the same views
    frames: np.ndarray,  # [N] which frame each view belongs to
    confidence: float,
    kernel: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Estimate:
    """Squared maximum mean discrepancy of paired sets.

    The one-sample U-statistic of Gretton et al. 2012 (lemma 6)::

        sum over i != j of (k(xi, xj) + k(yi, yj) - k(xi, yj) - k(xj, yi)) / (N (N - 1))

    It is unbiased, so it may be negative, and it is zero for exact copies. The normal interval
    comes from the jackknife that leaves out one frame at a time, since a frame's views are alike.
    """
    if len(x) < 2:
        return Estimate(np.nan)
    names, index = np.unique(frames, return_inverse=True)
    member = np.eye(len(names))[index]  # [N, F]
    between = np.zeros((len(names), len(names)))
    whole = 0.0
    for rows in _blocks(len(x)):
        sums = kernel(x[rows], x) + kernel(y[rows], y)
        sums -= kernel(x[rows], y) + kernel(x, y[rows]).T
        np.fill_diagonal(sums[:, rows], 0.0)
        between += member[rows].T @ sums @ member
        whole += sums.sum()
    counts = member.sum(axis=0)
    value = whole / (len(x) * (len(x) - 1))
    if len(names) < 3:
        return Estimate(float(value))
    left = len(x) - counts
    total = whole - 2 * between.sum(axis=1) + np.diag(between)
    without = total / (left * (left - 1))
    spread = np.sqrt((len(names) - 1) * np.mean((without - without.mean()) ** 2))
    reach = NormalDist().inv_cdf(0.5 + confidence / 2) * spread
    return Estimate(float(value), float(value - reach), float(value + reach))


def _blocks(count: int) -> Iterator[slice]:
    """All of `count` views in blocks, each with at most MOST_PAIRS pairs with all views."""
    height = max(1, MOST_PAIRS // count)
    yield from (slice(first, first + height) for first in range(0, count, height))


def kernel_distance(
    x: np.ndarray,  # [N, D]
    y: np.ndarray,  # [N, D]
    frames: np.ndarray,  # [N]
    confidence: float,
) -> Estimate:
    """KID (Binkowski et al. 2018): `unbiased_mmd` of the kernel k(x, y) = (x . y / D + 1)^3.

    It is torch-fidelity's estimator `u-statistic`, of all pairs at once. Papers report its default
    `unbiased`, which keeps the terms k(xi, yi) and averages over subsets: some per cent off, and
    for close sets of another sign. Those terms are of a view and its own truth, so here, where the
    sets are paired, they would reward copies.
    """

    def cubic(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (a @ b.T / a.shape[1] + 1) ** 3

    return unbiased_mmd(x, y, frames, confidence, cubic)


def energy_distance(
    x: np.ndarray,  # [N, D]
    y: np.ndarray,  # [N, D]
    frames: np.ndarray,  # [N]
    confidence: float,
) -> Estimate:
    """Energy distance (Szekely and Rizzo 2013), scaled by the features' number.

    It estimates (2 E|x - y| - E|x - x'| - E|y - y'|) / sqrt(D), as `unbiased_mmd` of the kernel
    k(x, y) = -|x - y| / sqrt(D). Distances are not squared, so that few far outliers do not drown
    the others.
    """

    def closeness(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return -cdist(a, b) / math.sqrt(a.shape[1])

    return unbiased_mmd(x, y, frames, confidence, closeness)


def frechet_distance(
    x: np.ndarray,  # [N, D]
    y: np.ndarray,  # [M, D]
    frames: np.ndarray | None = None,
    confidence: float = 0.0,
) -> Estimate:
    """Squared Frechet distance of two normal distributions (FID, Heusel et al. 2017); no interval.

    It is |mx - my|^2 + trace(A + B - 2 (A B)^0.5), where mx, my are the means and A, B the
    covariances of the two sets' features. Its bias grows as sets shrink: with fewer views than
    features, compare it with its floor alone.
    """
    if min(len(x), len(y)) < 2:
        return Estimate(np.nan)
    # The trace of (A B) ** 0.5, from factors A = a'a and B = b'b: the singular values of a b'.
    a, b = ((z - z.mean(axis=0)) / np.sqrt(len(z) - 1) for z in (x, y))
    a, b = _no_taller(a), _no_taller(b)
    root = np.linalg.svd(a @ b.T, compute_uv=False).sum()
    difference = np.square(x.mean(axis=0) - y.mean(axis=0)).sum()
    return Estimate(float(difference + np.square(a).sum() + np.square(b).sum() - 2 * root))


def _no_taller(factor: np.ndarray) -> np.ndarray:
    """A factor a of a'a with as many rows as columns at most: a triangle, where a has more."""
    if len(factor) <= factor.shape[1]:
        return factor
    triangle: Any = np.linalg.qr(factor, mode="r")
    return np.asarray(triangle)


@dataclass(frozen=True)
class SetMetric:
    """A named distance of sets: what describes an image, and how descriptions are compared.

    Args:
        features: gives an image's features, (D,), from its pixels, (H, W, 3).
        distance: compares two arrays of features, (N, D), whose views belong to frames, (N,).
        standardised: whether features are first centred and scaled by those of the true images.
        missing: gives the reason why this machine cannot compute it; empty where it can.
    """

    features: Callable[[np.ndarray], np.ndarray]
    distance: Callable[..., Estimate]
    standardised: bool = False
    missing: Callable[[], str] = lambda: ""


_no_inception = partial(missing_weights, "torch_fidelity", INCEPTION)
SET_METRICS = {
    "fid": SetMetric(inception_features, frechet_distance, missing=_no_inception),
    "kid": SetMetric(inception_features, kernel_distance, missing=_no_inception),
    "efficientnet_fd": SetMetric(
        efficientnet_features, frechet_distance, missing=missing_efficientnet
    ),
    "efficientnet_kd": SetMetric(
        efficientnet_features, kernel_distance, missing=missing_efficientnet
    ),
    "texture_energy": SetMetric(texture_features, energy_distance, standardised=True),
}
"""Every distance of sets by its name in the rows; lower is better in all."""


def standardise(
    features: np.ndarray,  # [N, D]
    true: np.ndarray,  # [N, D]
) -> np.ndarray:
    """(features - mean) / deviation, of the true images' features; deviations are 0.05 at least."""
    return (features - true.mean(axis=0)) / np.maximum(true.std(axis=0), 0.05)


def real_floor(
    metric: SetMetric,
    true: np.ndarray,  # [N, D]
    frames: np.ndarray,  # [N]
) -> float:
    """The distance of the true images of every other frame from those of the frames between.

    That is what views of one scene differ by at another instant: no method need be nearer. NaN
    where there is one frame alone.
    """
    _, index = np.unique(frames, return_inverse=True)
    halves = [true[index % 2 == parity] for parity in (0, 1)]
    shared = min(map(len, halves))
    if not shared:
        return np.nan
    x, y = (half[:shared] for half in halves)
    one_frame = np.zeros(shared)  # which leaves out the interval
    return metric.distance(x, y, one_frame, 0.5).value
