"""How good the depth of recorded views is, before and after fine-tuning (paper section 3.2)."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from geoevs.geometry.depth_metrics import depth_metrics
from geoevs.geometry.depth_models import DepthModel, LidarDepth
from geoevs.methods.contract import Views
from geoevs.projection import zbuffer
from geoevs.protocol.clock import timed
from geoevs.protocol.entries import EMPTY_MASK, OK
from geoevs.scenes.depths import read_depths
from geoevs.scenes.store import Scene

PRETRAINED, FINE_TUNED, CONTROL = "pretrained", "fine-tuned", "control"
"""Stages: a network before and after, and LiDAR completion, which learns nothing."""

SCALES: dict[str, tuple[str, ...]] = {"none": (), "lidar": ("lidar",)}
"""The ways to fit the scale of predicted depth, and the needs (see MethodInfo) of each."""

FARTHEST = 80.0
"""Largest depth that is scored, metres, as on KITTI."""

DENSE, LIDAR = "dense", "lidar"
"""The two kinds of truth."""

COVERAGE = "coverage"
"""The metric that is the share of the truth's pixels on which the others are computed."""

DEPTH_SCORE_TYPES = {
    "dataset": "string",
    "scene": "string",
    "frame": "int64",
    "camera": "string",
    "model": "string",
    "stage": "string",
    "scale": "string",
    "truth": "string",
    "metric": "string",
    "value": "float64",
    "valid_pixels": "int64",
    "seconds": "float64",
    "parameters": "int64",
    "status": "string",
}


class Candidate(NamedTuple):
    """A depth model under its name and stage."""

    name: str
    stage: str
    model: DepthModel

    @property
    def scales(self) -> list[str]:
        """The SCALES that it is scored with; completed LiDAR has its own alone."""
        return ["lidar"] if isinstance(self.model, LidarDepth) else list(SCALES)


def depth_scores(
    scene: Scene,
    depths: Path,
    candidates: list[Candidate],
    common: dict[str, Any],
    advance: Callable[[], None] = lambda: None,
) -> pd.DataFrame:
    """Score the depth of every recorded view: one row a view, candidate, scale and metric.

    Truth is dense where `depths` has it, else the LiDAR points that score, where they pass the
    footprint test. A model is compared where it gives a depth; `coverage` is the share of the
    truth's pixels where it does. `seconds` is of the view's whole frame, reading its images
    included.

    Args:
        scene: the store.
        depths: its dense true depth, or an empty folder.
        candidates: what to score.
        common: the rows' `dataset` and `scene`.
        advance: called after each frame, candidate and scale.
    """
    rows = []
    for candidate in candidates:
        for scale in candidate.scales:
            for frame, estimate, seconds in _timed_depths(scene, candidate.model, SCALES[scale]):
                described = {
                    **common,
                    "frame": frame,
                    "model": candidate.name,
                    "stage": candidate.stage,
                    "scale": scale,
                    "seconds": seconds,
                    "parameters": candidate.model.parameters,
                }
                rows += _frame_rows(scene, depths, frame, estimate, described)
                advance()
    return pd.DataFrame(rows, columns=list(DEPTH_SCORE_TYPES)).astype(DEPTH_SCORE_TYPES)


def _timed_depths(
    scene: Scene, model: DepthModel, needs: tuple[str, ...]
) -> Iterator[tuple[int, dict[str, np.ndarray], float]]:
    """Frames, the depths of their views, and the seconds that they took."""
    views = Views(scene, scene.cameras, needs)
    model.depths(views, views.frames[0])  # the first call compiles and allocates
    for frame in views.frames:
        with timed() as spent:
            estimate = model.depths(views, frame)
        yield frame, estimate, spent.seconds


def _frame_rows(
    scene: Scene,
    depths: Path,
    frame: int,
    estimate: dict[str, np.ndarray],  # each [H, W] metres, 0 = none
    described: dict[str, Any],
) -> list[dict[str, Any]]:
    rows = []
    truth, origin = _true_depths(scene, depths, frame)
    for camera in scene.cameras:
        known = (truth[camera] > 0) & (truth[camera] <= FARTHEST)
        if camera in scene.ego_masks:
            known &= ~scene.ego_masks[camera]
        mask = known & (estimate[camera] > 0)
        scores = depth_metrics(estimate[camera], truth[camera], mask)
        scores[COVERAGE] = float(mask.sum() / known.sum()) if known.any() else math.nan
        for metric, value in scores.items():
            pixels = np.count_nonzero(known if metric == COVERAGE else mask)
            score = {"metric": metric, "value": value, "valid_pixels": pixels}
            score["status"] = OK if pixels else EMPTY_MASK
            rows.append({**described, "camera": camera, "truth": origin, **score})
    return rows


def _true_depths(scene: Scene, depths: Path, frame: int) -> tuple[dict[str, np.ndarray], str]:
    """(H, W) metres by camera, 0 = none, and where they are from."""
    dense = read_depths(depths, frame)
    if dense:
        return dense, DENSE
    points = scene.points(frame)
    scoring = points.xyz[scene.info.rig.scores(points)]
    return {
        name: zbuffer(scoring, scene.camera(name, frame), visibility="footprint").depth
        for name in scene.cameras
    }, LIDAR
