"""What is drawn of a scene, from numbers known by hand."""

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import CAR, MOUNT, tiny_camera, write_tiny_scene
from geoevs.results.view.recorded import (
    MAP,
    STANDS,
    UNSEEN,
    WIDEST,
    box_lines,
    free_camera,
    lidar,
    map_lines,
    vertical_fov,
)
from geoevs.scenes.road_map import Polygon, RoadMap
from geoevs.scenes.scene import SceneExtras

TRIANGLE = np.array([[0.0, 0, 0], [4, 0, 0], [4, 3, 0]])
GROUND = RoadMap([Polygon("crossing", [TRIANGLE]), Polygon("drivable", [2 * TRIANGLE, TRIANGLE])])


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    extras = SceneExtras(road_map=GROUND)
    return write_tiny_scene(tmp_path_factory.mktemp("view") / "tiny", extras=extras)


def test_a_box_has_twelve_edges_between_its_corners(scene):
    ends, rgb = box_lines(scene, 0)
    assert ends.shape == rgb.shape == (12, 2, 3)
    assert ends.reshape(-1, 3).min(axis=0) == pytest.approx(CAR[0])
    assert ends.reshape(-1, 3).max(axis=0) == pytest.approx(CAR[1])
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert sorted(lengths) == pytest.approx(sorted([2.0] * 8 + [1.4] * 4))
    assert (rgb == STANDS).all()
    assert len(box_lines(scene, 7).ends) == 0


def test_the_road_map_is_closed_lines(scene):
    ends, rgb = map_lines(scene)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert lengths.tolist() == [4, 3, 5, 8, 6, 10, 4, 3, 5]
    assert (rgb == MAP).all()


def test_points_have_their_colours(scene):
    xyz, rgb = lidar(scene, 1)
    points = scene.points(1)
    np.testing.assert_array_equal(xyz, points.xyz)
    seen = points.camera >= 0
    np.testing.assert_allclose(rgb[seen] / 255, points.rgb[seen], atol=0.003)
    assert (rgb[~seen] == UNSEEN).all()


def test_a_camera_of_the_browser_is_that_of_the_scene():
    camera = tiny_camera("front", 0.0, MOUNT)
    # Right is -y, down -z and ahead x of the world: a third of a turn about (-1, 1, -1).
    half = np.array([0.5, -0.5, 0.5, -0.5])
    made = free_camera(half, MOUNT, vertical_fov(camera), 72 / 48, 48)
    np.testing.assert_allclose(made.world_from_camera, camera.world_from_camera, atol=1e-9)
    np.testing.assert_allclose(made.K, camera.K)
    assert (made.height, made.width) == (48, 72)


def test_a_window_that_is_a_strip_gives_a_picture_of_bounded_width():
    still = np.array([1.0, 0, 0, 0]), np.zeros(3), 1.0
    assert free_camera(*still, aspect=100.0, height=50).width == 50 * WIDEST
    assert free_camera(*still, aspect=0.001, height=48).width == 48 / WIDEST
    with pytest.raises(GeoEvsError, match="more than 10 km from the world's origin"):
        free_camera(still[0], np.array([2e4, 0, 0]), 1.0, 1.0, 50)
