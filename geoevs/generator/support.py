"""Keeping what geometry explains: supported pixels stay, generated ones fill the rest, no seams."""

import cv2
import numpy as np


def keep_support(
    generated: np.ndarray,  # [H, W, 3] float32
    condition: np.ndarray,  # [H, W, 3] float32
    valid: np.ndarray,  # [H, W] bool
) -> np.ndarray:
    """Replace supported pixels by the condition's, and carry the difference into the holes.

    The generated image is off in tone everywhere by about the same; pasting alone would leave
    seams. The residual on the support is spread smoothly (push-pull), so that a hole's colours
    continue those around it and only its structure is generated.

    Returns:
        (H, W, 3) float32 in [0, 1]; `generated` where nothing is supported.
    """
    if not valid.any():
        return np.clip(generated, 0, 1)
    residual = push_pull(condition - generated, valid)
    return np.clip(np.where(valid[..., None], condition, generated + residual), 0, 1)


def push_pull(
    values: np.ndarray,  # [H, W, C] float32
    known: np.ndarray,  # [H, W] bool
) -> np.ndarray:
    """Fill unknown pixels smoothly from known ones (Gortler et al., The Lumigraph, 1996).

    Known values are averaged over ever larger blocks; unknown pixels take the finest average that
    holds a known one, weighted by how much of it does.

    Returns:
        (H, W, C) float32; known pixels keep their value.
    """
    weight = known.astype(np.float32)
    return _push_pull(values * weight[..., None], weight)


def _push_pull(total: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Fill an image given as (H, W, C) weighted values and (H, W) weights in [0, 1]."""
    height, width = weight.shape
    mean = total / np.maximum(weight, 1e-6)[..., None]
    if weight.min() >= 1 or max(height, width) == 1:
        return mean
    half = ((width + 1) // 2, (height + 1) // 2)
    share = cv2.resize(weight, half, interpolation=cv2.INTER_AREA)
    coarse_weight = np.minimum(4 * share, 1)  # one known pixel of a block tells all of it
    coarse_total = cv2.resize(total, half, interpolation=cv2.INTER_AREA).reshape(*share.shape, -1)
    coarse_total *= (coarse_weight / np.maximum(share, 1e-6))[..., None]
    coarse = _push_pull(coarse_total, coarse_weight)
    smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
    return total + (1 - weight[..., None]) * smooth.reshape(total.shape)
