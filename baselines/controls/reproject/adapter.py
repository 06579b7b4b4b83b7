"""The source views of the frame, lifted by LiDAR and projected into the target; holes are black."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from geoevs.adapter import Budget, FitReport, MethodInfo, Rendering, Rng, Views
from geoevs.geometry.lift import lidar_depths, lift_frame
from geoevs.io import read_arrays, write_arrays
from geoevs.projection import rasterize
from geoevs.scenes.camera import Camera


@dataclass
class Method:
    """What geometry alone explains: the coloured cloud that conditions Geo-EVS, rasterised."""

    info: ClassVar[MethodInfo] = MethodInfo("Reprojection", paradigm="control", needs=("lidar",))
    views: Views = field(init=False)
    # By camera and frame. float32, not float16: its 6 cm steps at 100 m would be our own error,
    # and a reloaded method must place every point in the same pixel.
    depths: dict[int, dict[str, np.ndarray]] = field(init=False)  # each [H, W] float32 metres

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Complete the depth of every source view."""
        self.views = views
        self.depths = {frame: lidar_depths(views, frame) for frame in views.frames}
        maps = [depth for depths in self.depths.values() for depth in depths.values()]
        pixels = sum(int(np.count_nonzero(depth)) for depth in maps)
        return FitReport(primitives=pixels, note="primitives are source pixels with depth")

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Project the frame's cloud; `support` is where a point landed."""
        xyz, rgb = lift_frame(self.views, frame, self.depths[frame], camera)
        image, mask, depth = rasterize(xyz, rgb, camera)
        return Rendering(image, depth, mask)

    def render_masked(
        self,
        camera: Camera,
        frame: int,
        keep: np.ndarray,  # [H, W] bool
    ) -> Rendering:
        """The degraded condition map itself: black outside `keep` as in holes."""
        seen = self.render(camera, frame)
        support = seen.support & keep
        rgb = np.where(support[..., None], seen.rgb, 0)
        return Rendering(rgb, np.where(support, seen.depth, 0), support)

    def save(self, folder: Path) -> None:
        """Write the source views as a scene store, and their depths."""
        self.views.save(folder / "views")
        arrays = {
            f"{frame}/{name}": depth
            for frame, depths in self.depths.items()
            for name, depth in depths.items()
        }
        write_arrays(folder / "depths.npz", arrays)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Open the scene store and read the depths."""
        method = cls()
        method.views = views = Views.load(folder / "views")
        arrays = read_arrays(folder / "depths.npz")
        method.depths = {
            frame: {name: arrays[f"{frame}/{name}"] for name in views.cameras}
            for frame in views.frames
        }
        return method
