"""`hash_grid_kernels` in torch ops, for any device and number type; autograd differentiates it."""

import torch
from torch import Tensor

from baselines.emernerf.hash_grid_kernels import PRIMES


def hash_encode_reference(
    positions: Tensor,  # [N, D] in [0, 1]
    table: Tensor,  # [entries, F]
    cells: list[int],
    offsets: list[int],
) -> Tensor:
    """(N, levels * F): every level's features, interpolated linearly between a cell's corners."""
    dims = positions.shape[1]
    bits = torch.arange(dims, device=positions.device)
    corners = torch.arange(1 << dims, device=positions.device)[:, None] >> bits & 1  # [2^D, D]
    encoded = []
    for count, start, stop in zip(cells, offsets[:-1], offsets[1:], strict=True):
        place = positions * count
        low = place.detach().long().clamp(0, count - 1)
        share = (place - low)[:, None]  # [N, 1, D]
        weights = torch.where(corners.bool(), share, 1 - share).prod(-1)  # [N, 2^D]
        rows = start + _entries(low[:, None] + corners, count, stop - start)
        encoded.append((weights[..., None] * table[rows]).sum(1))
    return torch.cat(encoded, dim=1)


def _entries(
    vertices: Tensor,  # [..., D] int64
    cells: int,
    entries: int,
) -> Tensor:
    """(...) int64: where a grid's vertices lie in its level, hashed if they do not all fit."""
    dims = vertices.shape[-1]
    if (cells + 1) ** dims <= entries:
        return sum(vertices[..., d] * (cells + 1) ** d for d in range(dims))
    index = vertices[..., 0]
    for d in range(1, dims):
        index = index ^ vertices[..., d] * PRIMES[d]
    # Hashes are of 32 bits, of which a table of a power of two of entries keeps the low ones.
    return index & (entries - 1)
