"""EmerNeRF on streets that no test uses: a held-out frame, depth, what emerges as moving, cost.

python -m benchmarks.emernerf
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from baselines.emernerf.adapter import Method
from benchmarks.projection import processor
from geoevs.adapter import Budget, Rng, Views
from geoevs.projection import colour_points, unproject_depth
from geoevs.scenes.scene import Frame, SceneRef, load_source
from geoevs.scenes.store import Scene, write_scene

SCENES = ("straight-900", "curve-901", "junction-902")
HEIGHT, WIDTH = 128, 192
HELD_OUT, FITTED = 4, 3  # frames that images and depth, and motion, are scored in
FARTHEST = 80.0  # metres of depth that is scored


class HeldOut(Views):
    """All of a scene but one frame."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene, scene.cameras, Method.info.needs)
        self.frames = tuple(frame for frame in scene.frames if frame != HELD_OUT)


def render_street(name: str, folder: Path) -> tuple[Scene, dict[int, dict[str, np.ndarray]]]:
    """The scene at the default scale, and the true depths of its views."""
    record = load_source("street", HEIGHT, WIDTH, {}).open(SceneRef.parse(name))
    depths = {}

    def coloured(frame: Frame) -> Frame:
        depths[frame.frame] = frame.depths
        return replace(frame, points=colour_points(frame.points, frame.cameras, frame.images))

    write_scene(folder, record.info, record.tracks, map(coloured, record.frames))
    return Scene(folder), depths


def moving_pixels(scene: Scene, name: str, frame: int, depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels whose true point lies in a moving box."""
    points, pixels = unproject_depth(depth, scene.camera(name, frame))
    inside = np.zeros(len(points), bool)
    tracks = scene.tracks
    for box in tracks[(tracks["frame"] == frame) & tracks["moving"]].itertuples():
        local = points - np.array([box.x, box.y, box.z])
        cos, sin = np.cos(np.radians(box.yaw)), np.sin(np.radians(box.yaw))
        along, aside = local[:, 0] * cos + local[:, 1] * sin, local[:, 1] * cos - local[:, 0] * sin
        edges = np.abs(np.column_stack([along, aside, local[:, 2]]))
        inside |= (edges <= np.array([box.length, box.width, box.height]) / 2).all(axis=1)
    moving = np.zeros(depth.size, bool)
    moving[pixels[inside]] = True
    return moving.reshape(depth.shape)


def measure_scene(name: str, folder: Path) -> list[float]:
    """PSNR (all pixels, still ones), AbsRel, IoU, seconds of the fit and of a view."""
    scene, depths = render_street(name, folder)
    method, start = Method(), time.perf_counter()
    method.fit(HeldOut(scene), Budget(threads=torch.get_num_threads()), Rng(0, name))
    fitted = time.perf_counter() - start
    whole, still, relative, seconds, both, either = [], [], [], [], 0, 0
    for camera in scene.cameras:
        truth = depths[HELD_OUT][camera]
        start = time.perf_counter()
        # Under another name: its appearance is none that was fitted.
        seen = method.render(replace(scene.camera(camera, HELD_OUT), name="held out"), HELD_OUT)
        seconds.append(time.perf_counter() - start)
        error = ((seen.rgb - scene.image(camera, HELD_OUT)) ** 2).mean(axis=2)
        still.append(error[~moving_pixels(scene, camera, HELD_OUT, truth)])
        whole.append(error.ravel())
        scored = (truth > 0) & (truth < FARTHEST)
        depth = np.where(seen.depth > 0, seen.depth, FARTHEST)  # none is far
        relative.append((np.abs(depth - truth) / truth.clip(1e-3))[scored])
        car = moving_pixels(scene, camera, FITTED, depths[FITTED][camera])
        emerged = method.motion(scene.camera(camera, FITTED), FITTED)[0] > 0.5
        both, either = both + (car & emerged).sum(), either + (car | emerged).sum()
    psnrs = [np.mean([-10 * np.log10(view.mean()) for view in views]) for views in (whole, still)]
    iou = both / max(either, 1)
    return [*psnrs, np.concatenate(relative).mean(), iou, fitted, np.median(seconds)]


def main() -> None:
    """Print one row a street."""
    console = Console()
    console.print(processor())
    names = ("dB, all pixels", "dB, still pixels", "AbsRel", "IoU of motion", "fit s", "view s")
    table = Table("street", *names, title="frame 4 held out, 128 x 192, 8 frames, 5 cameras")
    with tempfile.TemporaryDirectory() as folder:
        for name in SCENES:
            row = measure_scene(name, Path(folder) / name)
            digits = (2, 2, 3, 2, 0, 2)
            cells = [f"{value:.{count}f}" for value, count in zip(row, digits, strict=True)]
            table.add_row(name, *cells)
    console.print(table)


if __name__ == "__main__":
    main()
