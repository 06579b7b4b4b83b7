"""Source views, lifted by LiDAR and projected into the target; holes are black."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Self

import numpy as np

from geoevs.core.files import read_json, write_json
from geoevs.core.randomness import Rng
from geoevs.core.settings import OneOf, check_fields
from geoevs.geometry.blending import BlendedViews
from geoevs.geometry.depth_models import LidarDepth
from geoevs.geometry.lifted import LiftedViews
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.scenes.camera import Camera

FRAMES = {"own": LiftedViews, "all": BlendedViews}
Frames = Annotated[str, OneOf(FRAMES)]


@dataclass
class Method:
    """Reprojection alone: the condition map of Geo-EVS, with depth by LiDAR and no network.

    Args:
        frames: `own`, the frame's cloud rasterised as the paper has it; or `all`, what all frames
            explain together, as `geo-evs-support` has it.
    """

    info = MethodInfo("Reprojection", paradigm="control", needs=("lidar",))  # `all`: tracks too
    frames: Frames = "own"
    _lifted: LiftedViews = field(init=False)

    def __post_init__(self) -> None:
        check_fields(f"method '{self.info.name}'", self)
        if self.frames == "all":
            self.info = replace(self.info, needs=(*self.info.needs, "tracks"))

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Complete the depth of every source view."""
        self._lifted = FRAMES[self.frames].make(views, LidarDepth())
        return FitReport(self._lifted.pixels, note="primitives are source pixels with depth")

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Project the cloud; `support` is where a point landed."""
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
        """Write the option, the source views and their depths."""
        self._lifted.save(folder)
        write_json(folder / "reproject.json", {"frames": self.frames})

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Restore a fitted method from the folder that `save` filled."""
        method = cls(**read_json(folder / "reproject.json"))
        method._lifted = FRAMES[method.frames].load(folder)
        return method
