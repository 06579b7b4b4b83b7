"""A new method's first files: a small adapter that already keeps the contract, and its test."""

from pathlib import Path

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_folder, write_text
from geoevs.core.plugins import new_module
from geoevs.methods.finding import check_free_name, find_methods

ADAPTER = '''"""{name}: say in one line how it makes a view."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import cv2

from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.scenes.camera import Camera, angle_between


@dataclass
class Method:
    """Copies the source image whose camera looks most nearly the same way. Replace this.

    Fields with a default are options, set in the config; what `fit` learns has `init=False`.
    """

    # Tables show this. LiDAR and boxes are refused unless declared: needs=("lidar", "tracks").
    info: ClassVar[MethodInfo] = MethodInfo("{name}", paradigm="reconstruction")
    views: Views = field(init=False)

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Learn one scene from what `views` allows."""
        # views.frames, views.cameras; views.camera(name, frame), views.image(name, frame),
        # views.lidar(frame).xyz and .rgb, views.tracks. World: metres, z up; cameras: OpenCV's.
        # Take randomness from rng.numpy or rng.torch only, so that reruns give the same pixels.
        self.views = views
        return FitReport(primitives=0, parameters=0)

    def render(self, camera: Camera, frame: int) -> Rendering:
        """What `camera` would see: (H, W, 3) uint8, or float in [0, 1]; depth if you have it."""
        # camera.K, camera.world_from_camera (4x4), camera.height, camera.width.
        nearest = min(
            (self.views.camera(name, frame) for name in self.views.cameras),
            key=lambda source: angle_between(source.optical_axis, camera.optical_axis),
        )
        image = self.views.image(nearest.name, frame)
        return Rendering(cv2.resize(image, (camera.width, camera.height)))

    def save(self, folder: Path) -> None:
        """Write all that `render` needs into `folder`, and nothing elsewhere."""
        # Options that `render` reads count too: `load` is not told them.
        self.views.save(folder / "views")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote; the same pixels must come out."""
        method = cls()
        method.views = Views.load(folder / "views")
        return method
'''

TRAINED_ADAPTER = '''"""{name}: say in one line how it makes a view."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import cv2
import numpy as np

from geoevs.core.files import read_arrays
from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.methods.trained import link_trained, read_trained, trained_seconds
from geoevs.scenes.camera import Camera, angle_between


@dataclass
class Method:
    """Copies the nearest source image and corrects its colours as it learned. Replace this.

    Args:
        weights: the folder that `train` of training.py wrote; the config's training gives it.
    """

    # Tables show this. LiDAR and boxes are refused unless declared, beside "training".
    info: ClassVar[MethodInfo] = MethodInfo("{name}", paradigm="learned", needs=("training",))
    weights: str
    views: Views = field(init=False)
    _matrix: np.ndarray = field(init=False)  # [3, 4] from r, g, b, 1 to the corrected colour

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Keep the views; the network was trained before. Import torch in here if you need it."""
        self._load_trained()
        self.views = views
        seconds = trained_seconds(Path(self.weights))
        return FitReport(parameters=self._matrix.size, training_seconds=seconds)

    def render(self, camera: Camera, frame: int) -> Rendering:
        """What `camera` would see: (H, W, 3) uint8, or float in [0, 1]; depth if you have it."""
        nearest = min(
            (self.views.camera(name, frame) for name in self.views.cameras),
            key=lambda source: angle_between(source.optical_axis, camera.optical_axis),
        )
        image = cv2.resize(self.views.image(nearest.name, frame), (camera.width, camera.height))
        return Rendering(np.clip(image @ self._matrix[:, :3].T + self._matrix[:, 3], 0, 1))

    def save(self, folder: Path) -> None:
        """Write the views; link the weights, which many scenes share."""
        self.views.save(folder / "views")
        link_trained(Path(self.weights), folder / "weights")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote; the same pixels must come out."""
        method = cls(str(folder / "weights"))
        method._load_trained()
        method.views = Views.load(folder / "views")
        return method

    def _load_trained(self) -> None:
        read_trained(Path(self.weights))  # a training that failed says why
        self._matrix = read_arrays(Path(self.weights) / "correction.npz")["matrix"]
'''

TRAINING = '''"""What {name} learns beforehand, and its settings; the network lies in network.py."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from geoevs.core.files import read_arrays, write_arrays, write_json
from geoevs.core.images import to_uint8
from geoevs.core.progress import training_bar
from geoevs.core.settings import Count, Positive
from geoevs.methods.training import Inputs
from geoevs.scenes.store import Scene


@dataclass(frozen=True)
class Settings:
    """Keys and defaults of `trainings: {{{name}: ...}}` in the config; types are checked there.

    Args:
        steps: of the optimiser.
        batch: pixels a step.
        learning_rate: AdamW's peak rate.
    """

    steps: Count = 200
    batch: Count = 512
    learning_rate: Positive = 1.0e-2


class Training:
    """Pixels of neighbouring cameras' images, one beside the other; one matrix of all."""

    Settings: ClassVar[type] = Settings
    partition: ClassVar[str] = "train"  # whose scenes it learns from
    reads: ClassVar[tuple[str, ...]] = ()  # what else: see geoevs/methods/training.py

    def prepare(self, scene: Scene, inputs: Inputs, out: Path) -> None:
        """Write what is learned from one scene, the same for all variants."""
        pairs = [
            (to_uint8(scene.image(one, frame)), to_uint8(scene.image(other, frame)))
            for frame in scene.frames
            for one, other in zip(scene.cameras, scene.cameras[1:], strict=False)
        ]
        given, wanted = (np.concatenate([p[k].reshape(-1, 3) for p in pairs]) for k in (0, 1))
        write_arrays(out, {{"given": given, "wanted": wanted}})

    def train(
        self,
        settings: Settings,
        files: Sequence[Path],
        inputs: Inputs,
        seed: int,
        work: Path,
        out: Path,
    ) -> None:
        """Learn from all prepared files; `out` is kept if this ends well."""
        # Here, not above: configs are checked where torch is not imported.
        from {package}.network import train_correction

        parts = [read_arrays(file) for file in files]
        given, wanted = (np.concatenate([part[k] for part in parts]) for k in ("given", "wanted"))
        with training_bar("{name}", settings.steps) as report:
            matrix = train_correction(settings, given, wanted, seed, work, report)
        write_arrays(out / "correction.npz", {{"matrix": matrix}})
        write_json(out / "settings.json", {{"steps": settings.steps}})
'''

