"""Somebody else's images: scores a folder of PNGs, whatever made them."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json
from geoevs.core.images import read_image
from geoevs.core.names import check_name, expanded
from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.scenes.camera import Camera, view_key


@dataclass
class Method:
    """Images made elsewhere: `<folder>/<scene>/<camera>/<frame>.png`, as
    `mine/101/front/000003.png`.

    Args:
        folder: the images; `camera` is the target's name, the frame has six digits.
    """

    info: ClassVar[MethodInfo] = MethodInfo("External images", paradigm="external")
    folder: str
    scene: str = field(init=False)

    def files(self, scene: str) -> Iterable[Path]:
        """The folder of a scene's images."""
        return [expanded(self.folder) / scene]

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Learn the scene's name, which is its folder's.

        Raises:
            GeoEvsError: there is no such folder.
        """
        images = expanded(self.folder) / views.scene_name
        if not images.is_dir():
            raise GeoEvsError(
                f"{images} is missing; put the images of scene '{views.scene_name}' there as "
                "<camera>/<frame>.png"
            )
        self.scene = views.scene_name
        return FitReport(note=f"images from {self.folder}")

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Read the image of that target.

        Raises:
            GeoEvsError: it is missing, no image, or of another size; or the target's name could
                lead out of the folder.
        """
        check_name(camera.name, "target", "the views to render")
        folder = expanded(self.folder) / self.scene
        path = folder / f"{view_key(camera.name, frame)}.png"
        image = read_image(path)
        if image.shape[:2] != (camera.height, camera.width):
            raise GeoEvsError(
                f"{path} is {image.shape[0]} x {image.shape[1]} but its target is "
                f"{camera.height} x {camera.width}; render it at that size"
            )
        return Rendering(image)

    def save(self, folder: Path) -> None:
        """Write where the images lie; they are not copied."""
        place = {"folder": str(expanded(self.folder).resolve()), "scene": self.scene}
        write_json(folder / "external.json", place)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Restore the method from the folder that `save` filled; the images stay where they lie.

        Raises:
            GeoEvsError: what `save` wrote is missing or was changed.
        """
        path = folder / "external.json"
        place = read_json(path)
        texts = isinstance(place, dict) and isinstance(place.get("folder"), str)
        if not texts or "\0" in place["folder"]:
            raise GeoEvsError(f"{path} names no folder of images; fit the method again")
        method = cls(place["folder"])
        method.scene = check_name(place.get("scene"), "scene", path)
        return method
