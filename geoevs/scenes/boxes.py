"""Boxes of tracks: what lies in one, and where it is when the box has moved."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
import pandas as pd

from geoevs.scenes.scene import TRACK_COLUMNS

SIGNS = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
"""(8, 3) of a box's corners, in its own axes."""

EDGES = np.array([(i, j) for i in range(8) for j in range(i) if (SIGNS[i] != SIGNS[j]).sum() == 1])
"""(12, 2) the corners that a box's edges join."""


class Box(NamedTuple):
    """A row of tracks: metres, and degrees about the world's vertical axis (see TRACK_COLUMNS)."""

    frame: int
    track: str
    label: str
    x: float
    y: float
    z: float
    length: float
    width: float
    height: float
    yaw: float
    moving: bool

    @classmethod
    def rows(cls, tracks: pd.DataFrame) -> list[Self]:
        """The boxes of tracks, in their order."""
        columns = tracks[list(TRACK_COLUMNS)]
        return [cls(*row) for row in columns.itertuples(index=False, name=None)]

    def local(
        self,
        points: np.ndarray,  # [N, 3] in the world
    ) -> np.ndarray:
        """(N, 3) float64 the points from the box's centre: forward, to the left, up."""
        return (points - self._centre) @ self._axes

    def world(
        self,
        local: np.ndarray,  # [N, 3] as `local` gives them
    ) -> np.ndarray:
        """(N, 3) float64 the inverse of `local`: with the box of another frame, points moved."""
        return local @ self._axes.T + self._centre

    def holds(
        self,
        points: np.ndarray,  # [N, 3] in the world
        margin: float = 0.0,
    ) -> np.ndarray:
        """(N,) bool: the points inside, or at most `margin` metres beyond a face."""
        half = np.array([self.length, self.width, self.height]) / 2 + margin
        return (np.abs(self.local(points)) <= half).all(axis=1)

    @property
    def corners(self) -> np.ndarray:
        """(8, 3) in the world; the first four are those of its front face."""
        return self.world(SIGNS * np.array([self.length, self.width, self.height]) / 2)

    def scaled(self, factor: float) -> Self:
        """The box about the same centre, its sides multiplied."""
        length, width, height = (factor * side for side in (self.length, self.width, self.height))
        return self._replace(length=length, width=width, height=height)

    @property
    def _centre(self) -> np.ndarray:
        return np.array([self.x, self.y, self.z])

    @property
    def _axes(self) -> np.ndarray:
        """(3, 3) world directions of the box's axes, one a column."""
        cos, sin = np.cos(np.radians(self.yaw)), np.sin(np.radians(self.yaw))
        return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def moving_boxes(tracks: pd.DataFrame, frames: Sequence[int]) -> list[Box]:
    """The boxes of what moves, in these frames alone, in the tracks' order."""
    # A column of no rows, or one read with gaps, may hold objects instead of truth values.
    moves = tracks["moving"].astype(bool) & tracks["frame"].isin(frames)
    return Box.rows(tracks[moves])
