"""Point maps of a scene's recorded views, one file a scene (the paper's M, section 3.2).

Poses and intrinsics are known, so the depth along the optical axis is all that a point map adds to
them: `unproject_depth` makes the points.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geoevs.core.files import open_arrays, whole_file, write_arrays
from geoevs.methods.contract import Views
from geoevs.scenes.checks import check_depth
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

    Raises:
        GeoEvsError: the model gives what is no depth, as one with broken weights does.
    """
    views = Views(scene, scene.cameras, needs=("lidar",))
    depths = {}
    for frame in views.frames:
        maps = model.depths(views, frame)
        for name in views.cameras:
            who = f"the depth model's map of camera '{name}' in frame {frame}"
            check_depth(maps[name], f"{who} of scene '{views.scene_name}'")
            depths[_key(name, frame)] = maps[name]
        advance()
    write_arrays(path, depths)


class PointMaps:
    """The depth maps in a file of `write_point_maps`, read one view at a time.

    Raises:
        GeoEvsError: the file is missing or not whole.
    """

    def __init__(self, path: Path) -> None:
        self._path = Path(path)
        self._file = open_arrays(path)

    def depth(self, camera: str, frame: int) -> np.ndarray:
        """(H, W) float32 metres along the optical axis, 0 = none.

        Raises:
            GeoEvsError: the file has no such view, or what it has is no depth map.
        """
        with whole_file(self._path):
            depth = self._file[_key(camera, frame)]
        check_depth(depth, f"{self._path}: the depth of camera '{camera}' in frame {frame}")
        return depth


def _key(camera: str, frame: int) -> str:
    return f"{frame:06d}/{camera}"
