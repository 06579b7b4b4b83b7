"""What methods of Gaussians share as adapters: options, the fit's frame, rendering and files."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Self

import numpy as np

from baselines.gaussians.options import FEWEST, Densification
from geoevs.core.files import read_arrays, write_arrays
from geoevs.core.progress import training_bar
from geoevs.core.randomness import Rng
from geoevs.core.settings import AtLeast, AtMost, Count, check_fields
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.scenes.camera import Camera
from geoevs.scenes.splats import Splats

if TYPE_CHECKING:
    from baselines.gaussians.nodes import SceneGraph
    from baselines.gaussians.training import OwnLoss, Photo

    Prepared = tuple[SceneGraph, dict[str, float], OwnLoss, list[str]]
    """Nodes, their extents, a method's own loss, notes."""

# torch is imported where a scene is made: configs are checked without one.

STEPS_A_PHOTOGRAPH = 62
SOLID = 0.5  # opacity from which a pixel has a depth
FILE = "scene.npz"


@dataclass
class GaussianMethod:
    """A method that trains the nodes of a scene; see docs/gaussians.md.

    Args:
        iterations: optimiser steps; None: STEPS_A_PHOTOGRAPH for each. A budget of seconds may end
            the fit earlier.
        gaussians: how many the background has, FEWEST or more; None: as few as the scene needs.
        densification: `mcmc` or `gradient`.
        sfm_cache: a folder that keeps the points of SfM for other fits to the same views, whose
            seconds are then without it, as their notes say.

    Raises:
        GeoEvsError: an option has no such value.
    """

    info: ClassVar[MethodInfo]
    iterations: Count | None = None
    gaussians: Annotated[int, AtLeast(FEWEST), AtMost(10**8)] | None = None
    densification: Densification = "mcmc"
    sfm_cache: str | None = None
    _graph: "SceneGraph" = field(init=False)

    def __post_init__(self) -> None:
        check_fields(f"method '{self.info.name}'", self)

    def _train(
        self,
        views: Views,
        budget: Budget,
        rng: Rng,
        prepare: "Callable[[list[Photo], int], Prepared]",
    ) -> FitReport:
        """Train what `prepare` makes of the photographs and of the most Gaussians to start from."""
        until = time.monotonic() + (float("inf") if budget.seconds is None else budget.seconds)
        from baselines.gaussians.gsplat_backend import usable_device
        from baselines.gaussians.size import HELD_OUT, MOST, UNCHOSEN, SizeChoice
        from baselines.gaussians.training import Trainer, make_strategy, photos_of, train

        photos = photos_of(views, usable_device())
        iterations = self.iterations or STEPS_A_PHOTOGRAPH * len(photos)
        enough = len(photos) >= HELD_OUT
        cap = self.gaussians or (MOST if enough else UNCHOSEN)
        self._graph, extents, own_loss, notes = prepare(photos, cap)
        choice = None
        if self.gaussians is None:
            if enough:
                choice = SizeChoice(iterations)
            else:
                notes.append(f"{len(photos)} views are too few to choose a size by")
        strategy = make_strategy(self.densification, cap, iterations)
        trainer = Trainer(self._graph, iterations, extents, strategy, own_loss, rng.torch)
        title = f"{self.info.name} of {views.scene_name}"
        with training_bar(title, iterations) as report:
            steps = train(trainer, photos, choice, until, rng.torch, report)
        if steps < iterations:
            notes.append(f"{steps} of {iterations} iterations in the budget")
        return FitReport(len(self._graph), self._graph.parameters(), "; ".join(notes))

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Draw the scene; depth where it is mostly opaque."""
        import torch

        with torch.inference_mode():
            picture = self._graph.draw(camera, frame).picture
        depth = torch.where(picture.opacity > SOLID, picture.depth, 0.0)
        return Rendering(picture.rgb.clamp(0, 1).cpu().numpy(), depth.cpu().numpy())

    def splats(self, frame: int) -> Splats:
        """The Gaussians of all nodes in a frame, and the sky as some of its own."""
        from baselines.gaussians.export import scene_splats

        return scene_splats(self._graph, frame)

    def save(self, folder: Path) -> None:
        """Write the Gaussians and parameters of all nodes."""
        from baselines.gaussians.storage import scene_arrays

        write_arrays(folder / FILE, scene_arrays(self._graph))

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Restore a fitted method from the folder that `save` filled."""
        from baselines.gaussians.gsplat_backend import usable_device
        from baselines.gaussians.storage import scene_from_arrays

        method = cls()
        arrays: dict[str, np.ndarray] = read_arrays(folder / FILE)
        method._graph = scene_from_arrays(arrays, usable_device())
        return method
