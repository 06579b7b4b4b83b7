"""Geo-EVS: lift the frame by its geometry, project it into the target, generate the image."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.randomness import Rng
from geoevs.core.settings import Count
from geoevs.diffusion.sampled_method import SampledMethod
from geoevs.diffusion.sampling import Guidance, Sampler, Sampling, Steps
from geoevs.geometry.depth_models import make_depth_model
from geoevs.geometry.lifted import LiftedViews
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.methods.trained import GEOMETRY_FILE, trained_seconds
from geoevs.projection import Raster
from geoevs.scenes.camera import Camera

if TYPE_CHECKING:
    from geoevs.generator.geo_evs.model import Generator

# torch is imported where networks are made: configs are checked without one.


@dataclass
class Method(SampledMethod):
    """The paper's method, faithfully: every pixel is generated.

    Args:
        steps, guidance, sampler, average: see `Sampling`; None takes what it was trained for.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "Geo-EVS",
        paradigm="diffusion",
        extra_prior="pretrained latent diffusion",
        needs=("lidar", "training"),
        citation="Lan, Tang, He: Geo-EVS",
    )
    lifting: ClassVar[type[LiftedViews]] = LiftedViews
    sampling: ClassVar[type] = Sampling
    steps: Steps | None = None
    guidance: Guidance | None = None
    sampler: Sampler | None = None
    average: Count | None = None
    _lifted: LiftedViews = field(init=False)

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Estimate the depth of every source view; the networks were trained before."""
        settings, folder = self._load_trained(), Path(self.weights)
        geometry = folder / GEOMETRY_FILE
        model = make_depth_model(settings["geometry"], geometry if geometry.exists() else None)
        self._lifted = self.lifting.make(views, model)
        self._draw_seed(rng)
        parameters = model.parameters + self._parameters()
        note, seconds = "primitives are source pixels with depth", trained_seconds(folder)
        return FitReport(self._lifted.pixels, parameters, note, seconds)

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Generate the view; `support` and `depth` are those of its condition map."""
        return self._render(self.condition(camera, frame), camera, frame)

    def condition(self, camera: Camera, frame: int) -> Raster:
        """The condition map of a view: all that its picture is generated from."""
        return self._lifted.condition(camera, frame)

    def render_masked(
        self,
        camera: Camera,
        frame: int,
        keep: np.ndarray,  # [H, W] bool
    ) -> Rendering:
        """The same from a condition map that is hidden outside `keep`."""
        return self._render(self._lifted.condition(camera, frame, keep), camera, frame)

    def _render(self, condition: Raster, camera: Camera, frame: int) -> Rendering:
        if not condition.mask.any():
            # PandaSet's back camera has no LiDAR: one such view must not fail all others.
            warnings.warn(
                f"the condition map of '{camera.name}' in frame {frame} has no valid pixel, so its "
                "picture is the prior's alone; choose targets that some lifted view overlaps",
                stacklevel=2,
            )
        image = condition.image.astype(np.float32)
        random = self._noise_of(camera, frame)  # the same for every variant
        (generated,) = self._generator.generate(
            image[None], condition.mask[None], self._sampling, random
        )
        rgb = self._finish(generated, image, condition.mask)
        return Rendering(rgb, condition.depth, condition.mask)

    def _finish(
        self, generated: np.ndarray, condition: np.ndarray, valid: np.ndarray
    ) -> np.ndarray:
        """What is shown of the generated image."""
        return generated

    def _read_generator(self, folder: Path) -> "Generator":
        from geoevs.generator.geo_evs.model import Generator

        return Generator.load(folder)

    def _load_trained(self) -> dict[str, Any]:
        """As for any such method; sampling must visit no timestep that was not trained."""
        settings = super()._load_trained()
        if settings["timesteps"] == "sampled":
            self._check_timesteps(Sampling(**settings["sampling"]))
        return settings

    def _check_timesteps(self, trained: Sampling) -> None:
        """At timesteps that no training visited, the network's answers mean nothing."""
        asked = self._sampling
        learned, visited = (
            set(self._generator.diffusion.timesteps(s.steps, s.sampler).tolist())
            for s in (trained, asked)
        )
        if not visited <= learned:
            raise GeoEvsError(
                f"{self.weights} was trained at the {len(learned)} timesteps of sampling with "
                f"steps={trained.steps} and sampler={trained.sampler} alone, and steps="
                f"{asked.steps} with sampler={asked.sampler} visits others; set `timesteps: "
                "uniform` in its training section, or drop the options steps and sampler"
            )

    def save(self, folder: Path) -> None:
        """Write the views and depths; link the weights, which many scenes share."""
        self._lifted.save(folder)
        self._save_trained(folder)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Restore a fitted method from the folder that `save` filled."""
        method = cls._load_saved(folder)
        method._lifted = cls.lifting.load(folder)
        return method
