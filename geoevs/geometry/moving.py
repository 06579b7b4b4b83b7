"""Which pixels of a view lie in boxes, and which show what moves."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from geoevs.projection import unproject_depth
from geoevs.scenes.boxes import Box, moving_boxes
from geoevs.scenes.camera import Camera


def pixels_in_boxes(
    depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
    boxes: Iterable[Box],
    margin: float = 0.0,
) -> np.ndarray:
    """(H, W) bool: pixels of a view whose point lies in a box, or at most `margin` metres off."""
    points, pixels = unproject_depth(depth, camera)
    inside = np.zeros(depth.size, bool)
    for box in boxes:
        inside[pixels] |= box.holds(points, margin)
    return inside.reshape(depth.shape)


def moving_pixels(
    depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
    frame: int,
    tracks: pd.DataFrame,
    scale: float = 1.0,
) -> np.ndarray:
    """Pixels whose point lies in a box that moves.

    Args:
        depth: of the view.
        camera: the view.
        frame: whose boxes.
        tracks: see TRACK_COLUMNS.
        scale: what the boxes' sides are multiplied by.

    Returns:
        (H, W) bool.
    """
    return pixels_in_boxes(
        depth, camera, (box.scaled(scale) for box in moving_boxes(tracks, (frame,)))
    )
