"""Lifted views come back where they came from."""

import numpy as np
import pytest

from geoevs.geometry.lift import LIFT_SCALE, lidar_depths, lift_frame, lift_view
from geoevs.methods.contract import Views
from geoevs.methods.tiny import MOUNT, tiny_camera, tiny_truth, write_tiny_scene
from geoevs.projection import rasterize_points
from geoevs.scenes.camera import Camera

CAMERA = tiny_camera("front", 0.0, MOUNT)


def zoomed(camera, factor):
    """The same view with another focal length."""
    K = camera.K * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    return Camera(K, camera.world_from_camera, camera.height, camera.width, camera.name)


def test_a_view_returns_to_its_own_pose():
    rgb, depth = tiny_truth(CAMERA)
    xyz, colours = lift_view(rgb / np.float32(255), depth, CAMERA, CAMERA)
    assert xyz.dtype == colours.dtype == np.float32
    assert len(xyz) == LIFT_SCALE**2 * depth.size
    raster = rasterize_points(xyz, colours, CAMERA)
    assert raster.mask.mean() > 0.99
    # Each pixel shows one of its points, at most a quarter of a pixel from its centre.
    assert np.abs(raster.image - rgb / 255.0).mean() < 0.01
    np.testing.assert_allclose(raster.depth[raster.mask], depth[raster.mask], rtol=1e-5)


def test_points_lie_on_the_surface_of_their_pixel():
    rgb, _ = tiny_truth(CAMERA)
    depth = np.full(rgb.shape[:2], 3.0, np.float32)
    xyz, _ = lift_view(rgb / np.float32(255), depth, CAMERA, CAMERA)
    np.testing.assert_allclose(xyz[:, 0], MOUNT[0] + 3.0, rtol=1e-6)  # it looks along +x


def test_pixels_without_depth_give_no_points():
    rgb, depth = tiny_truth(CAMERA)
    depth[:10] = 0
    xyz, _ = lift_view(rgb / np.float32(255), depth, CAMERA, CAMERA)
    assert len(xyz) == LIFT_SCALE**2 * np.count_nonzero(depth)


@pytest.mark.parametrize(("factor", "scale"), [(0.25, 1), (1.0, 2), (2.1, 4)])
def test_points_are_as_fine_as_the_target_needs(factor, scale):
    rgb, depth = tiny_truth(CAMERA)
    target = zoomed(CAMERA, factor)
    xyz, colours = lift_view(rgb / np.float32(255), depth, CAMERA, target)
    assert len(xyz) == scale**2 * depth.size
    if factor >= 1:
        assert rasterize_points(xyz, colours, target).mask.mean() > 0.99


def test_a_frame_holds_all_its_views(tmp_path):
    scene = write_tiny_scene(tmp_path / "tiny")
    views = Views(scene, scene.cameras, ("lidar",))
    depths = lidar_depths(views, 0)
    assert list(depths) == list(views.cameras)
    xyz, rgb = lift_frame(views, 0, depths, CAMERA)
    parts = [
        lift_view(views.image(n, 0), depths[n], views.camera(n, 0), CAMERA) for n in views.cameras
    ]
    np.testing.assert_array_equal(xyz, np.concatenate([part[0] for part in parts]))
    np.testing.assert_array_equal(rgb, np.concatenate([part[1] for part in parts]))
    for name in views.cameras:
        truth = tiny_truth(views.camera(name, 0)).depth
        assert np.median(np.abs(depths[name] / truth - 1)) < 0.005
