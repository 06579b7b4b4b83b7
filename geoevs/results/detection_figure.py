"""What detectors see and find in a frame: recorded views with boxes, and the scene from above."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from geoevs.core.images import to_uint8
from geoevs.detection.labels import Bounds
from geoevs.detection.rigs import DetectionScene
from geoevs.detection.rows import BOX
from geoevs.detection.rules import CLASSES
from geoevs.detection.task_metrics import box_corners, edges_before, image_from_vehicle
from geoevs.results.figures import Row, draw_grid

TRUTH_INK = (255, 255, 255)
INKS = {"vehicle": (255, 120, 40), "pedestrian": (70, 220, 120), "cyclist": (230, 90, 230)}
"""Colours of what is predicted, by class; labels are white."""

ROAD = (40, 42, 48)
SCALE = 3
"""Pixels of a drawing for one of a picture, so that lines are fine."""

FURTHEST = 1e5
"""Pixels beyond which OpenCV draws no line."""


def detection_figure(
    scene: DetectionScene,
    frame: int,
    predictions: Mapping[str, pd.DataFrame],
    bounds: Bounds,
) -> np.ndarray:
    """(H, W, 3) uint8: a row for every setting, its recorded views and the scene from above.

    As many predictions are drawn as there are labels, those of highest score.

    Args:
        scene: a test scene.
        frame: one of it.
        predictions: rows of PREDICTION_TYPES by setting; all frames of all scenes.
        bounds: what is shown from above.
    """
    labels, classes = scene.boxes(frame)
    truths = [(box, TRUTH_INK) for box in labels]
    rows = [
        Row(name, _pictures(scene, frame, truths, _best(found, scene.name, frame, len(labels)), bounds))
        for name, found in predictions.items()
    ]
    return draw_grid([*scene.store.cameras, "from above"], rows)


Inked = Sequence[tuple[np.ndarray, tuple[int, int, int]]]
"""Boxes (7,), and the colours that they are drawn in."""


def _best(found: pd.DataFrame, scene: str, frame: int, count: int) -> Inked:
    """The predictions of highest score in a frame, and their colours."""
    mine = found[(found["scene"] == scene) & (found["frame"] == frame)]
    mine = mine.sort_values("score", ascending=False, kind="stable").head(count)
    boxes = mine[list(BOX)].to_numpy(float)
    return [(box, INKS[label]) for box, label in zip(boxes, mine["class"], strict=True)]


def _pictures(
    scene: DetectionScene, frame: int, truths: Inked, found: Inked, bounds: Bounds
) -> list[np.ndarray]:
    pose = scene.vehicle_pose(frame)
    pictures = []
    for name in scene.store.cameras:
        camera = scene.store.camera(name, frame)
        picture = to_uint8(scene.store.image(name, frame))
        size = (SCALE * camera.width, SCALE * camera.height)
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST)
        for box, ink in (*truths, *found):
            ends, there = edges_before(box[None], image_from_vehicle(camera, pose))
            for start, end in ends[0][there[0]] * SCALE:
                _line(picture, start, end, ink)
        pictures.append(picture)
    return [*pictures, from_above(truths, found, bounds, pictures[0].shape[:2])]


def from_above(
    truths: Inked, found: Inked, bounds: Bounds, shape: tuple[int, int]
) -> np.ndarray:
    """(H, W, 3) uint8: boxes from above, the vehicle's heading upwards; fronts are marked."""
    picture = np.full((*shape, 3), ROAD, np.uint8)
    x, y = (np.array([bounds[axis], bounds[axis + 3]]) for axis in (0, 1))
    scale = min(shape[0] / np.ptp(x), shape[1] / np.ptp(y))

    def place(point: np.ndarray) -> np.ndarray:
        return np.array([shape[1] / 2 - (point[1] - y.mean()) * scale,
                         shape[0] / 2 - (point[0] - x.mean()) * scale])  # fmt: skip

    for box, ink in (*truths, *found):
        corners = [place(corner) for corner in box_corners(box[None])[0, :4]]
        for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
            _line(picture, start, end, ink)
        _line(picture, place(box[:2]), (corners[0] + corners[3]) / 2, ink)
    cv2.circle(picture, tuple(map(int, place(np.zeros(2)))), 3, TRUTH_INK, -1)
    return picture


def _line(picture: np.ndarray, start: np.ndarray, end: np.ndarray, ink: tuple) -> None:
    if np.abs([start, end]).max() < FURTHEST:
        ends = (tuple(map(int, np.rint(16 * (point - 0.5)))) for point in (start, end))
        cv2.line(picture, *ends, ink, 2, cv2.LINE_AA, shift=4)
