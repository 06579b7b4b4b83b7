"""Intersection over union of upright boxes in 3-D.

A box is `x, y, z, length, width, height, heading`: its centre and its sides, metres, and the angle
from the x axis to its length, radians, counter-clockwise seen from above. Arrays of boxes end in
these seven, and the dimensions before them are broadcast.
"""

import numpy as np

SMALLEST, LARGEST = 1e-2, 1e6
"""Sides between these, metres, make a box; any other box overlaps with nothing."""

CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) / 2
"""Of a square of side 1 seen from above, counter-clockwise."""


def iou_3d(
    boxes: np.ndarray,  # [..., 7]
    others: np.ndarray,  # [..., 7]
) -> np.ndarray:
    """(...) float64 in [0, 1]: the volume that both boxes fill over that which either does.

    Boxes with a side of 1 cm or less, or of 1,000 km or more, overlap with nothing.
    """
    boxes, others = np.broadcast_arrays(boxes, others)
    high = np.minimum(boxes[..., 2] + boxes[..., 5] / 2, others[..., 2] + others[..., 5] / 2)
    low = np.maximum(boxes[..., 2] - boxes[..., 5] / 2, others[..., 2] - others[..., 5] / 2)
    reach = (np.hypot(boxes[..., 3], boxes[..., 4]) + np.hypot(others[..., 3], others[..., 4])) / 2
    apart = np.hypot(boxes[..., 0] - others[..., 0], boxes[..., 1] - others[..., 1])
    meet = (high > low) & (apart < reach) & _is_box(boxes) & _is_box(others)
    iou = np.zeros(meet.shape)
    one, other = boxes[meet], others[meet]
    both = intersection_areas(one, other) * (high - low)[meet]
    either = one[:, 3:6].prod(axis=1) + other[:, 3:6].prod(axis=1) - both
    iou[meet] = np.clip(both / either, 0, 1)  # boxes fill at least SMALLEST**3
    return iou


def _is_box(boxes: np.ndarray) -> np.ndarray:
    sides = boxes[..., 3:6]
    return np.all((sides > SMALLEST) & (sides < LARGEST), axis=-1)


def intersection_areas(
    boxes: np.ndarray,  # [K, 7]
    others: np.ndarray,  # [K, 7]
) -> np.ndarray:
    """(K,) float64: square metres that each box shares with its other one, seen from above.

    By Green's theorem: the area of a polygon is the integral of x dy along its edges. In the other
    box's own frame, moving every point of the polygon to the nearest one of that box keeps the area
    within it and leaves none outside, so that the integral of the moved edges is the shared area.
    An edge is straight between where it crosses the lines through the box's sides. Nothing is
    decided by whether a point is inside, so edges that coincide need no case of their own.
    """
    start = _corners_seen_from(boxes, others)  # [K, 4, 2]
    way = np.roll(start, -1, axis=1) - start
    half = others[:, None, 3:5] / 2  # [K, 1, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.stack([(-half - start) / way, (half - start) / way], axis=-1)
    # An edge along a line crosses it nowhere: then it has one piece.
    crossings = np.sort(np.nan_to_num(crossings, posinf=1, neginf=0).clip(0, 1), axis=-1)
    ends = crossings[:, :, 1]  # beyond these, y does not change any more
    knots = np.concatenate([ends, crossings[:, :, 0].clip(ends[..., :1], ends[..., 1:])], axis=-1)
    knots = np.sort(knots, axis=-1)  # [K, 4, 4] shares of the edge
    moved = start[..., None] + knots[:, :, None] * way[..., None]  # [K, 4, 2, 4]
    moved = moved.clip(-half[..., None], half[..., None])
    x, y = moved[:, :, 0], moved[:, :, 1]
    pieces = (x[..., 1:] + x[..., :-1]) / 2 * np.diff(y, axis=-1)
    return np.maximum(pieces.sum(axis=(1, 2)), 0)


def _corners_seen_from(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(K, 4, 2): the boxes' corners from above, in the frames of the other boxes."""
    apart = boxes[:, :2] - others[:, :2]
    centres = _turned(apart, -others[:, 6])
    corners = CORNERS * boxes[:, None, 3:5]
    return centres[:, None] + _turned(corners, (boxes[:, 6] - others[:, 6])[:, None])


def _turned(points: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Points (..., 2), turned counter-clockwise about the origin."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
