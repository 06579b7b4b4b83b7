"""Reconstructions of streets that no test uses: a held-out frame, extrapolated views, depth, cost.

python -m benchmarks.held_out three-dgs street-gaussians emernerf

Names are those of the reconstructions under `methods` in config.yaml; without any it is all.
"""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
import yaml
from rich.console import Console
from rich.table import Table

from benchmarks.inpainting import SCENES, psnr
from benchmarks.projection import processor
from geoevs.config.checks import method_entries
from geoevs.core.errors import did_you_mean
from geoevs.core.images import to_float
from geoevs.core.randomness import Rng
from geoevs.geometry.depth_metrics import depth_metrics
from geoevs.geometry.moving import moving_pixels
from geoevs.methods.contract import ORACLES, Adapter, Budget, Rendering, Views
from geoevs.methods.finding import make_method, method_class
from geoevs.projection import colour_frame
from geoevs.protocol.clock import timed
from geoevs.protocol.depth_scoring import FARTHEST
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.targets import make_targets
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import Frame, SceneRef, load_source
from geoevs.scenes.store import Scene, write_scene

CONFIG = Path(__file__).parents[1] / "config.yaml"
HELD_OUT, FITTED = 4, 3  # frames that images and depth, and motion, are scored in
UNNAMED = "held out"  # no camera's name, so that no image's own appearance is used


class HeldOut(Views):
    """All of a scene but one frame."""

    def __init__(self, scene: Scene, needs: Sequence[str]) -> None:
        super().__init__(scene, scene.cameras, needs)
        self.frames = tuple(frame for frame in scene.frames if frame != HELD_OUT)


class Street(NamedTuple):
    """A scene, and what no method sees of it."""

    name: str
    scene: Scene
    depths: dict[int, dict[str, np.ndarray]]  # of recorded views, [H, W] metres, by frame
    extrapolated: list[tuple[Camera, int, np.ndarray]]  # camera, frame, [H, W, 3] true colours


class Measured(NamedTuple):
    """What one method reaches on one street; NaN where it has no such thing."""

    whole: float  # dB of the held-out frame's views
    still: float  # dB of their pixels outside moving boxes
    extrapolated: float  # dB of the extrapolation split's views of fitted frames
    relative: float  # mean relative error of the held-out frame's depth
    motion: float  # IoU of what emerged as moving with the moving boxes' pixels
    fit: float  # seconds
    view: float  # seconds, median


COLUMNS = {
    "dB of\nall": 2,
    "dB of\nstill": 2,
    "dB extra-\npolated": 2,
    "AbsRel": 3,
    "IoU of\nmotion": 2,
    "fit s": 0,
    "view s": 2,
}
"""Measured's columns and their digits."""


def find_entrants(labels: Sequence[str], config: dict[str, Any]) -> list[MethodEntry]:
    """The reconstructions of these labels, or all that a config has."""
    known = {
        entry.label: entry
        for entry in method_entries(config)
        if entry.method not in ORACLES
        and method_class(entry.method).info.paradigm == "reconstruction"
    }
    for label in labels:
        if label not in known:
            hint = did_you_mean(label, known)
            raise SystemExit(f"{CONFIG.name} has no reconstruction '{label}'; {hint}")
    return [known[label] for label in labels or known]


def render_street(name: str, config: dict[str, Any], folder: Path) -> Street:
    """The scene at the default scale, true depths of its views and true extrapolated views."""
    source = load_source("street", *config["resolution"], config["datasets"]["street"]["options"])
    ref = SceneRef.parse(name)
    record = source.open(ref)
    depths = {}

    def coloured(frame: Frame) -> Frame:
        depths[frame.frame] = frame.depths
        return colour_frame(frame)

    write_scene(folder, record.info, record.tracks, map(coloured, record.frames))
    scene = Scene(folder)
    views = [
        (target.camera, target.frame)
        for target in make_targets(scene, config["protocol"], config["seed"])
        if target.split == "extrapolation" and target.frame != HELD_OUT
    ]
    truths = [to_float(truth.rgb) for truth in source.truth(ref, views)]
    extrapolated = [(*view, rgb) for view, rgb in zip(views, truths, strict=True)]
    return Street(name, scene, depths, extrapolated)


