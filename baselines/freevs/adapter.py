"""FreeVS: project the LiDAR of neighbouring frames into the view, generate a clip around it."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from baselines.freevs.pseudo_images import Sweeps
from baselines.freevs.sampling import Guidance, Sampling, SigmaMax
from geoevs.core.files import read_json, write_json
from geoevs.core.randomness import Rng
from geoevs.core.settings import Count
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.methods.trained import asked_options, link_trained, read_trained, trained_seconds
from geoevs.scenes.camera import Camera

if TYPE_CHECKING:
    from baselines.freevs.model import ClipGenerator

# torch is imported where networks are made: configs are checked without one.

SAMPLING_OPTIONS = ("steps", "guidance", "sigma_max", "average")


@dataclass
class Method:
    """The published method at the size of this suite's scenes; see docs/freevs.md.

    Args:
        weights: what `geoevs train freevs` wrote.
        steps, guidance, sigma_max, average: see `Sampling`; None takes what it was trained for.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "FreeVS",
        paradigm="diffusion",
        extra_prior="pretrained latent diffusion",
        needs=("lidar", "tracks", "training"),
        citation="Wang et al.: FreeVS, ICLR 2025",
    )
    weights: str
    steps: Count | None = None
    guidance: Guidance | None = None
    sigma_max: SigmaMax | None = None
    average: Count | None = None
    _views: Views = field(init=False)
    _sweeps: Sweeps = field(init=False)
    _generator: "ClipGenerator" = field(init=False)
    _sampling: Sampling = field(init=False)
    _seed: int = field(init=False)

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Sort the scene's LiDAR points; the networks were trained before."""
        self._load_trained()
        self._views, self._sweeps = views, Sweeps.read(views)
        self._seed = int(rng.numpy.integers(2**31))
        networks = self._generator.autoencoder, self._generator.denoiser
        parameters = sum(p.numel() for network in networks for p in network.parameters())
        notes = ["primitives are LiDAR points with a colour"]
        if not self._sweeps.count:
            notes.append("there are none: pictures are the prior's alone")
        if not len(views.tracks):
            notes.append("no tracks: what moves is smeared")
        if len(views.frames) == 1:
            notes.append("one frame: no neighbours' points, and its clip repeats it")
        seconds = trained_seconds(Path(self.weights))
        return FitReport(self._sweeps.count, parameters, "; ".join(notes), seconds)

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
        # The view's own noise, whatever was rendered before.
        random = Rng(self._seed, camera.name, str(frame)).torch
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

    def _load_trained(self) -> None:
        """Read the networks, and how they sample."""
        from baselines.freevs.model import ClipGenerator

        settings = read_trained(Path(self.weights))
        asked = asked_options(self, SAMPLING_OPTIONS)
        self._sampling = Sampling(**settings["sampling"] | asked)
        self._generator = ClipGenerator.load(Path(self.weights))

    def save(self, folder: Path) -> None:
        """Write the views; link the weights, which many scenes share."""
        self._views.save(folder / "views")
        link_trained(Path(self.weights), folder / "weights")
        options = {name: getattr(self, name) for name in SAMPLING_OPTIONS}
        write_json(folder / "options.json", {**options, "seed": self._seed})

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote."""
        options = read_json(folder / "options.json")
        seed = options.pop("seed")
        method = cls(str(folder / "weights"), **options)
        method._load_trained()
        method._views = Views.load(folder / "views")
        method._sweeps, method._seed = Sweeps.read(method._views), seed
        return method
