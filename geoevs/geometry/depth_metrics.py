"""How good predicted depth is, in the numbers that the field reports (paper section 3.2)."""

import numpy as np


def depth_metrics(
    preds: np.ndarray,  # [...] metres, positive under the mask
    target: np.ndarray,  # [...] metres, positive under the mask
    mask: np.ndarray,  # [...] bool
) -> dict[str, float]:
    """Compare depths under a mask.

    Args:
        preds: predicted depth, of any shape.
        target: the truth.
        mask: where to compare.

    Returns:
        `abs_rel`, the mean of |p - t| / t; `rmse` in metres; and `delta_1.25`, the share of pixels
        where neither is 1.25 times the other or more. All NaN where the mask is empty.

    >>> depth_metrics(np.array([2.0, 9.0]), np.array([2.0, 12.0]), np.array([True, True]))
    {'abs_rel': 0.125, 'rmse': 2.1213203435596424, 'delta_1.25': 0.5}
    """
    if not mask.any():
        return dict.fromkeys(("abs_rel", "rmse", "delta_1.25"), float("nan"))
    p, t = preds[mask].astype(np.float64), target[mask].astype(np.float64)
    return {
        "abs_rel": float(np.mean(np.abs(p - t) / t)),
        "rmse": float(np.sqrt(np.mean((p - t) ** 2))),
        "delta_1.25": float(np.mean(np.maximum(p / t, t / p) < 1.25)),
    }
