"""Rows of task metrics: the detector of the recorded views, on a rig that moved aside."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.detection.bevformer.inputs import RigFrame
from geoevs.detection.rigs import DetectionScene
from geoevs.detection.rows import BOX
from geoevs.detection.rules import CLASSES
from geoevs.detection.task_metrics import NTA_IOU, agent_ious

RECORDED = "recorded"
"""In the place of an entrant's label: the pictures that were recorded, at the offset 0."""

TASK_TYPES = {
    **dict.fromkeys(("label", "scene"), "string"),
    **dict.fromkeys(("seed", "frame"), "int64"),
    "offset": "float64",
    "metric": "string",
    "value": "float64",
    "count": "int64",
    "reason": "string",
}
"""Columns: whose pictures, where, which detector, metres to the left; the metric's sum over so many
objects of the frame. Where something failed, the reason stands alone, and there is no value."""

Detect = Callable[[Path, Iterable[RigFrame]], pd.DataFrame]
"""From a detector's folder and frames to rows of PREDICTION_TYPES."""


def task_rows(
    label: str,
    scenes: Sequence[DetectionScene],
    offsets: Sequence[float],
    detectors: Mapping[int, Path | str],
    detect: Detect,
) -> pd.DataFrame:
    """Rows of TASK_TYPES of one entrant's pictures.

    Args:
        label: whose; RECORDED for what was recorded.
        scenes: test scenes.
        offsets: of the rig, metres to the left; RECORDED has 0 alone.
        detectors: by seed, the folder of a detector of the recorded views, or why there is none.
        detect: runs one.
    """
    rows = []
    for seed, detector in detectors.items():
        for scene in scenes:
            for offset in [0.0] if label == RECORDED else offsets:
                place = {"label": label, "seed": seed, "scene": scene.name, "offset": offset}
                place |= {"metric": NTA_IOU}
                try:
                    if isinstance(detector, str):
                        raise GeoEvsError(detector)
                    shown = None if label == RECORDED else label
                    frames = list(scene.moved_frames(shown, offset))
                    found = detect(detector, frames)
                except GeoEvsError as failure:
                    nothing = {"value": np.nan, "count": 0, "reason": str(failure)}
                    rows += [{**place, "frame": n, **nothing} for n in scene.store.frames]
                    continue
                rows += [{**place, **_frame_row(scene, frame, offset, found)} for frame in frames]
    return pd.DataFrame(rows, columns=list(TASK_TYPES)).astype(TASK_TYPES)


def _frame_row(
    scene: DetectionScene, frame: RigFrame, offset: float, found: pd.DataFrame
) -> dict[str, object]:
    vehicle = CLASSES.index("vehicle")
    mine = found[(found["frame"] == frame.frame) & (found["class"] == "vehicle")]
    ious = agent_ious(
        mine[list(BOX)].to_numpy(float),
        mine["score"].to_numpy(float),
        frame.boxes[frame.classes == vehicle],
        scene.moved_cameras(frame.frame, offset),
        frame.world_from_vehicle,
    )
    return {"frame": frame.frame, "value": ious.sum(), "count": len(ious), "reason": ""}
