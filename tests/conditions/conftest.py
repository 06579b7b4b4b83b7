"""The tiny scene with exact depth as its point maps."""

from dataclasses import dataclass

import pytest

from geoevs.geometry.point_maps import PointMaps, write_point_maps
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.scenes.store import Scene


class TrueDepth:
    """A depth model that knows the tiny scene."""

    def depths(self, views, frame):
        # Backwards: files go by name, whatever the order.
        return {name: tiny_truth(views.camera(name, frame)).depth for name in views.cameras[::-1]}


@dataclass(frozen=True)
class Stage:
    scene: Scene
    maps: PointMaps


@pytest.fixture(scope="session")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("conditions")
    scene = write_tiny_scene(folder / "scene")
    write_point_maps(folder / "maps.npz", scene, TrueDepth(), lambda: None)
    return Stage(scene, PointMaps(folder / "maps.npz"))
