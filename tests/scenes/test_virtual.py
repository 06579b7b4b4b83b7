import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import tiny_camera
from geoevs.scenes.camera import Camera
from geoevs.scenes.virtual import virtual_camera


def test_half_way_by_hand():
    front = tiny_camera("front", 0.0, np.array([0.0, 0.0, 2.0]))
    left = tiny_camera("left", 45.0, np.array([0.0, 1.0, 2.0]))
    camera = virtual_camera(front, left, 22.5, -1.0, "target")
    # Half-way yaw and position, then 1 m to the right of a car that heads along +x.
    np.testing.assert_allclose(camera.centre, [0.0, -0.5, 2.0], atol=1e-12)
    axis = [np.cos(np.pi / 8), np.sin(np.pi / 8), 0.0]
    np.testing.assert_allclose(camera.optical_axis, axis, atol=1e-12)
    np.testing.assert_allclose(camera.world_from_camera[:3, 1], [0, 0, -1], atol=1e-12)


def test_the_shift_is_sideways_of_the_heading_wherever_it_points():
    front = tiny_camera("front", 90.0, np.zeros(3))
    right = tiny_camera("right", 45.0, np.zeros(3))
    camera = virtual_camera(front, right, 22.5, 1.0, "target")
    np.testing.assert_allclose(camera.centre, [-1.0, 0.0, 0.0], atol=1e-12)
    assert camera.yaw == pytest.approx(67.5)


def test_yaw_gaps_wrap_at_180_degrees():
    front = tiny_camera("front", 170.0, np.zeros(3))
    left = tiny_camera("left", -145.0, np.zeros(3))
    assert virtual_camera(front, left, 22.5, 0.0, "target").yaw == pytest.approx(-167.5)


def test_pitch_and_roll_are_the_front_cameras():
    front = tiny_camera("front", 0.0, np.zeros(3))
    pitch, cosine, sine = front.world_from_camera.copy(), np.cos(0.1), np.sin(0.1)
    pitch[:3, :3] @= np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    tilted = Camera(front.K, pitch, front.height, front.width, "front")
    camera = virtual_camera(tilted, tiny_camera("left", 45.0, np.zeros(3)), 22.5, 0.0, "target")
    assert camera.optical_axis[2] == pytest.approx(tilted.optical_axis[2])
    assert camera.yaw == pytest.approx(22.5)


def test_a_target_beyond_the_side_camera_is_refused():
    front, left = (tiny_camera("c", yaw, np.zeros(3)) for yaw in (0.0, 20.0))
    with pytest.raises(GeoEvsError, match=r"turns 25 degrees but .*pose_sweep.angles"):
        virtual_camera(front, left, 25, 0.0, "target")


def test_side_cameras_that_look_ahead_are_refused():
    front, left = (tiny_camera(name, 30.0, np.zeros(3)) for name in ("front", "left"))
    with pytest.raises(GeoEvsError, match=r"'front' and 'left' look the same way"):
        virtual_camera(front, left, 0.0, 1.0, "target")
