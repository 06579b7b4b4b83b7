"""Rotations of Gaussians."""

import torch
from torch import Tensor


def rotation_matrices(quats: Tensor) -> Tensor:  # [M, 4] w, x, y, z
    """(M, 3, 3) rotations of quaternions of any length but zero."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, 1).view(-1, 3, 3)
