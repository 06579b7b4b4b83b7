"""What data sources of recorded drives decide alike, so that their scores compare."""

import numpy as np
import pandas as pd

MOVING_SPEED = 0.5
"""Metres a second along the ground from which a box counts as moving: below it are the errors of
parked cars' boxes."""


def mark_moving(tracks: pd.DataFrame, moves: np.ndarray) -> pd.DataFrame:
    """The boxes with `moving`: a track that moves in any frame moves in all of them.

    Args:
        tracks: boxes with a column `track`.
        moves: (N,) bool: whether a box moves at its instant, by what the data say or by
            MOVING_SPEED.

    >>> tracks = pd.DataFrame({"track": ["a", "b", "a"]})
    >>> mark_moving(tracks, np.array([True, False, False]))["moving"].tolist()
    [True, False, True]
    """
    moving = pd.Series(moves, tracks.index, bool).groupby(tracks["track"]).transform("any")
    return tracks.assign(moving=moving.astype(bool))


def beams_by_elevation(
    points: np.ndarray,  # [N, 3] metres, x and y level, z up, from the LiDAR
    count: int,
) -> np.ndarray:
    """(N,) uint16: beams for a LiDAR whose data name none, counted from the top.

    The range of elevations is cut into `count` equal bins. Beams of one laser may share bins with
    their neighbours, but a point never changes its half of a `lidar_split: beam` by its distance.

    >>> beams_by_elevation(np.array([[1.0, 0, 0], [1, 0, -1], [0, 2, 2]]), 4).tolist()
    [2, 3, 0]
    """
    if not len(points):
        return np.zeros(0, np.uint16)
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    top, bottom = elevation.max(), elevation.min()
    share = (top - elevation) / max(top - bottom, np.finfo(float).tiny)
    return np.minimum(share * count, count - 1).astype(np.uint16)
