"""How much of a condition map is background that leaked through its z-buffer, and what it costs.

python -m benchmarks.leaks             # two frames of three streets that no test uses
python -m benchmarks.leaks pandaset    # the frames under GEOEVS_PANDASET, without truth

Conditions hold the front-most point of each pixel, as in the paper. The footprint rule would drop
those far behind a nearer point two pixels away. A leak lies behind everything that the truth shows
in the 3 x 3 pixels around it.
"""

import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from baselines.controls.reproject_inpaint.adapter import fill_holes
from benchmarks.inpainting import HEIGHT, PROTOCOL, SCENES, WIDTH, psnr
from geoevs.core.images import to_float
from geoevs.geometry.depth_models import LidarDepth
from geoevs.geometry.lift import lift_frame
from geoevs.geometry.lifted import LiftedViews
from geoevs.methods.contract import Views
from geoevs.projection import Raster, colour_frame, rasterize_points
from geoevs.protocol.audit import SURFACE
from geoevs.protocol.targets import Target, make_targets
from geoevs.scenes.scene import SceneRef, SceneSource, Truth, load_source
from geoevs.scenes.store import Scene, write_scene

STREET = {"frames": 2, "interval": 3.0}  # seconds: frames that differ


class Condition(NamedTuple):
    """The condition of one extrapolated target, and what is true there if anybody knows."""

    shown: Raster
    kept: np.ndarray  # [H, W] bool, what the footprint rule keeps of it
    truth: Truth | None


def conditions(source: SceneSource, name: str, folder: Path) -> Iterator[Condition]:
    """Those of all extrapolated targets of a scene."""
    ref = SceneRef.parse(name)
    record = source.open(ref)
    write_scene(folder, record.info, record.tracks, map(colour_frame, record.frames))
    scene = Scene(folder)
    lifted = LiftedViews.make(Views(scene, scene.cameras, ("lidar",)), LidarDepth())
    targets = [t for t in make_targets(scene, PROTOCOL, seed=0) if t.split == "extrapolation"]
    places = [(target.camera, target.frame) for target in targets]
    truths = source.truth(ref, places) if source.has_truth else [None] * len(targets)
    for target, truth in zip(targets, truths, strict=True):
        yield Condition(*_both(lifted, target), truth)


def _both(lifted: LiftedViews, target: Target) -> tuple[Raster, np.ndarray]:
    depths = lifted.depths[target.frame]
    cloud = lift_frame(lifted.views, target.frame, depths, target.camera)
    footprint = rasterize_points(*cloud, target.camera, visibility="footprint")
    return lifted.condition(target.camera, target.frame), footprint.mask


def leaks(depth: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels whose point lies behind all that is true around them.

    Args:
        depth: (H, W) metres of the condition, 0 = none.
        truth: (H, W) metres, 0 = sky.
    """
    farthest = cv2.dilate(np.where(truth > 0, truth, np.inf).astype(np.float32), np.ones((3, 3)))
    return depth > farthest * (1 + SURFACE)


def measure(condition: Condition) -> dict[str, float]:
    """Shares in per cent of the condition's pixels, and PSNR in dB."""
    (image, mask, depth), kept, truth = condition
    shares = {"dropped by\nfootprint, %": 100 * np.mean(~kept[mask])}
    if truth is None:
        return shares
    leaked = leaks(depth, truth.depth)
    true = to_float(truth.rgb)

    def error(shown: np.ndarray) -> np.ndarray:
        return np.square(to_float(shown) - true)

    def filled(valid: np.ndarray) -> float:
        return psnr(error(fill_holes(image * valid[..., None], valid, "telea")))

    return shares | {
        "leaks, %": 100 * np.mean(leaked[mask]),
        "of them\ndropped, %": 100 * np.mean(~kept[leaked]) if leaked.any() else np.nan,
        "reproject on\nits pixels, dB": psnr(error(image)[mask]),
        "on those\nkept": psnr(error(image)[mask & kept]),
        "without\nleaks": psnr(error(image)[mask & ~leaked]),
        "inpainted,\nall pixels, dB": filled(mask),
        "leaks dropped\nby footprint": filled(mask & kept),
        "leaks dropped\nby truth": filled(mask & ~leaked),
    }


def main(arguments: list[str]) -> None:
    """Print one row a scene, each a mean over targets."""
    if arguments == ["pandaset"]:
        source = load_source("pandaset", 512, 512, {"folder": os.environ["GEOEVS_PANDASET"]})
        names: tuple[str, ...] = ("002",)
    else:
        source, names = load_source("street", HEIGHT, WIDTH, STREET), SCENES
    rows = {}
    with tempfile.TemporaryDirectory() as temporary:
        for name in names:
            found = [measure(one) for one in conditions(source, name, Path(temporary) / name)]
            rows[f"{name}, {len(found)} views"] = {
                column: np.nanmean([one[column] for one in found]) for column in found[0]
            }
    table = Table()
    table.add_column("scene")
    for column in next(iter(rows.values())):
        table.add_column(column, justify="right")
    for name, row in rows.items():
        table.add_row(name, *(f"{value:.2f}" for value in row.values()))
    Console(width=160).print(table)


if __name__ == "__main__":
    main(sys.argv[1:])
