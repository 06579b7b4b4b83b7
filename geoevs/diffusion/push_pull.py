"""Filling holes smoothly from what surrounds them."""

from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate, pad

RELAXATIONS = 8
"""Relaxations at every level. On streets 2 give 0.5 dB in holes, 8 give 0.75 and 16 give 0.85."""

LEAST_WEIGHT = 1e-6
"""Least weight to divide by, in place of none."""


def push_pull(
    values: Tensor,  # [B, C, H, W]
    known: Tensor,  # [B, 1, H, W] bool
) -> Tensor:
    """Fill unknown pixels smoothly from known ones (Gortler et al., The Lumigraph, 1996).

    Known values are averaged over ever larger blocks; unknown pixels take the finest average that
    holds a known one, weighted by how much of it does. At every level they are then drawn towards
    the mean of their neighbours, so that the result is nearly the membrane that known pixels span.

    Returns:
        (B, C, H, W); known pixels keep their value, an image that knows none is zero.
    """
    weight = known.to(values.dtype)
    return _push_pull(values * weight, weight)


def _push_pull(total: Tensor, weight: Tensor) -> Tensor:
    """Fill images given as (B, C, H, W) weighted values and (B, 1, H, W) weights in [0, 1]."""
    height, width = size = weight.shape[-2:]
    if max(size) == 1 or bool((weight == 1).all()):
        return total / weight.clamp(min=LEAST_WEIGHT)
    half = ((height + 1) // 2, (width + 1) // 2)
    share = adaptive_avg_pool2d(weight, half)
    coarse_weight = (4 * share).clamp(max=1)  # one known pixel of a block tells all of it
    gain = coarse_weight / share.clamp(min=LEAST_WEIGHT)
    coarse = _push_pull(adaptive_avg_pool2d(total, half) * gain, coarse_weight)
    filled = total + (1 - weight) * interpolate(coarse, size, mode="bilinear")
    for _ in range(RELAXATIONS):
        filled = total + (1 - weight) * _neighbours_mean(filled)
    return filled


def _neighbours_mean(image: Tensor) -> Tensor:
    """Of the four neighbours; beyond the border lies the pixel itself."""
    padded = pad(image, (1, 1, 1, 1), mode="replicate")
    across = padded[..., 1:-1, :-2] + padded[..., 1:-1, 2:]
    down = padded[..., :-2, 1:-1] + padded[..., 2:, 1:-1]
    return (across + down) / 4
