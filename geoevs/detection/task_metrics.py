"""How well a detector that was trained on recorded views does on a rig that moved aside.

NTA-IoU is the novel trajectory agent IoU of Zhao et al., DriveDreamer4D (CVPR 2025), with a
detector of 3-D boxes in the place of theirs.
"""

from collections.abc import Sequence

import numpy as np

from geoevs.detection.iou import CORNERS
from geoevs.detection.labels import most_visible
from geoevs.scenes.camera import Camera

NTA_IOU = "nta_iou"
"""Agents: the metric of this module. Lanes would be rows of another name beside it."""

CLOSEST = 0.3
"""Metres before a camera at which boxes are cut."""

_EDGES = [(k, (k + 1) % 4) for k in range(4)]
EDGES = np.array([*_EDGES, *((a + 4, b + 4) for a, b in _EDGES), *((k, k + 4) for k in range(4))])
"""The (12, 2) edges of a box, by `box_corners`' numbers."""


def box_corners(boxes: np.ndarray) -> np.ndarray:
    """(N, 8, 3) corners of boxes (N, 7): the lower four counter-clockwise, then the upper four."""
    flat = CORNERS * boxes[:, None, 3:5]  # [N, 4, 2]
    cos, sin = np.cos(boxes[:, 6:]), np.sin(boxes[:, 6:])
    x = cos * flat[..., 0] - sin * flat[..., 1] + boxes[:, :1]
    y = sin * flat[..., 0] + cos * flat[..., 1] + boxes[:, 1:2]
    z = boxes[:, 2:3] + boxes[:, 5:6] * np.array([-0.5, 0.5])  # [N, 2]
    levels = [np.stack([x, y, np.broadcast_to(z[:, [k]], x.shape)], axis=-1) for k in (0, 1)]
    return np.concatenate(levels, axis=1)


def edges_before(
    boxes: np.ndarray,  # [N, 7]
    image_from_vehicle: np.ndarray,  # [3, 4]
) -> tuple[np.ndarray, np.ndarray]:
    """The parts of boxes' edges that lie CLOSEST or more before a camera, in its image.

    Returns:
        (N, 12, 2, 2) float64 ends in pixels; (N, 12) bool: edges of which a part lies there.
    """
    corners = box_corners(boxes)
    seen = corners @ image_from_vehicle[:, :3].T + image_from_vehicle[:, 3]  # [N, 8, 3]
    ends = seen[:, EDGES]  # [N, 12, 2, 3]
    start, end = ends[:, :, 0], ends[:, :, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (CLOSEST - start[..., 2]) / (end[..., 2] - start[..., 2])
        cut = start + share[..., None] * (end - start)
        behind = ends[..., 2] < CLOSEST  # [N, 12, 2]
        ends = np.where(behind[..., None], cut[:, :, None], ends)
        return ends[..., :2] / ends[..., 2:], ~behind.all(axis=-1)


def image_boxes(
    boxes: np.ndarray,  # [N, 7]
    image_from_vehicle: np.ndarray,  # [3, 4]
    height: int,
    width: int,
) -> np.ndarray:
    """(N, 4) float64 left, top, right, bottom in pixels: what boxes cover of an image.

    A box of which nothing lies in the image has no area.
    """
    ends, there = edges_before(boxes, image_from_vehicle)
    bounds = np.array([width, height], float)
    low = np.where(there[..., None, None], ends, np.inf).min(axis=(1, 2), initial=np.inf)
    high = np.where(there[..., None, None], ends, -np.inf).max(axis=(1, 2), initial=-np.inf)
    low, high = np.clip(low, 0, bounds), np.clip(high, 0, bounds)
    return np.concatenate([low, np.maximum(low, high)], axis=1)


def image_iou(
    boxes: np.ndarray,  # [N, 4]
    others: np.ndarray,  # [M, 4]
) -> np.ndarray:
    """(N, M) float64: intersection over union of boxes in an image; 0 where one has no area."""
    low = np.maximum(boxes[:, None, :2], others[:, :2])
    high = np.minimum(boxes[:, None, 2:], others[:, 2:])
    both = np.maximum(high - low, 0).prod(axis=-1)
    areas = [(some[:, 2:] - some[:, :2]).prod(axis=-1) for some in (boxes, others)]
    either = areas[0][:, None] + areas[1] - both
    return np.divide(both, either, out=np.zeros_like(both), where=either > 0)


def agent_ious(
    predictions: np.ndarray,  # [N, 7]
    scores: np.ndarray,  # [N]
    vehicles: np.ndarray,  # [M, 7]
    cameras: Sequence[Camera],
    pose: np.ndarray,  # [4, 4]
) -> np.ndarray:
    """The best IoU that each labelled vehicle has with a prediction, in the camera that shows it.

    As many predictions count as there are vehicles to be found, those of highest score: a detector
    that reports more boxes gains nothing.

    Args:
        predictions: boxes of vehicles in the moved rig's vehicle frame.
        scores: theirs.
        vehicles: labelled ones, in the same frame; who lies in no image is left out.
        cameras: of the moved rig.
        pose: world from its vehicle frame.

    Returns:
        (K,) float64, one of each vehicle that a camera shows.
    """
    centres = vehicles[:, :3] @ pose[:3, :3].T + pose[:3, 3]
    shown = np.array(most_visible(centres, cameras), object)
    first = np.argsort(-scores, kind="stable")[: int((shown != "").sum())]
    found = []
    for camera in cameras:
        matrix = image_from_vehicle(camera, pose)
        size = camera.height, camera.width
        truths = image_boxes(vehicles[shown == camera.name], matrix, *size)
        iou = image_iou(truths, image_boxes(predictions[first], matrix, *size))
        found.append(iou.max(axis=1, initial=0))
    return np.concatenate(found)


def image_from_vehicle(camera: Camera, pose: np.ndarray) -> np.ndarray:
    """(3, 4) float64: from the vehicle's frame, whose place in the world is `pose`, to pixels.

    The third coordinate is the depth in metres, by which the others are divided.
    """
    return camera.K @ (camera.camera_from_world @ pose)[:3]
