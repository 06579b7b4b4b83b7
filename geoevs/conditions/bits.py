"""Masks kept as one bit a pixel."""

import numpy as np


def pack_masks(masks: np.ndarray) -> np.ndarray:  # [N, H, W] bool
    """(N, ceil(H W / 8)) uint8: each mask's bits, row by row."""
    return np.packbits(masks.reshape(len(masks), -1), axis=1)


def unpack_masks(
    packed: np.ndarray,  # [N, ceil(H W / 8)] uint8
    height: int,
    width: int,
) -> np.ndarray:
    """(N, H, W) bool: inverse of `pack_masks`."""
    bits = np.unpackbits(packed, axis=1, count=height * width)
    return bits.view(bool).reshape(len(packed), height, width)
