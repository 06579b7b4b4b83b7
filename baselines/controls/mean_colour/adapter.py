"""The floor: every pixel takes the mean colour of all source images of the scene."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from geoevs.core.files import read_json, write_json
from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.scenes.camera import Camera


@dataclass
class Method:
    """The mean colour of the source images, everywhere: methods that use more must beat it."""

    info: ClassVar[MethodInfo] = MethodInfo("Mean colour", paradigm="control")
    colour: np.ndarray = field(init=False)  # [3] float64 in [0, 1]

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Average all pixels of all source images, each image with the same weight."""
        means = [
            views.image(name, frame).mean(axis=(0, 1), dtype=np.float64)
            for frame in views.frames
            for name in views.cameras
        ]
        self.colour = np.mean(means, axis=0)
        return FitReport(parameters=3)

    def render(self, camera: Camera, frame: int) -> Rendering:
        """A view of the one colour, supported nowhere."""
        shape = camera.height, camera.width
        rgb = np.broadcast_to(self.colour.astype(np.float32), (*shape, 3)).copy()
        return Rendering(rgb, support=np.zeros(shape, bool))

    def render_masked(
        self,
        camera: Camera,
        frame: int,
        keep: np.ndarray,  # [H, W] bool
    ) -> Rendering:
        """The same: no condition map is used, so that this is the floor of masked views too."""
        return self.render(camera, frame)

    def save(self, folder: Path) -> None:
        """Write the mean colour as JSON."""
        write_json(folder / "colour.json", self.colour.tolist())

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Restore the method from the colour that `save` wrote."""
        method = cls()
        method.colour = np.array(read_json(folder / "colour.json"))
        return method
