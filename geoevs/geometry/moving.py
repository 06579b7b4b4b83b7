"""Which pixels of a view show what moves."""

import numpy as np
import pandas as pd

from geoevs.projection import unproject_depth
from geoevs.scenes.boxes import moving_boxes
from geoevs.scenes.camera import Camera


def moving_pixels(
    depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
    frame: int,
    tracks: pd.DataFrame,
    margin: float = 1.0,
) -> np.ndarray:
    """Pixels whose point lies in a box that moves.

    Args:
        depth: of the view.
        camera: the view.
        frame: whose boxes.
        tracks: see TRACK_COLUMNS.
        margin: what the boxes' sides are multiplied by.

    Returns:
        (H, W) bool.
    """
    points, pixels = unproject_depth(depth, camera)
    moving = np.zeros(depth.size, bool)
    for box in moving_boxes(tracks, (frame,)):
        size = {side: margin * getattr(box, side) for side in ("length", "width", "height")}
        moving[pixels] |= box._replace(**size).holds(points)
    return moving.reshape(depth.shape)
