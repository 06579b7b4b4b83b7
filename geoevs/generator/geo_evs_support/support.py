"""Keeping what geometry explains: supported pixels stay, generated ones fill the rest, no seams."""

import numpy as np
import torch

from geoevs.diffusion.autoencoder import to_tensor
from geoevs.diffusion.push_pull import push_pull


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
    known = torch.from_numpy(valid)[None, None]
    residual = push_pull(to_tensor((condition - generated)[None]), known)
    residual = residual[0].permute(1, 2, 0).numpy()
    return np.clip(np.where(valid[..., None], condition, generated + residual), 0, 1)
