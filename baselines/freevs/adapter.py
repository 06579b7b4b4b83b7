"""FreeVS: project the LiDAR of neighbouring frames into the view, generate a clip around it."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from baselines.freevs.pseudo_images import Sweeps
from baselines.freevs.sampling import Guidance, Sampling, SigmaMax
from geoevs.core.randomness import Rng
from geoevs.core.settings import Count
from geoevs.diffusion.sampled_method import SampledMethod
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.methods.trained import trained_seconds
from geoevs.scenes.camera import Camera

if TYPE_CHECKING:
    from baselines.freevs.model import ClipGenerator

# torch is imported where networks are made: configs are checked without one.


@dataclass
class Method(SampledMethod):
    """FreeVS at the size of this suite's scenes; see docs/freevs.md.

    Args:
        steps, guidance, sigma_max, average: see `Sampling`; None takes what it was trained for.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "FreeVS",
        paradigm="diffusion",
        extra_prior="pretrained latent diffusion",
        needs=("lidar", "tracks", "training"),
        citation="Wang et al.: FreeVS, ICLR 2025",
    )
    sampling: ClassVar[type] = Sampling
    steps: Count | None = None
    guidance: Guidance | None = None
    sigma_max: SigmaMax | None = None
    average: Count | None = None
    _views: Views = field(init=False)
    _sweeps: Sweeps = field(init=False)

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Sort the scene's LiDAR points; the networks were trained before."""
        self._load_trained()
        self._views, self._sweeps = views, Sweeps.read(views)
        self._draw_seed(rng)
        notes = ["primitives are LiDAR points with a colour"]
        if not self._sweeps.count:
            notes.append("there are none: pictures are the prior's alone")
        if not len(views.tracks):
            notes.append("no tracks: what moves is smeared")
        if len(views.frames) == 1:
            notes.append("one frame: no neighbours' points, and its clip repeats it")
        seconds = trained_seconds(Path(self.weights))
        return FitReport(self._sweeps.count, self._parameters(), "; ".join(notes), seconds)

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Generate the clip around the view; `support` and `depth` are its pseudo-image's."""
        return self.render_masked(camera, frame, np.ones((camera.height, camera.width), bool))

    def render_masked(
        self,
        camera: Camera,
        frame: int,
        keep: np.ndarray,  # [H, W] bool
    ) -> Rendering:
        """The same from pseudo-images, of all the clip's frames, that are hidden outside `keep`."""
        frames = self._clip(frame)
        shown = [
            self._sweeps.pseudo_image(self._moved(camera, frame, other), other) for other in frames
        ]
        images = np.stack([raster.image * keep[..., None] for raster in shown], dtype=np.float32)
        valid = np.stack([raster.mask & keep for raster in shown])
        random = self._noise_of(camera, frame)
        (generated,) = self._generator.generate(images, valid, self._sampling, random)
        middle = self._generator.middle
        return Rendering(generated, shown[middle].depth * keep, valid[middle])

    def _clip(self, frame: int) -> list[int]:
        """The frames of a clip around one; those beyond the scene are its first or last again."""
        frames, length = self._views.frames, self._generator.denoiser.frames
        first = frames.index(frame) - self._generator.middle
        places = np.clip(np.arange(first, first + length), 0, len(frames) - 1)
        return [frames[place] for place in places]

    def _moved(self, camera: Camera, frame: int, other: int) -> Camera:
        """Where a camera that stands so on the vehicle in one frame is in another."""
        if other == frame:
            return camera
        mounted = self._views.cameras[0]
        now, then = (self._views.camera(mounted, number) for number in (frame, other))
        motion = then.world_from_camera @ now.camera_from_world
        return replace(camera, world_from_camera=motion @ camera.world_from_camera)

    def _read_generator(self, folder: Path) -> "ClipGenerator":
        from baselines.freevs.model import ClipGenerator

        return ClipGenerator.load(folder)

    def save(self, folder: Path) -> None:
        """Write the views; link the weights, which many scenes share."""
        self._views.save(folder / "views")
        self._save_trained(folder)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Restore a fitted method from the folder that `save` filled."""
        method = cls._load_saved(folder)
        method._views = Views.load(folder / "views")
        method._sweeps = Sweeps.read(method._views)
        return method
