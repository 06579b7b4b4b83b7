"""Classical inpainting of reprojected views, against the truth of procedural streets.

python -m benchmarks.inpainting

The streets are none that any test uses.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from baselines.controls.reproject.adapter import Method as Reprojection
from baselines.controls.reproject_inpaint.adapter import INPAINTINGS, fill_holes
from geoevs.core.images import to_float
from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, Rendering, Views
from geoevs.protocol.targets import make_targets
from geoevs.scenes.scene import SceneRef, load_source
from geoevs.scenes.store import Scene, write_scene

SCENES = ("straight-900", "curve-901", "junction-902")
HEIGHT, WIDTH = 128, 192
PROTOCOL = {
    "lateral": [-1.0, 1.0],
    "pose_sweep": {"every": 1, "angles": []},
    "masked": {"every": 1, "yaw": [0.0], "lateral": [0.0]},
}


def views(name: str, folder: Path) -> Iterator[tuple[Rendering, np.ndarray]]:
    """Reprojections at the extrapolated targets of a street's first frame, and (H, W, 3) truth."""
    source = load_source("street", HEIGHT, WIDTH, {"frames": 1})
    street = SceneRef.parse(name)
    record = source.open(street)
    write_scene(folder, record.info, record.tracks, record.frames)
    scene = Scene(folder)
    method = Reprojection()
    method.fit(Views(scene, scene.cameras, method.info.needs), Budget(), Rng(0))
    targets = [t for t in make_targets(scene, PROTOCOL, seed=0) if t.split == "extrapolation"]
    truths = source.truth(street, [(target.camera, target.frame) for target in targets])
    for target, truth in zip(targets, truths, strict=True):
        yield method.render(target.camera, target.frame), truth.rgb


def score(inpaint: str, seen: Rendering, truth: np.ndarray) -> tuple[float, float, float]:
    """PSNR in dB over the holes and over all pixels, and seconds."""
    start = time.perf_counter()
    filled = fill_holes(seen.rgb, seen.support, inpaint)
    seconds = time.perf_counter() - start
    error = (to_float(filled) - to_float(truth)) ** 2
    return psnr(error[~seen.support]), psnr(error), seconds


def psnr(squared_error: np.ndarray) -> float:
    """PSNR in dB of images in [0, 1]."""
    return float(-10 * np.log10(squared_error.mean()))


def main() -> None:
    """Print one row an inpainting, each a mean over views."""
    with tempfile.TemporaryDirectory() as temporary:
        cases = [case for name in SCENES for case in views(name, Path(temporary) / name)]
    holes = np.mean([~seen.support for seen, _ in cases])
    table = Table(title=f"{len(cases)} views of {HEIGHT} x {WIDTH}, {holes:.1%} holes")
    for column in ("inpainting", "holes, dB", "all pixels, dB", "s a view"):
        table.add_column(column, justify="left" if column == "inpainting" else "right")
    black = np.mean([psnr((to_float(seen.rgb) - to_float(truth)) ** 2) for seen, truth in cases])
    table.add_row("none (black)", "", f"{black:.2f}", "")
    for inpaint in INPAINTINGS:
        hole, whole, seconds = np.mean([score(inpaint, *case) for case in cases], axis=0)
        table.add_row(inpaint, f"{hole:.2f}", f"{whole:.2f}", f"{seconds:.4f}")
    Console().print(table)


if __name__ == "__main__":
    main()
