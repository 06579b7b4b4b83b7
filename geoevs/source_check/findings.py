"""What `check-source` looks at, and what it finds."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.boxes import Box, moving_boxes
from geoevs.scenes.scene import Frame, SceneExtras, SceneInfo

OK, WRONG, NOT_CHECKED = "ok", "wrong", "not checked"
EGO_REACH = 2.5
"""Metres around the cameras whose points may be of the car that carries them."""


class Finding(NamedTuple):
    """One line: what was checked, OK, WRONG or NOT_CHECKED, and what was found or why not."""

    name: str
    status: str
    sentence: str


class NotCheckedError(GeoEvsError):
    """What stands in the way of a check, in words that follow `not checked:`."""


class Sample(NamedTuple):
    """The first frames of a scene, as its source gives them."""

    info: SceneInfo
    tracks: pd.DataFrame
    extras: SceneExtras
    frames: Sequence[Frame]

    def centre(self, frame: Frame) -> np.ndarray:
        """(3,) metres: the middle of a frame's cameras, near which the LiDAR stands."""
        return np.mean([camera.centre for camera in frame.cameras.values()], axis=0)

    def boxes(self, frame: Frame) -> list[Box]:
        """The boxes of one frame."""
        return Box.rows(self.tracks[self.tracks["frame"] == frame.frame])

    def still_points(self, frame: Frame) -> np.ndarray:
        """(N, 3) float64 LiDAR points that are neither the ego car's nor in a moving box."""
        xyz = frame.points.xyz.astype(np.float64)
        keep = np.linalg.norm(xyz - self.centre(frame), axis=1) > EGO_REACH
        for box in moving_boxes(self.tracks, [frame.frame]):
            keep &= ~box.holds(xyz, margin=0.5)
        return xyz[keep]

    def need_points(self) -> None:
        """Go on only if there is LiDAR.

        Raises:
            NotCheckedError: no frame that was read has a point.
        """
        if not any(len(frame.points) for frame in self.frames):
            raise NotCheckedError("there is no LiDAR; an import refuses such frames")
