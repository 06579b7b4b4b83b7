import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_arrays
from geoevs.geometry.lift import lidar_depths
from geoevs.geometry.point_maps import PointMaps, write_point_maps
from geoevs.methods.tiny import write_tiny_scene


class Numbered:
    """Depth that tells views apart: the frame, then the camera's place in the alphabet."""

    def depths(self, views, frame):
        return {
            name: np.full((48, 72), 10 * frame + place, np.float32)
            for place, name in enumerate(sorted(views.cameras))
        }


class Lidar:
    depths = staticmethod(lidar_depths)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("tiny") / "scene")


def test_depth_is_found_by_camera_and_frame(scene, tmp_path):
    steps = []
    write_point_maps(tmp_path / "maps.npz", scene, Numbered(), lambda: steps.append(1))
    maps = PointMaps(tmp_path / "maps.npz")
    assert len(steps) == 2
    for camera, frame, value in (("front", 0, 0), ("left", 1, 11), ("right", 1, 12)):
        depth = maps.depth(camera, frame)
        assert depth.dtype == np.float32
        assert (depth == value).all()


def test_a_model_may_read_the_lidar_that_conditions_methods(scene, tmp_path):
    write_point_maps(tmp_path / "maps.npz", scene, Lidar(), lambda: None)
    assert PointMaps(tmp_path / "maps.npz").depth("front", 0).min() > 0


def test_what_is_not_there_is_named(scene, tmp_path):
    with pytest.raises(GeoEvsError, match=r"none.npz is missing; make or copy it there"):
        PointMaps(tmp_path / "none.npz")
    write_point_maps(tmp_path / "maps.npz", scene, Numbered(), lambda: None)
    with pytest.raises(GeoEvsError, match=r"maps.npz is not whole .*000007/front"):
        PointMaps(tmp_path / "maps.npz").depth("front", 7)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_what_is_no_depth_is_neither_written_nor_read(scene, tmp_path, value):
    class Broken:
        def depths(self, views, frame):
            return dict.fromkeys(views.cameras, np.full((48, 72), value, np.float32))

    path = tmp_path / "maps.npz"
    with pytest.raises(GeoEvsError, match="map of camera 'front' in frame 0 of scene 'tiny' is no"):
        write_point_maps(path, scene, Broken(), lambda: None)
    assert not path.exists()
    write_arrays(path, {"000000/front": np.full((48, 72), value, np.float32)})
    with pytest.raises(GeoEvsError, match=r"maps.npz: the depth of camera 'front' in frame 0 is"):
        PointMaps(path).depth("front", 0)
