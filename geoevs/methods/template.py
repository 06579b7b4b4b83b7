"""A new method's first files: a small adapter that already keeps the contract, and its test."""

import keyword
import re
from pathlib import Path

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_folder, write_text
from geoevs.methods.finding import find_methods

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

TEST = '''"""{name} keeps the adapter contract."""

from geoevs.methods.check import contract_failures


def test_contract():
    assert contract_failures("{name}") == []
'''


def new_adapter(name: str, root: Path) -> list[Path]:
    """Write a working adapter called `name`, and its test, into the repository at `root`.

    Returns:
        The files that were written.

    Raises:
        GeoEvsError: the name is illegal or taken, or nothing can be written.
    """
    module = name.replace("-", "_")
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+|_[a-z0-9]+)*", name):
        raise GeoEvsError(
            f"'{name}' cannot name a method; use lower-case letters, digits and single hyphens, "
            "such as my-method"
        )
    if keyword.iskeyword(module) or keyword.issoftkeyword(module):
        raise GeoEvsError(f"'{name}' is a word of Python's own; choose another name")
    folder = root / "baselines" / module
    test = root / "tests" / "baselines" / f"test_{module}.py"
    name = module.replace("_", "-")
    taken = [path for path in (folder, test) if path.exists()]
    if taken or name in find_methods():
        where = taken[0] if taken else f"method '{name}'"
        raise GeoEvsError(f"{where} exists already; choose another name")
    write_text(test, TEST.format(name=name))
    with new_folder(folder) as partial:
        write_text(partial / "__init__.py", f'"""The method {name}."""\n')
        write_text(partial / "adapter.py", ADAPTER.format(name=name))
    return [folder / "adapter.py", folder / "__init__.py", test]
