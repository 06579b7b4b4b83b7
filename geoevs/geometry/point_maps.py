"""Point maps of a scene's recorded views, one file a scene (the paper's M, section 3.2).

Poses and intrinsics are known, so the depth along the optical axis is all that a point map adds to
them: `unproject_depth` makes the points.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geoevs.core.files import whole_file, write_arrays
from geoevs.methods.contract import Views
from geoevs.scenes.store import Scene

if TYPE_CHECKING:
    from geoevs.geometry.depth_models import DepthModel


def write_point_maps(
    path: Path, scene: Scene, model: "DepthModel", advance: Callable[[], None]
) -> None:
    """Write the depth of every frame and camera of a scene, whole or not at all.

    The model sees what a method sees: all recorded views, and the LiDAR that may condition one.

    Args:
        path: the .npz to write.
        scene: the store.
        model: gives the depth of a frame's source views.
        advance: called after each frame.
    """
    views = Views(scene, scene.cameras, needs=("lidar",))
    depths = {}
    for frame in views.frames:
        maps = model.depths(views, frame)
        depths |= {_key(name, frame): maps[name] for name in views.cameras}
        advance()
    write_arrays(path, depths)


class PointMaps:
    """The depth maps in a file of `write_point_maps`, read one view at a time.

    Raises:
        GeoEvsError: the file is missing or not whole.
    """

    def __init__(self, path: Path) -> None:
        self._path = Path(path)
        with whole_file(path):
            self._file = np.load(path, allow_pickle=False)

    def depth(self, camera: str, frame: int) -> np.ndarray:
        """(H, W) float32 metres along the optical axis, 0 = none."""
        with whole_file(self._path):
            return self._file[_key(camera, frame)]


def _key(camera: str, frame: int) -> str:
    return f"{frame:06d}/{camera}"
