"""The Gaussian rasterizer, forward and backward, against its torch twin and the arithmetic.

python -m benchmarks.rasterizer
"""

import subprocess
import sys
import time

import numba
import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from baselines.gaussians.binning_kernels import TILE, bin_splats, depth_order
from baselines.gaussians.blending_kernels import blend, blend_backward
from baselines.gaussians.constants import ALPHA_CAP, ALPHA_THRESHOLD, TRANSMITTANCE_THRESHOLD
from baselines.gaussians.projection_kernels import (
    CENTRE_X,
    CENTRE_Y,
    LOG_OPACITY,
    ROOT_XX,
    ROOT_YX,
    ROOT_YY,
    project,
    project_backward,
)
from baselines.gaussians.rasterizer import rasterize_gaussians
from baselines.gaussians.reference import rasterize_reference
from baselines.gaussians.simd import LANES, broadcast, fma, store
from benchmarks.projection import processor
from geoevs.projection.kernels import lens_of
from geoevs.scenes.camera import Camera

SIZE = 256
GAUSSIANS = 20_000
ROUNDS = 41
WHOLE = "numba (what geoevs runs)"
BAR = 16.0  # ms on two cores, for binning, forward and backward
OPERATIONS = 30 + 47
"""Of vector arithmetic a Gaussian in a pixel in `blending_kernels`, forward and backward, counting
compares and selects, and a fused multiply-add as one."""


def camera() -> Camera:
    """About 53 degrees wide, at the origin."""
    K = [[SIZE, 0, SIZE / 2], [0, SIZE, SIZE / 2], [0, 0, 1]]
    return Camera(K, np.eye(4), SIZE, SIZE)


def scattered_gaussians() -> list[torch.Tensor]:
    """All over the picture, axes of 2 to 4 pixels, opacity 0.05 to 0.95, harmonics of degree 1."""
    generator = torch.Generator().manual_seed(0)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator)

    z = 2 + 8 * uniform(GAUSSIANS, 1)
    tensors = [
        torch.cat([(uniform(GAUSSIANS, 2) - 0.5) * z, z], 1),
        torch.randn(GAUSSIANS, 4, generator=generator),
        (2 + 2 * uniform(GAUSSIANS, 3)) * z / SIZE,
        0.05 + 0.9 * uniform(GAUSSIANS),
        0.3 * torch.randn(GAUSSIANS, 4, 3, generator=generator),
    ]
    return [tensor.requires_grad_() for tensor in tensors]


def cotangents() -> list[torch.Tensor]:
    """Of the three pictures."""
    generator = torch.Generator().manual_seed(1)
    shapes = (SIZE, SIZE, 3), (SIZE, SIZE), (SIZE, SIZE)
    return [torch.randn(shape, generator=generator) for shape in shapes]


def iterate(draw, gaussians: list[torch.Tensor], by_pictures: list[torch.Tensor]) -> None:
    """Forward and backward, as a training step calls them."""
    for tensor in gaussians:
        tensor.grad = None
    torch.autograd.backward(draw(*gaussians, camera())[:3], by_pictures)