def moving_of(street: Street, name: str, frame: int) -> np.ndarray:
    """(H, W) bool: pixels of a recorded view whose true point lies in a moving box."""
    camera = street.scene.camera(name, frame)
    return moving_pixels(street.depths[frame][name], camera, frame, street.scene.tracks)


def measure(entry: MethodEntry, street: Street) -> Measured:
    """Fit one method to all frames but one, and score it."""
    scene, seconds = street.scene, []
    method = make_method(entry.method, entry.options)
    views, budget = HeldOut(scene, method.info.needs), Budget(threads=torch.get_num_threads())
    with timed() as fit:
        method.fit(views, budget, Rng(entry.seed, street.name))

    def errors(camera: Camera, frame: int, truth: np.ndarray) -> tuple[Rendering, np.ndarray]:
        """What is seen, and its (H, W) squared errors."""
        with timed() as spent:
            seen = method.render(camera, frame)
        seconds.append(spent.seconds)
        return seen, ((to_float(seen.rgb) - truth) ** 2).mean(axis=2)

    whole, still, depths = [], [], []
    for name in scene.cameras:
        camera = replace(scene.camera(name, HELD_OUT), name=UNNAMED)
        seen, error = errors(camera, HELD_OUT, scene.image(name, HELD_OUT))
        whole.append(psnr(error))
        still.append(psnr(error[~moving_of(street, name, HELD_OUT)]))
        if seen.depth is not None:
            depths.append(np.where(seen.depth > 0, seen.depth, FARTHEST))  # none is far
    extrapolated = [psnr(errors(*view)[1]) for view in street.extrapolated]
    relative = float("nan")
    if depths:
        truth = np.stack([street.depths[HELD_OUT][name] for name in scene.cameras])
        scored = (truth > 0) & (truth < FARTHEST)
        relative = depth_metrics(np.stack(depths), truth, scored)["abs_rel"]
    means = [float(np.mean(views)) for views in (whole, still, extrapolated)]
    iou, rendered = motion_iou(method, street), float(np.median(seconds))
    return Measured(*means, relative, iou, fit.seconds, rendered)


def motion_iou(method: Adapter, street: Street) -> float:
    """IoU of what emerged as moving with the boxes that move.

    NaN of methods that are told what moves, and where nothing does and nothing emerged.
    """
    if not hasattr(method, "motion"):
        return float("nan")
    both = either = 0
    for name in street.scene.cameras:
        moving = moving_of(street, name, FITTED)
        emerged = method.motion(street.scene.camera(name, FITTED), FITTED)[0] > 0.5
        both, either = both + (moving & emerged).sum(), either + (moving | emerged).sum()
    return float(both / either) if either else float("nan")


def main() -> None:
    """Print a table for each method: a row a street, and their mean."""
    config = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    entrants = find_entrants(sys.argv[1:], config)
    console = Console()
    console.print(f"{processor()}; {torch.get_num_threads()} threads")
    with tempfile.TemporaryDirectory() as folder:
        streets = [render_street(name, config, Path(folder) / name) for name in SCENES]
        for entry in entrants:
            rows = {street.name: measure(entry, street) for street in streets}
            rows["mean"] = pd.DataFrame(rows.values()).mean()  # of those that are numbers
            table = Table("street", *COLUMNS, title=f"{entry.label}, frame {HELD_OUT} held out")
            for name, row in rows.items():
                numbers = zip(row, COLUMNS.values(), strict=True)
                cells = ["" if np.isnan(value) else f"{value:.{n}f}" for value, n in numbers]
                table.add_row(name, *cells)
            console.print(table)


if __name__ == "__main__":
    main()