NETWORK = '''"""The network of {name}, and the task that trains it."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from {package}.training import Settings
from geoevs.core.optimising import Optimisation, fingerprint, optimise
from geoevs.core.randomness import Rng


class CorrectionTask:
    """Map colours to others' by one matrix: `optimise` asks it for losses and previews."""

    def __init__(
        self,
        given: np.ndarray,  # [N, 3] uint8
        wanted: np.ndarray,  # [N, 3] uint8
        settings: Settings,
    ) -> None:
        self._given, self._wanted = (torch.from_numpy(a).float() / 255 for a in (given, wanted))
        self._batch = settings.batch
        self.model = nn.Linear(3, 3)
        nn.init.eye_(self.model.weight)
        nn.init.zeros_(self.model.bias)
        # What decides the losses: a training of other settings or data starts over.
        self.identity = fingerprint(asdict(settings), given, wanted)

    def losses(self, rng: Rng) -> dict[str, Tensor]:
        """The mean squared error of one random batch."""
        picked = rng.numpy.integers(len(self._given), size=self._batch)
        error = self.model(self._given[picked]) - self._wanted[picked]
        return {{"loss": error.square().mean()}}

    def batch(self, rng: Rng) -> list[str]:
        """The names of the samples that `losses` takes, for the error of a NaN."""
        return list(map(str, rng.numpy.integers(len(self._given), size=self._batch)))[:8]

    @torch.inference_mode()
    def preview(self, model: nn.Module) -> np.ndarray:
        """(H, W, 3) picture of what the model does so far: given, corrected, wanted colours."""
        columns = self._given[:64], model(self._given[:64]).clamp(0, 1), self._wanted[:64]
        return torch.stack(columns, dim=1).numpy().repeat(8, axis=1)


def train_correction(
    settings: Settings,
    given: np.ndarray,  # [N, 3] uint8
    wanted: np.ndarray,  # [N, 3] uint8
    seed: int,
    work: Path,
    report: Callable[[float], None],
) -> np.ndarray:
    """(3, 4) float32: what corrects colours; it goes on after a kill, and stops at a NaN."""
    task = CorrectionTask(given, wanted, settings)
    optimisation = Optimisation(settings.steps, settings.learning_rate)
    model = optimise(task, optimisation, seed, "{name}", work, report)
    return torch.cat([model.weight, model.bias[:, None]], dim=1).detach().numpy()
'''

TEST = '''"""{name} keeps the adapter contract."""

from geoevs.methods.check import contract_failures


def test_contract():
    assert contract_failures("{name}") == []
'''

TRAINED_TEST = '''"""{name} and its training keep the contract."""

from geoevs.conditions.trial import check_method


def test_contract():
    checks = check_method("{name}", {{}}, {{}})
    assert [f"{{c.name}}: {{c.sentence}}" for c in checks if c.status == "failed"] == []
'''


def new_adapter(name: str, root: Path, training: bool = False) -> list[Path]:
    """Write a working adapter called `name`, and its test, into the repository at `root`.

    Args:
        name: such as `my-method`.
        root: holds `baselines` and `tests`.
        training: whether it is one that learns before it is fitted.

    Returns:
        The files that were written, the adapter first.

    Raises:
        GeoEvsError: the name is illegal or taken, or nothing can be written.
    """
    module = new_module(name, "method")
    check_free_name(name)
    folder = root / "baselines" / module
    test = root / "tests" / "baselines" / f"test_{module}.py"
    name = module.replace("_", "-")
    taken = [path for path in (folder, test) if path.exists()]
    if taken or name in find_methods():
        where = taken[0] if taken else f"method '{name}'"
        raise GeoEvsError(f"{where} exists already; choose another name")
    texts = {"adapter.py": ADAPTER}
    if training:
        texts = {"adapter.py": TRAINED_ADAPTER, "training.py": TRAINING, "network.py": NETWORK}
    words = {"name": name, "package": f"baselines.{module}"}
    write_text(test, (TRAINED_TEST if training else TEST).format(**words))
    with new_folder(folder) as partial:
        write_text(partial / "__init__.py", f'"""The method {name}."""\n')
        for file, text in texts.items():
            write_text(partial / file, text.format(**words))
    return [*(folder / file for file in texts), folder / "__init__.py", test]
