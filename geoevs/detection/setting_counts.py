"""Rows of counts of what detectors of a setting predicted, by all rules of the stage."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd

from geoevs.detection.rigs import DetectionScene
from geoevs.detection.rows import FRAME
from geoevs.detection.rules import CENTRE, LET, PLAIN, RANGE, TYPE, Rules, Tolerance
from geoevs.detection.scoring import COUNT_TYPES, detection_counts

SETTING_TYPES = {"setting": "string", "seed": "int64"}
"""Columns that say which detector it was."""

SETTING_COUNT_TYPES = {**SETTING_TYPES, **COUNT_TYPES}


def rules_of(scene: DetectionScene) -> list[Rules]:
    """By which a scene is counted: LET metrics from its own cameras' mean place, the others.

    Cameras are no breakdown here, since rigs differ.
    """
    tolerance = replace(Tolerance(), sensor=scene.sensor())
    return [
        replace(LET, breakdowns=(TYPE, RANGE), tolerance=tolerance),
        replace(PLAIN, breakdowns=(TYPE,)),
        CENTRE,
    ]


def count_setting(
    setting: str, seed: int, scenes: Iterable[DetectionScene], predictions: pd.DataFrame
) -> pd.DataFrame:
    """Rows of SETTING_COUNT_TYPES of a detector, over all frames of the test scenes.

    Args:
        setting: of the detector.
        seed: its own.
        scenes: that it was tested on.
        predictions: rows of PREDICTION_TYPES.
    """
    parts = [pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in COUNT_TYPES.items()})]
    for scene in scenes:
        truths = scene.labels[scene.labels["reason"] == ""]
        found = predictions[predictions["scene"] == scene.name]
        if truths.empty and found.empty:
            continue
        found = found.assign(ignored=_in_zones(scene, found).astype(np.int64))
        parts += [detection_counts(found, truths, rules) for rules in rules_of(scene)]
    rows = pd.concat(parts, ignore_index=True).assign(setting=setting, seed=seed)
    return rows[list(SETTING_COUNT_TYPES)].astype(SETTING_COUNT_TYPES)


def _in_zones(scene: DetectionScene, predictions: pd.DataFrame) -> np.ndarray:
    """(N,) bool: whose centres lie in zones where nobody drew boxes."""
    inside = np.zeros(len(predictions), bool)
    for (_, frame), places in predictions.groupby(FRAME).indices.items():
        pose = scene.vehicle_pose(frame)
        centres = predictions[["x", "y"]].to_numpy(np.float64)[places]
        centres = centres @ pose[:2, :2].T + pose[:2, 3]
        for zone in scene.store.no_label_zones.get(frame, ()):
            inside[places] |= _in_polygon(centres, zone)
    return inside


def _in_polygon(points: np.ndarray, corners: Sequence[np.ndarray]) -> np.ndarray:
    """(N,) bool: points (N, 2) in a polygon; from its first corner, as OpenCV has float32."""
    start = np.asarray(corners[0])
    outline = np.asarray(corners - start, np.float32)
    points = points - start
    inside = [cv2.pointPolygonTest(outline, (float(x), float(y)), False) >= 0 for x, y in points]
    return np.array(inside, bool)
