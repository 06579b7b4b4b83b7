"""A scene's source views with their depth, ready to be projected anywhere (paper section 3.2)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from geoevs.core.files import read_arrays, write_arrays
from geoevs.geometry.lift import lift_frame
from geoevs.methods.contract import Views
from geoevs.projection import Raster, rasterize_points
from geoevs.scenes.camera import Camera

if TYPE_CHECKING:
    from geoevs.geometry.depth_models import DepthModel


@dataclass(frozen=True)
class LiftedViews:
    """The source views of a scene and their depth, which methods that reproject keep.

    Args:
        views: the sources.
        depths: (H, W) float32 metres by frame and camera, 0 = none. Not float16: its 6 cm steps at
            100 m would be our own error, and a reloaded method must hit the same pixels.
    """

    views: Views
    depths: dict[int, dict[str, np.ndarray]]

    @classmethod
    def make(cls, views: Views, model: "DepthModel") -> Self:
        """Give every source view its depth."""
        return cls(views, {frame: model.depths(views, frame) for frame in views.frames})

    @property
    def pixels(self) -> int:
        """Source pixels that have a depth."""
        maps = [depth for depths in self.depths.values() for depth in depths.values()]
        return sum(int(np.count_nonzero(depth)) for depth in maps)

    def condition(
        self,
        camera: Camera,
        frame: int,
        keep: np.ndarray | None = None,  # [H, W] bool
    ) -> Raster:
        """The condition map X of a view: what explains it; outside `keep`, nothing."""
        image, mask, depth = self._explained(camera, frame)
        if keep is None:
            return Raster(image, mask, depth)
        return Raster(image * keep[..., None], mask & keep, depth * keep)

    def _explained(self, camera: Camera, frame: int) -> Raster:
        """The frame's cloud, rasterised."""
        xyz, rgb = lift_frame(self.views, frame, self.depths[frame], camera)
        return rasterize_points(xyz, rgb, camera)

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
        views = Views.load(folder / "views")
        arrays = read_arrays(folder / "depths.npz")
        depths = {
            frame: {name: arrays[f"{frame}/{name}"] for name in views.cameras}
            for frame in views.frames
        }
        return cls(views, depths)
