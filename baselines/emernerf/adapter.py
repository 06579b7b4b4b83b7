"""EmerNeRF: a neural field of what stands still and of what moves, told apart by itself."""

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Self

import numpy as np

from geoevs.core.files import read_json, write_json
from geoevs.core.progress import training_bar
from geoevs.core.randomness import Rng
from geoevs.core.settings import AtLeast, AtMost, Count, Positive, Within, check_fields
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.scenes.camera import Camera

if TYPE_CHECKING:
    from baselines.emernerf.model import EmerNeRF, Rendered
    from baselines.emernerf.rays import Place

# torch is imported where the field is made: configs are checked without one.

STEPS_AN_IMAGE = 17
CHUNK = 2048  # rays rendered at once, so that what is known of their samples stays in cache
SOLID = 0.5  # opacity from which a pixel has a depth
MODEL_FILE, PLACE_FILE = "field.safetensors", "place.json"


@dataclass
class Method:
    """EmerNeRF at the size of this suite's scenes; see docs/emernerf.md.

    Args:
        iterations: optimiser steps; None: STEPS_AN_IMAGE for each. A budget of seconds may end the
            fit earlier.
        rays: through pixels in each step.
        learning_rate: Adam's, at its highest.
        levels: of the static hash grid.
        log2_entries: of a level of it, as a power of two.
        width: of the networks.
        samples: along a ray, for two rounds of proposals and for the field.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "EmerNeRF",
        paradigm="reconstruction",
        needs=("lidar", "tracks"),
        citation="Yang et al.: EmerNeRF, ICLR 2024",
    )
    iterations: Count | None = None
    rays: Count = 1024
    learning_rate: Positive = 0.01
    levels: Annotated[int, AtLeast(4), AtMost(32)] = (
        8  # the other fields' grids have a half of it or less
    )
    log2_entries: Annotated[int, Within(1, 30)] = 17
    width: Count = 32
    samples: tuple[Count, Count, Count] = (32, 16, 16)
    _model: "EmerNeRF" = field(init=False)
    _place: "Place" = field(init=False)
    _images: dict[tuple[str, int], int] = field(init=False)

    def __post_init__(self) -> None:
        check_fields(f"method '{self.info.name}'", self)
        self.samples = tuple(self.samples)

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Fit the fields to all pixels and LiDAR points of the source views."""
        start = time.monotonic()
        from baselines.emernerf.fitting import Fitting, fit_model
        from baselines.emernerf.rays import TrainingRays, find_motion, find_place

        clouds = {frame: views.lidar(frame).xyz for frame in views.frames}
        points = np.concatenate(list(clouds.values()))
        notes = [] if len(points) else ["no LiDAR: no depth losses"]
        moving, reason = find_motion(views, clouds)
        notes += [reason] if reason else []
        self._place = find_place(views, points)
        self._images = {}
        for frame in views.frames:
            for name in views.cameras:
                self._images[name, frame] = len(self._images)
        rays = TrainingRays.make(views, clouds, self._place)
        self._model = self._new_model(moving, rng)
        until = start + (budget.seconds if budget.seconds is not None else float("inf"))
        iterations = self.iterations or STEPS_AN_IMAGE * len(self._images)
        fitting = Fitting(iterations, self.rays, self.learning_rate)
        with training_bar(f"EmerNeRF of {views.scene_name}", iterations) as report:
            steps = fit_model(self._model, rays, fitting, until, rng.torch, report)
        if steps < iterations:
            notes.append(f"{steps} of {iterations} iterations in the budget")
        parameters = sum(p.numel() for p in self._model.parameters())
        return FitReport(parameters=parameters, note="; ".join(notes))

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Render the fields; source images keep their appearance, other views get the mean."""
        import torch

        from baselines.emernerf.sampling import median_distance

        seen, directions = self._look(camera, frame)
        rgb = torch.cat([part.rgb for part in seen]).clamp(0, 1).cpu().numpy()
        medians = [median_distance(part.weights, part.distances) for part in seen]
        ranges = torch.cat(medians).cpu().numpy()
        solid = torch.cat([part.opacity for part in seen]).cpu().numpy() > SOLID
        along = directions @ camera.optical_axis.astype(np.float32)
        shape = camera.height, camera.width
        depth = np.where(solid, ranges * along, 0).astype(np.float32)
        return Rendering(rgb.reshape(*shape, 3), depth.reshape(shape))

    def motion(self, camera: Camera, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """The motion that emerged in a view, though nothing supervised it.

        Returns:
            (H, W) share of a pixel's light that comes from the dynamic field, and (H, W, 3) mean
            forward flow there, metres a frame; both 0 in a static scene.
        """
        import torch

        shape = camera.height, camera.width
        if self._model.dynamic is None:
            return np.zeros(shape, np.float32), np.zeros((*shape, 3), np.float32)
        shares, flows = [], []
        for part in self._look(camera, frame)[0]:
            weights = part.weights * part.motion.share
            forward = part.motion.flow.view(*weights.shape, 6)[..., :3]
            shares.append(weights.sum(1))
            mean = (weights[..., None] * forward).sum(1) / shares[-1][:, None].clamp_min(1e-6)
            flows.append(mean)
        share, flow = torch.cat(shares).cpu().numpy(), torch.cat(flows).cpu().numpy()
        return share.reshape(shape), flow.reshape(*shape, 3)

    def _look(self, camera: Camera, frame: int) -> tuple[list["Rendered"], np.ndarray]:
        """What the rays of all pixels see, chunk by chunk, and their directions (H * W, 3)."""
        import torch

        from baselines.emernerf.model import Rays
        from baselines.emernerf.rays import pixel_rays

        rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
        uv = np.column_stack([columns.ravel(), rows.ravel()])
        origins, directions = pixel_rays(camera, uv, self._place)
        image = self._images.get((camera.name, frame), -1)
        rays = Rays(
            torch.from_numpy(origins),
            torch.from_numpy(directions),
            torch.full((len(uv),), self._place.time(frame)),
            torch.full((len(uv),), image, dtype=torch.int64),
        )
        device = self._model.box.device
        chunks = zip(*(part.split(CHUNK) for part in rays), strict=True)
        with torch.inference_mode():
            seen = [self._model.render(Rays(*(p.to(device) for p in chunk))) for chunk in chunks]
        return seen, directions

    def save(self, folder: Path) -> None:
        """Write the fields' weights, the scene's place and which image is which."""
        from geoevs.core.networks import save_network

        settings = {"sizes": asdict(self._model.sizes), "moving": self._model.dynamic is not None}
        save_network(folder / MODEL_FILE, self._model, settings)
        place = {
            "centre": self._place.centre.tolist(),
            "half": self._place.half.tolist(),
            "frames": [self._place.first, self._place.last],
            "images": [[name, frame] for name, frame in self._images],
        }
        write_json(folder / PLACE_FILE, place)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Restore a fitted method from the folder that `save` filled."""
        from baselines.emernerf.rays import Place
        from geoevs.core.networks import best_device, load_weights, read_network

        place = read_json(folder / PLACE_FILE)
        settings, weights = read_network(folder / MODEL_FILE)
        method = cls(
            **{name: settings["sizes"][name] for name in ("levels", "log2_entries", "width")},
            samples=settings["sizes"]["samples"],
        )
        centre, half = np.array(place["centre"]), np.array(place["half"])
        method._place = Place(centre, half, *place["frames"])
        method._images = {(name, frame): i for i, (name, frame) in enumerate(place["images"])}
        method._model = method._new_model(settings["moving"], Rng(0))
        load_weights(method._model, weights, folder / MODEL_FILE, "fit the method again")
        method._model.to(best_device())
        return method

    def _new_model(self, moving: bool, rng: Rng) -> "EmerNeRF":
        """An unfitted model for the scene's place and images."""
        import torch

        from baselines.emernerf.model import EmerNeRF, Sizes
        from geoevs.core.networks import best_device

        sizes = Sizes(self.levels, self.log2_entries, self.width, self.samples)
        box = torch.tensor(np.array([-self._place.half, self._place.half]), dtype=torch.float32)
        step = self._place.step if moving else None
        with torch.random.fork_rng(devices=()):
            torch.manual_seed(int(rng.numpy.integers(2**62)))
            model = EmerNeRF(sizes, len(self._images), box, step, rng.torch)
        return model.to(best_device())
