"""What data sources of recorded drives decide alike, so that their scores compare."""

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import SceneRef, Truth

FORWARD_FROM_OPENCV = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
"""(4, 4) the axes of OpenCV (right, down, forward) in those of a vehicle (forward, left, up)."""

MOVING_SPEED = 0.5
"""Metres a second along the ground from which a box counts as moving: below it are the errors of
parked cars' boxes."""


class RecordedSource:
    """What sources of recorded drives answer alike (see SceneSource)."""

    has_truth = False

    scene_words: ClassVar[str]
    """What sentences call one of its scenes, such as `PandaSet scene`."""

    def check(self, scene: SceneRef) -> None:
        """Refuse nothing yet: a run whose scenes were read goes on without the data set."""

    def truth(self, scene: SceneRef, views: Sequence[tuple[Camera, int]]) -> Iterator[Truth]:
        """Recorded data have no truth where no camera stood.

        Raises:
            GeoEvsError: always.
        """
        raise GeoEvsError(
            f"{self.scene_words} '{scene.name}' has no dense truth at new poses; score it on its "
            "sparse reference, or use a procedural scene"
        )


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
