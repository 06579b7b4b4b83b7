"""The loss that fine-tunes VGGT to driving scenes (paper section 3.2)."""

import torch
from torch import Tensor

from geoevs.geometry.vggt import DepthPrediction

# Gain of the reward for being sure, as VGGT was trained.
ALPHA = 0.2
# Pixels between the ones compared by the gradient term.
SCALES = (1, 2, 4, 8)
# LiDAR that looks past an edge, leaves and wires: no surface to learn from.
DROPPED = 0.02


def depth_loss(
    prediction: DepthPrediction,
    depth: Tensor,  # [B, V, H, W] metres, 0 = none
) -> Tensor:
    """Confidence-weighted error of log-depth, and of its differences at several scales.

    Of valid pixels i with log error e and confidence c, the mean of c |e| - alpha log c, and the
    mean of |e_i - e_j| over valid pairs i, j that lie a scale apart in a row or column, averaged
    over the scales; sparse LiDAR simply has fewer pairs. The worst 2 % of the pixels are dropped.

    Errors are of the logarithm because driving spans 1 to 150 m and is judged by relative error,
    which a small log error equals; metres would be all about the horizon.

    Args:
        prediction: of every pixel.
        depth: what is known of the truth, dense or sparse.

    Returns:
        A scalar; zero, with zero gradient, where nothing is known.
    """
    valid = depth > 0
    # The 1 keeps the logarithm finite where nothing is known.
    error = prediction.depth.log() - torch.where(valid, depth, 1.0).log()
    valid = valid & (error.abs() <= _threshold(error.detach()[valid].abs()))
    confidence = prediction.confidence[valid]
    weighted = confidence * error[valid].abs() - ALPHA * confidence.log()
    gradient = sum(_gradient_term(error, valid, scale) for scale in SCALES) / len(SCALES)
    return _mean(weighted) + gradient


def _threshold(errors: Tensor) -> float | Tensor:  # [N]
    """The largest error that is kept."""
    dropped = int(DROPPED * len(errors))
    return errors.kthvalue(len(errors) - dropped).values if dropped else torch.inf


def _gradient_term(
    error: Tensor,  # [B, V, H, W]
    valid: Tensor,  # [B, V, H, W] bool
    scale: int,
) -> Tensor:
    """Mean difference between the errors of pixels `scale` apart, across and down."""
    differences = []
    for e, v in ((error, valid), (error.mT, valid.mT)):
        pairs = v[..., scale:] & v[..., :-scale]
        differences.append((e[..., scale:] - e[..., :-scale])[pairs].abs())
    return _mean(torch.cat(differences))


def _mean(values: Tensor) -> Tensor:  # [N]
    """Of nothing, zero with a gradient."""
    return values.sum() / max(len(values), 1)