def time_stages(
    gaussians: list[torch.Tensor], by_pictures: list[torch.Tensor], times: dict[str, list[float]]
) -> None:
    """Run the kernels one by one, as the rasterizer does, and note what each took."""
    arrays, by_arrays = (
        [each.detach().numpy() for each in them] for them in (gaussians, by_pictures)
    )
    lens, threads, tiles = lens_of(camera()), numba.get_num_threads(), -(-SIZE // TILE)

    def timed(name: str, kernel, *arguments):
        start = time.perf_counter()
        result = kernel(*arguments)
        times.setdefault(name, []).append(1e3 * (time.perf_counter() - start))
        return result

    splats, radii = timed("projection", project, *arrays, lens)
    order = timed("depth order", depth_order, splats, radii)
    bins = timed("bins", bin_splats, splats, order, tiles, tiles, threads)
    black = np.zeros(3, np.float32)
    pictures, blocks = timed("blending", blend, splats, *bins, black, SIZE, SIZE, threads)
    shares = timed(
        "blending, backward", blend_backward, splats, *bins, blocks, *pictures, *by_arrays, threads
    )
    timed("projection, backward", project_backward, *arrays, lens, splats, radii, shares)


@numba.njit(error_model="numpy")
def count_pairs(splats: np.ndarray, order: np.ndarray) -> int:
    """How many Gaussians all pixels together are drawn with, without bins or vectors."""
    through = np.ones((SIZE, SIZE))
    pairs = 0
    for i in order:
        x, y = splats[i, CENTRE_X], splats[i, CENTRE_Y]
        for row in range(max(y - 20, 0), min(y + 20, SIZE)):
            for column in range(max(x - 20, 0), min(x + 20, SIZE)):
                v = splats[i, ROOT_YY] * (row + 0.5 - y)
                u = splats[i, ROOT_XX] * (column + 0.5 - x) + splats[i, ROOT_YX] * (row + 0.5 - y)
                alpha = min(2.0 ** (splats[i, LOG_OPACITY] - u * u - v * v), ALPHA_CAP)
                if alpha >= ALPHA_THRESHOLD and through[row, column] > TRANSMITTANCE_THRESHOLD:
                    through[row, column] *= 1 - alpha
                    pairs += through[row, column] > TRANSMITTANCE_THRESHOLD
    return pairs


@numba.njit(parallel=True)
def _multiply_and_add(threads: int, rounds: int) -> np.ndarray:
    out = np.empty((threads, LANES), np.float32)
    for thread in numba.prange(threads):
        a = b = c = d = e = f = g = h = broadcast(np.float32(thread))
        factor = broadcast(np.float32(0.999))
        for _ in range(rounds):  # eight chains, to fill the pipelines
            a, b, c, d = fma(a, factor, a), fma(b, factor, b), fma(c, factor, c), fma(d, factor, d)
            e, f, g, h = fma(e, factor, e), fma(f, factor, f), fma(g, factor, g), fma(h, factor, h)
        store(out[thread], 0, a + b + c + d + e + f + g + h)
    return out


def peak_operations() -> float:
    """Fused multiply-adds of float32 a millisecond, on all of numba's threads."""
    threads, rounds = numba.get_num_threads(), 1_000_000
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        _multiply_and_add(threads, rounds)
        best = min(best, time.perf_counter() - start)
    return 8 * LANES * threads * rounds / (1e3 * best)


FIRST_CALL = """
from baselines.gaussians.rasterizer import rasterize_gaussians
from benchmarks.rasterizer import camera, cotangents, iterate, scattered_gaussians
iterate(rasterize_gaussians, scattered_gaussians(), cotangents())
"""


def first_call() -> float:
    """Seconds of a fresh process that imports the rasterizer and calls it once."""
    seconds = []
    for _ in range(4):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", FIRST_CALL], check=True)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[1:]))  # the first may compile


def main() -> None:
    """Print the whole, its stages, the twin, the bound, and what a process waits for at first."""
    gaussians, by_pictures = scattered_gaussians(), cotangents()
    for ours, twin in zip(
        rasterize_gaussians(*gaussians, camera())[:3],
        rasterize_reference(*gaussians, camera())[:3],
        strict=True,
    ):
        # A pixel may lie on the edge of the threshold, and float32 on its other side.
        assert (ours - twin).abs().mean() < 1e-5 * twin.abs().mean()

    times: dict[str, list[float]] = {WHOLE: []}
    for _ in range(ROUNDS):
        start = time.perf_counter()
        iterate(rasterize_gaussians, gaussians, by_pictures)
        times[WHOLE].append(1e3 * (time.perf_counter() - start))
        time_stages(gaussians, by_pictures, times)
    start = time.perf_counter()
    iterate(rasterize_reference, gaussians, by_pictures)
    times["torch twin, float64"] = [1e3 * (time.perf_counter() - start)]

    splats, radii = project(*(each.detach().numpy() for each in gaussians), lens_of(camera()))
    pairs, peak = count_pairs(splats, depth_order(splats, radii)), peak_operations()
    title = f"{GAUSSIANS:,} Gaussians of 2 to 4 pixels into {SIZE} x {SIZE}, forward and backward"
    table = Table("path", "median ms", "best ms", "times ours", title=title)
    ours = np.median(times[WHOLE][1:])
    for name, each in times.items():
        each = each[1:] or each  # the first call may compile
        ratio = np.median(each) / ours
        table.add_row(name, f"{np.median(each):.2f}", f"{min(each):.2f}", f"{ratio:.2f}")
    bound = pairs * OPERATIONS / peak
    table.add_row("arithmetic bound", f"{bound:.2f}", f"{bound:.2f}", f"{bound / ours:.2f}")
    console = Console()
    console.print(f"{processor()}; numba threads: {numba.get_num_threads()}")
    console.print(table)
    console.print(
        f"{pairs / 1e6:.1f} M pairs of Gaussian and pixel, {OPERATIONS} operations each, at "
        f"{peak / 1e6:.0f} G operations a second; the bar is {BAR:.0f} ms on two cores"
    )
    console.print(f"import and first call in a fresh process: {first_call():.1f} s; the bar is 3 s")


if __name__ == "__main__":
    main()
