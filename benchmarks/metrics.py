"""Masked metrics against the dense ones of scikit-image and torchmetrics, at 512 x 512.

python -m benchmarks.metrics

The dense ones are of the same images with every pixel valid; ours also run over a sparse mask.
torchmetrics is no dependency of the suite: its lines are left out unless it is installed.
"""

import statistics
import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from rich.console import Console
from rich.table import Table
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from geoevs.protocol.masked_means import MaskedMean
from geoevs.protocol.metrics import GMS, MAE, PSNR, SSIM

SIDE = 512
ROUNDS = 9
SPARSE = 0.03  # valid share of a sparse mask

Path = tuple[str, str, Callable[[], float]]
"""A metric, who computes it, and how."""


def ours(kind: type[MaskedMean], images: tuple[np.ndarray, ...], mask: np.ndarray) -> float:
    """One image's score."""
    metric = kind()
    metric.update(*images, mask)
    return metric.compute()


def paths(images: tuple[np.ndarray, np.ndarray]) -> list[Path]:
    """Everything that is timed, in the table's order."""
    preds, target = images
    dense = np.ones(target.shape[:2], bool)
    sparse = np.random.default_rng(1).random(target.shape[:2]) < SPARSE
    window = {"gaussian_weights": True, "use_sample_covariance": False}
    found: list[Path] = [
        (kind.__name__, f"geoevs, {name}", lambda k=kind, m=mask: ours(k, images, m))
        for kind in (PSNR, SSIM, MAE, GMS)
        for name, mask in (("dense", dense), ("sparse", sparse))
    ]
    found += [
        ("PSNR", "scikit-image", lambda: peak_signal_noise_ratio(target, preds, data_range=1.0)),
        (
            "SSIM",
            "scikit-image",
            lambda: structural_similarity(target, preds, data_range=1.0, channel_axis=-1, **window),
        ),
    ]
    return found + (torch_paths(images) if find_spec("torchmetrics") else [])


def torch_paths(images: tuple[np.ndarray, np.ndarray]) -> list[Path]:
    """The same of torchmetrics, on one thread as ours."""
    import torch
    from torchmetrics.functional import mean_absolute_error
    from torchmetrics.functional.image import (
        peak_signal_noise_ratio,
        structural_similarity_index_measure,
    )

    torch.set_num_threads(1)
    preds, target = (
        torch.from_numpy(image).permute(2, 0, 1)[None].contiguous() for image in images
    )
    return [
        ("PSNR", "torchmetrics", lambda: peak_signal_noise_ratio(preds, target, data_range=1.0)),
        (
            "SSIM",
            "torchmetrics",
            lambda: structural_similarity_index_measure(preds, target, data_range=1.0),
        ),
        ("MAE", "torchmetrics", lambda: mean_absolute_error(preds, target)),
    ]


def main() -> None:
    """Print the value, the median and the best time of every path."""
    import cv2

    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    target = rng.random((SIDE, SIDE, 3)).astype(np.float32)
    noisy = target + 0.1 * rng.standard_normal(target.shape).astype(np.float32)
    timed = paths((np.clip(noisy, 0, 1), target))
    seconds: list[list[float]] = [[] for _ in timed]
    for _ in range(ROUNDS + 1):
        for (_, _, run), spent in zip(timed, seconds, strict=True):
            start = time.perf_counter()
            run()
            spent.append(time.perf_counter() - start)
    table = Table(title=f"ms an image of {SIDE} x {SIDE}, one thread")
    for column in ("metric", "path", "value", "median", "best"):
        table.add_column(column, justify="left" if column in ("metric", "path") else "right")
    for (metric, path, run), spent in sorted(
        zip(timed, seconds, strict=True), key=lambda line: line[0][0]
    ):
        median, best = statistics.median(spent[1:]), min(spent[1:])
        table.add_row(
            metric, path, f"{float(run()):.5f}", f"{1e3 * median:.1f}", f"{1e3 * best:.1f}"
        )
    Console().print(table)


if __name__ == "__main__":
    main()
