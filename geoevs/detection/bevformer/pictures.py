"""Pictures of what a detector sees and finds: views with boxes, and a map."""

from collections.abc import Sequence

import cv2
import numpy as np

from geoevs.core.images import to_uint8
from geoevs.detection.bevformer.inputs import FeatureFrame, RigFrame
from geoevs.detection.task_metrics import box_corners, edges_before

TRUE, FOUND, GROUND = (40, 200, 60), (255, 60, 40), (24, 24, 28)
"""Colours of labels, of what is found, and of the map."""

SCALE = 3
"""Pixels of a picture's side for one of a view's."""

FURTHEST = 1e4
"""Pixels beyond which OpenCV draws no line."""


def draw_frame(
    frame: RigFrame | FeatureFrame, boxes: np.ndarray, bounds: Sequence[float]
) -> np.ndarray:
    """The recorded views with boxes, labels in TRUE and what is found in FOUND; a map beside them.

    Args:
        frame: with its labels.
        boxes: (P, 7) what was found.
        bounds: of the map: x, y, z from, x, y, z to.

    Returns:
        (H, W, 3) uint8.
    """
    if isinstance(frame, RigFrame):
        pictures, size = to_uint8(frame.images[frame.recorded]), frame.size
    else:
        pictures, size = np.asarray(frame.pictures), frame.size
    projections = frame.image_from_vehicle[frame.recorded]
    height, width = size[0] * SCALE, size[1] * SCALE
    views = []
    for picture, projection in zip(pictures, projections, strict=True):
        view = cv2.resize(picture, (width, height), interpolation=cv2.INTER_LINEAR)
        for colour, some in ((TRUE, frame.boxes), (FOUND, boxes)):
            ends, before = edges_before(some, projection)
            for start, end in ends[before] * SCALE:
                _line(view, start, end, colour)
        views.append(view)
    drawn = draw_map(frame.boxes, boxes, bounds, 2 * height)
    columns = -(-len(views) // 2)
    views += [np.zeros((height, width, 3), np.uint8)] * (2 * columns - len(views))
    rows = [np.concatenate(views[row * columns : (row + 1) * columns], axis=1) for row in (0, 1)]
    return np.concatenate([np.concatenate(rows), drawn], axis=1)


def draw_map(
    true: np.ndarray,  # [M, 7]
    found: np.ndarray,  # [P, 7]
    bounds: Sequence[float],
    height: int,
) -> np.ndarray:
    """(height, W, 3) uint8: boxes from above, ahead being up; a line goes to each front."""
    scale = height / (bounds[3] - bounds[0])
    image = np.full((height, round(scale * (bounds[4] - bounds[1])), 3), GROUND, np.uint8)

    def pixels(points: np.ndarray) -> np.ndarray:
        return np.stack([bounds[4] - points[..., 1], bounds[3] - points[..., 0]], axis=-1) * scale

    for colour, boxes in ((TRUE, true), (FOUND, found)):
        ground = box_corners(boxes)[:, :4, :2]
        for box, corners in zip(boxes, ground, strict=True):
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                _line(image, pixels(start), pixels(end), colour)
            front = box[:2] + box[3] / 2 * np.array([np.cos(box[6]), np.sin(box[6])])
            _line(image, pixels(box[:2]), pixels(front), colour)
    place = pixels(np.zeros(2))
    cv2.circle(image, tuple(map(int, place)), 3, (255, 255, 255), -1)
    return image


def _line(image: np.ndarray, start: np.ndarray, end: np.ndarray, colour: tuple) -> None:
    if np.abs([start, end]).max() < FURTHEST:
        ends = (tuple(map(int, np.rint(16 * (point - 0.5)))) for point in (start, end))
        cv2.line(image, *ends, colour, 1, cv2.LINE_AA, shift=4)
