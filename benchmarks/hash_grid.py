"""EmerNeRF's hash grid: encoding 65,536 points on 8 levels and its gradient, by both paths.

python -m benchmarks.hash_grid
"""

from collections.abc import Callable

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from baselines.emernerf.hash_grid import HashGrid
from baselines.emernerf.hash_grid_reference import hash_encode_reference
from benchmarks.projection import measure, processor

POINTS = 65_536
LEVELS = 8
NUMBA = "numba (what geoevs runs)"


def grid_of(dims: int) -> HashGrid:
    """16 to 2048 cells along an axis, at most 65,536 entries a level."""
    return HashGrid(dims, LEVELS, 16, 2048, 16, torch.Generator().manual_seed(0))


def compare(dims: int, moving: bool) -> Table:
    """Time encoding and gradient on both paths, after checking that they agree.

    Args:
        dims: of the grid.
        moving: whether positions have a gradient too, as along the scene flow.
    """
    grid = grid_of(dims)
    generator = torch.Generator().manual_seed(1)
    positions = torch.rand(POINTS, dims, generator=generator).requires_grad_(moving)
    slopes = torch.randn(POINTS, grid.out_features, generator=generator)
    cells, offsets = grid.cells.tolist(), grid.offsets.tolist()

    def path(encode: Callable[[], Tensor]) -> Callable[[], list[Tensor]]:
        def run() -> list[Tensor]:
            grid.table.grad = positions.grad = None
            features = encode()
            features.backward(slopes)
            found = [features.detach(), grid.table.grad]
            return found + [positions.grad] * moving

        return run

    paths = {
        NUMBA: path(lambda: grid(positions)),
        "torch ops": path(lambda: hash_encode_reference(positions, grid.table, cells, offsets)),
    }
    for one, other in zip(*(run() for run in paths.values()), strict=True):
        torch.testing.assert_close(one, other, atol=1e-3, rtol=1e-3)
    times = measure(paths)
    what = "table and positions" if moving else "table"
    title = f"{POINTS:,} points of {dims} axes, {LEVELS} levels: encode, gradient of {what}"
    table = Table("path", "median ms", "best ms", "times numba's median", title=title)
    for name, each in times.items():
        ratio = np.median(each) / np.median(times[NUMBA])
        table.add_row(name, f"{np.median(each):.1f}", f"{each.min():.1f}", f"{ratio:.2f}")
    return table


def main() -> None:
    """Print one table for space, and one for space and time."""
    console = Console()
    console.print(processor())
    console.print(compare(3, moving=False))
    console.print(compare(4, moving=True))


if __name__ == "__main__":
    main()
