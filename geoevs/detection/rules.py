"""What Waymo's detection metrics fix: classes, thresholds, levels, breakdowns and cutoffs.

From the tools `compute_detection_let_metrics_main` and `compute_detection_metrics_main` of the
Waymo Open Dataset, and Hung et al., LET-3D-AP: Longitudinal Error Tolerant 3D Average Precision for
Camera-Only 3D Detection (ICRA 2024).
"""

from dataclasses import dataclass

import numpy as np

CLASSES = ("vehicle", "pedestrian", "sign", "cyclist")
"""In the order of Waymo's numbers 1 to 4."""

ROAD_USERS = ("vehicle", "pedestrian", "cyclist")
"""The classes that means run over; signs are left out, as on Waymo's leaderboards."""

CUTOFFS = np.arange(101) / 100
"""Lowest scores of the predictions that are matched, once for each."""

LEVEL_1, LEVEL_2 = 1, 2
"""Difficulties of truths; what is of LEVEL_1 counts in LEVEL_2 too."""

MOST_POINTS_OF_LEVEL_2 = 5
"""LiDAR points in a box up to which it is of LEVEL_2, unless somebody decided otherwise."""

RANGES = {"[0, 30)": 30.0, "[30, 50)": 50.0, "[50, inf)": np.inf}
"""Distances of a box's centre from the vehicle's origin, metres, and where each ends."""

CAMERAS = {
    "FRONT": 0.0,
    "FRONT_LEFT": 45.0,
    "FRONT_RIGHT": -45.0,
    "SIDE_LEFT": 90.0,
    "SIDE_RIGHT": -90.0,
}
"""Waymo's cameras by the yaw of their axes, degrees."""

HALF_FIELD_OF_VIEW = 25.2
"""Of each of these cameras, degrees."""

TYPE, RANGE, CAMERA = "type", "range", "camera"
"""Breakdowns: into classes, and those into ranges or cameras."""

BINS = {TYPE: ("all",), RANGE: tuple(RANGES), CAMERA: tuple(CAMERAS)}
"""The bins of a class in each breakdown."""


@dataclass(frozen=True)
class Tolerance:
    """How wrong a prediction may be along the line of sight.

    Args:
        share: of the truth's distance.
        minimum: metres, where that share is less.
        sensor: from where it is looked, metres, in the frame of the boxes. Waymo's is the mean
            place of its cameras in the vehicle frame.
    """

    share: float = 0.1
    minimum: float = 0.5
    sensor: tuple[float, float, float] = (1.43, 0.0, 2.18)


@dataclass(frozen=True)
class Rules:
    """How predictions are matched and counted.

    Args:
        name: of the rules, in rows of counts.
        thresholds: the least IoU of a match, for each of CLASSES.
        levels: which are counted.
        breakdowns: keys of BINS.
        tolerance: of errors along the line of sight; None for none.
        distance: metres between centres on the ground up to which boxes may match, whatever their
            IoU; None: the IoU decides.
    """

    name: str
    thresholds: tuple[float, float, float, float]
    levels: tuple[int, ...]
    breakdowns: tuple[str, ...]
    tolerance: Tolerance | None
    distance: float | None = None


LET = Rules("LET", (0.5, 0.3, 0.3, 0.3), (LEVEL_2,), (TYPE, RANGE, CAMERA), Tolerance())
"""Those of the camera-only challenge."""

PLAIN = Rules("plain", (0.7, 0.5, 0.5, 0.5), (LEVEL_1, LEVEL_2), (TYPE, RANGE), None)
"""Those of the 3-D detection challenge."""

CENTRE = Rules("centre", (0.0, 0.0, 0.0, 0.0), (LEVEL_2,), (TYPE, RANGE), None, distance=2.0)
"""By distance alone, at one of the thresholds of nuScenes (Caesar et al., CVPR 2020). Far from good
boxes it tells detectors apart that all have no LET-AP yet."""

RULES = {rules.name: rules for rules in (LET, PLAIN, CENTRE)}
