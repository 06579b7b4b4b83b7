"""The hash grid on CUDA: tiny-cuda-nn's kernels, whose levels are fitted to ours.

tiny-cuda-nn staggers the levels of its own grids. A grid of one level has as many vertices as it is
told and is staggered by half a cell, which positions can be moved by: so the table's entries mean
the same on every device, and a model that was fitted on one renders on the other.
"""

import importlib.util
from functools import cache
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor
from torch.func import functional_call
from torch.nn.functional import pad


@cache
def tcnn_installed() -> bool:
    """Whether tiny-cuda-nn's bindings for torch are here."""
    return importlib.util.find_spec("tinycudann") is not None


def encode_tcnn(
    positions: Tensor,  # [N, D] float32 in [0, 1], on CUDA
    table: Tensor,  # [entries, F] float32
    cells: list[int],
    offsets: list[int],
) -> Tensor:
    """(N, levels * F): what `hash_encode_reference` gives, differentiable in both tensors."""
    sizes = [stop - start for start, stop in pairwise(offsets)]
    encoded = []
    for count, entries in zip(cells, table.split(sizes), strict=True):
        level = _level(positions.shape[1], count, *entries.shape)
        weights = pad(entries.flatten(), (0, level.params.numel() - entries.numel()))
        encoded.append(functional_call(level, {"params": weights}, (positions - 0.5 / count,)))
    return torch.cat(encoded, dim=1)


@cache
def _level(dims: int, cells: int, entries: int, features: int) -> Any:
    """An encoding of one level; its own entries are never used."""
    import tinycudann

    settings = {
        "otype": "Grid",
        "type": "Hash",
        "n_levels": 1,
        "n_features_per_level": features,
        "log2_hashmap_size": (entries - 1).bit_length(),
        "base_resolution": cells + 1,  # vertices
        "interpolation": "Linear",
    }
    return tinycudann.Encoding(dims, settings, dtype=torch.float32)
