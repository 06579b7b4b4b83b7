"""The validity operator: 1 M points into 512 x 512, by every path, against streaming the points.

python -m benchmarks.projection
"""

import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from geoevs.projection import unproject_depth, zbuffer
from geoevs.projection.kernels import lens_of, zbuffer_torch
from geoevs.projection.reference import zbuffer_reference
from geoevs.scenes.camera import Camera

SIZE = 512
POINTS = 1_000_000
ROUNDS = 9
NUMBA = "numba (what geoevs runs)"


@numba.njit(fastmath=True)  # free to reorder the sum: the reading is what counts
def _stream(coordinates: np.ndarray) -> float:
    total = np.float32(0)
    for i in range(len(coordinates)):
        total += coordinates[i]
    return total


def camera() -> Camera:
    """About 65 degrees wide, at the origin."""
    K = [[400, 0, SIZE / 2], [0, 400, SIZE / 2], [0, 0, 1]]
    return Camera(K, np.eye(4), SIZE, SIZE)


def scattered_cloud() -> np.ndarray:
    """(N, 3) float32: pixels and depths in no order, about half of them in the frame."""
    rng = np.random.default_rng(0)
    slope = rng.uniform(-0.9, 0.9, (POINTS, 2))
    depth = rng.uniform(2, 80, (POINTS, 1))
    return np.hstack([slope * depth, depth]).astype(np.float32)


def point_map() -> np.ndarray:
    """(N, 3) float32: a depth map of twice the resolution, lifted row by row."""
    source = camera().resized(2 * SIZE, 2 * SIZE)
    depth = 20 + 10 * np.sin(np.arange(2 * SIZE) / 30) * np.ones((2 * SIZE, 1))
    return unproject_depth(depth, source)[0][:POINTS].astype(np.float32)


def measure(paths: dict[str, Callable[[], object]]) -> dict[str, np.ndarray]:
    """Milliseconds of each path in each round; in turns, so that a busy moment hits them all."""
    for run in paths.values():
        run()
    times = {name: [] for name in paths}
    for _ in range(ROUNDS):
        for name, run in paths.items():
            start = time.perf_counter()
            run()
            times[name].append(1e3 * (time.perf_counter() - start))
    return {name: np.array(each) for name, each in times.items()}


def compare(title: str, points: np.ndarray) -> Table:
    """Time every path on `points`, after checking that they agree bit for bit."""
    view, tensor, flat = camera(), torch.from_numpy(points), points.ravel()
    paths = {
        NUMBA: lambda: zbuffer(points, view),
        "plain numpy, lexsort": lambda: zbuffer_reference(points, view),
        "torch ops": lambda: zbuffer_torch(tensor, lens_of(view)),
        "streaming the points": lambda: _stream(flat),
    }
    ours, *others = [list(map(np.asarray, run())) for run in list(paths.values())[:3]]
    for other in others:
        np.testing.assert_array_equal(ours[0], other[0])
        np.testing.assert_array_equal(ours[1], other[1])
    times = measure(paths)
    table = Table("path", "median ms", "best ms", "times numba's median", title=title)
    for name, each in times.items():
        ratio = np.median(each) / np.median(times[NUMBA])
        table.add_row(name, f"{np.median(each):.2f}", f"{each.min():.2f}", f"{ratio:.2f}")
    return table


def processor() -> str:
    """The processor and its cores."""
    described = (
        Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        if Path("/proc").exists()
        else []
    )
    names = [line.partition(": ")[2] for line in described if line.startswith("model name")]
    name = names[0] if names else platform.processor()
    return f"{name}, {os.cpu_count()} cores"


def main() -> None:
    """Print one table for each kind of cloud."""
    console = Console()
    console.print(f"{processor()}; numba 1 thread, torch {torch.get_num_threads()}")
    clouds = {"scattered points": scattered_cloud(), "a point map": point_map()}
    for name, points in clouds.items():
        title = f"{len(points):,} float32 points into {SIZE} x {SIZE}: {name}"
        console.print(compare(title, points))


if __name__ == "__main__":
    main()
