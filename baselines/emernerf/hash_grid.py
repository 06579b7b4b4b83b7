"""A learned multi-resolution hash grid: features at positions in the unit cube."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from baselines.emernerf.hash_grid_kernels import (
    PRIMES,
    WIDTH,
    encode,
    position_gradient,
    table_gradient,
)
from baselines.emernerf.hash_grid_reference import hash_encode_reference
from baselines.emernerf.tcnn_backend import encode_tcnn, tcnn_installed

SPREAD = 1e-4  # of the first values, as Instant NGP has them


class HashGrid(nn.Module):
    """Instant NGP's encoding: levels of cells that grow geometrically finer.

    A level whose vertices exceed its share of entries is hashed, others are dense. Numba kernels
    encode float32 positions on the CPU, and tiny-cuda-nn on CUDA where it is installed; elsewhere
    torch ops do the same.

    Args:
        dims: of the positions, up to 4.
        levels: how many.
        coarsest, finest: cells along an axis on the first and the last level.
        log2_entries: most vectors a level may have, as a power of two.
        generator: of the first values.
    """

    def __init__(
        self,
        dims: int,
        levels: int,
        coarsest: int,
        finest: int,
        log2_entries: int,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        assert dims <= len(PRIMES)
        self.cells = np.geomspace(coarsest, finest, levels).round().astype(np.int64)
        sizes = np.minimum((self.cells + 1) ** dims, 1 << log2_entries)
        self.offsets = np.concatenate([[0], np.cumsum(sizes)])
        first = torch.rand(int(self.offsets[-1]), WIDTH, generator=generator)
        self.table = nn.Parameter((2 * first - 1) * SPREAD)

    @property
    def out_features(self) -> int:
        """The number of features that one position gets."""
        return WIDTH * len(self.cells)

    def forward(
        self,
        positions: Tensor,  # [N, D] in [0, 1]
    ) -> Tensor:
        """(N, out_features) in the table's type."""
        single = positions.dtype == torch.float32
        if single and positions.device.type == "cpu":
            return _HashEncode.apply(positions, self.table, self.cells, self.offsets)
        tcnn = single and positions.is_cuda and tcnn_installed()
        encoded = encode_tcnn if tcnn else hash_encode_reference
        return encoded(positions, self.table, self.cells.tolist(), self.offsets.tolist())


class _HashEncode(torch.autograd.Function):
    """The numba kernels, differentiable once."""

    @staticmethod
    def forward(
        ctx: Any, positions: Tensor, table: Tensor, cells: np.ndarray, offsets: np.ndarray
    ) -> Tensor:
        positions = positions.contiguous()
        features = positions.new_empty(len(positions), len(cells) * WIDTH)
        arrays = (positions.detach().numpy(), table.detach().numpy(), cells, offsets)
        _on_threads(encode, len(positions), *arrays, features.numpy())
        ctx.save_for_backward(positions, table)
        ctx.levels = cells, offsets
        return features

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        positions, table = ctx.saved_tensors
        places, slopes = positions.detach().numpy(), gradient.contiguous().numpy()
        of_positions = of_table = None
        if ctx.needs_input_grad[0]:
            of_positions = torch.zeros_like(positions)
            arrays = (places, table.detach().numpy(), slopes, *ctx.levels, of_positions.numpy())
            _on_threads(position_gradient, len(places), *arrays)
        if ctx.needs_input_grad[1]:
            of_table = torch.zeros_like(table)
            arrays = (places, slopes, *ctx.levels, of_table.numpy())
            _on_threads(table_gradient, len(ctx.levels[0]), *arrays)
        return of_positions, of_table, None, None


def _on_threads(
    kernel: Callable[..., None],
    count: int,
    positions: np.ndarray,  # [N, D]
    *arrays: np.ndarray,
) -> None:
    """Run a kernel on ranges of `count` things, as many as torch has threads."""
    threads = torch.get_num_threads()
    marks = [count * k // threads for k in range(threads + 1)]
    primes = PRIMES[: positions.shape[1]]

    def run(k: int) -> None:
        kernel(marks[k], marks[k + 1], primes, positions, *arrays)

    if threads == 1:
        run(0)
    else:
        list(_pool(threads).map(run, range(threads)))  # waits, and raises what was raised


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads)
