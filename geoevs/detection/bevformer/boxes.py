"""Boxes as a detector says them: x, y, log width, log length, z, log height, sin, cos."""

import numpy as np
import torch
from torch import Tensor

CODE = 8
"""Numbers of a box."""

SMALLEST = 0.01
"""Metres that a side has at least."""

CENTRE = [0, 1, 4]
"""Where x, y and z stand."""


def encoded(
    boxes: np.ndarray,  # [M, 7] as geoevs.detection.rows.BOX
) -> np.ndarray:
    """(M, 8) float64 what a detector should say."""
    x, y, z, length, width, height, heading = np.asarray(boxes, np.float64).T
    length, width, height = (np.log(np.maximum(side, SMALLEST)) for side in (length, width, height))
    return np.stack([x, y, width, length, z, height, np.sin(heading), np.cos(heading)], axis=1)


def decoded(
    codes: np.ndarray,  # [..., 8]
) -> np.ndarray:
    """(..., 7) float64 boxes as geoevs.detection.rows.BOX."""
    x, y, width, length, z, height, sin, cos = np.moveaxis(np.asarray(codes, np.float64), -1, 0)
    length, width, height = np.exp(length), np.exp(width), np.exp(height)
    return np.stack([x, y, z, length, width, height, np.arctan2(sin, cos)], axis=-1)


def first_code() -> Tensor:
    """(8,) what an untrained detector says besides places: sides of 2, 4 and 1.6 m."""
    code = torch.zeros(CODE)
    code[2], code[3], code[5] = np.log(2.0), np.log(4.0), 0.5
    return code
