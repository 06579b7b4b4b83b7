"""The source views of the frame, lifted by LiDAR and projected into the target; holes are black."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from geoevs.adapter import Budget, FitReport, MethodInfo, Rendering, Rng, Views
from geoevs.geometry.depth_models import LidarDepth
from geoevs.geometry.lifted import LiftedViews
from geoevs.scenes.camera import Camera


@dataclass
class Method:
    """What geometry alone explains: the coloured cloud that conditions Geo-EVS, rasterised."""

    info: ClassVar[MethodInfo] = MethodInfo("Reprojection", paradigm="control", needs=("lidar",))
    _lifted: LiftedViews = field(init=False)

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Complete the depth of every source view."""
        self._lifted = LiftedViews.make(views, LidarDepth())
        return FitReport(self._lifted.pixels, note="primitives are source pixels with depth")

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Project the frame's cloud; `support` is where a point landed."""
        return self._shown(camera, frame, None)

    def render_masked(
        self,
        camera: Camera,
        frame: int,
        keep: np.ndarray,  # [H, W] bool
    ) -> Rendering:
        """The degraded condition map itself: black outside `keep` as in holes."""
        return self._shown(camera, frame, keep)

    def _shown(self, camera: Camera, frame: int, keep: np.ndarray | None) -> Rendering:
        image, mask, depth = self._lifted.condition(camera, frame, keep)
        return Rendering(image, depth, mask)

    def save(self, folder: Path) -> None:
        """Write the source views and their depths."""
        self._lifted.save(folder)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote."""
        method = cls()
        method._lifted = LiftedViews.load(folder)
        return method
