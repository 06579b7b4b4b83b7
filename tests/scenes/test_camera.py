import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import tiny_camera
from geoevs.projection import project_points
from geoevs.scenes.camera import Camera, angle_between

K = np.array([[100.0, 0, 50], [0, 120, 40], [0, 0, 1]])


def camera(K=K, pose=None, height=80, width=100):
    return Camera(K, np.eye(4) if pose is None else pose, height, width, "front")


def changed(matrix, *place, to):
    matrix = np.array(matrix, np.float64)
    matrix[place] = to
    return matrix


BROKEN = {
    "NaN in K": ({"K": changed(K, 0, 2, to=np.nan)}, "NaN or infinite"),
    "infinite pose": ({"pose": changed(np.eye(4), 0, 3, to=np.inf)}, "NaN or infinite"),
    "zero focal length": ({"K": changed(K, 0, 0, to=0)}, "focal length that is not positive"),
    "negative focal length": ({"K": changed(K, 1, 1, to=-120)}, "focal length"),
    "skew": ({"K": changed(K, 0, 1, to=0.1)}, "skew or an odd last row; undistort"),
    "odd last row": ({"K": 2 * K}, "skew or an odd last row"),
    "mirrored": ({"pose": np.diag([-1.0, 1, 1, 1])}, "not rigid; .* scale or mirroring"),
    "scaled": ({"pose": np.diag([1.01, 1.01, 1.01, 1])}, "not rigid"),
    "sheared": ({"pose": changed(np.eye(4), 0, 1, to=0.1)}, "not rigid"),
    "projective": ({"pose": changed(np.eye(4), 3, 0, to=0.1)}, "not rigid"),
    "3x4 pose": ({"pose": np.eye(4)[:3]}, "3x3 K and a 4x4 pose"),
    "no rows": ({"height": 0}, r"no pixels \(0 x 100\); set its size"),
    "no columns": ({"width": -1}, "no pixels"),
    "half a row": ({"height": 80.5}, "size that is no whole number"),
    "true columns": ({"width": True}, "size that is no whole number"),
    "huge": ({"width": 10**7}, "side of 10000000 pixels; resize"),
    "beyond integers": ({"height": 2**70}, "side of 1180591620717411.* pixels"),
    "principal point left": ({"K": changed(K, 0, 2, to=-300)}, r"point at \(-300, 40\), outside"),
    "principal point below": ({"K": changed(K, 1, 2, to=80.1)}, "outside its image of 80 x 100"),
    "endless focal length": ({"K": changed(K, 0, 0, to=1e300)}, r"focal lengths 1e\+300 and 120"),
    "hemispheric": ({"K": changed(K, 1, 1, to=0.5)}, "focal lengths 100 and 0.5"),
    "far away": ({"pose": changed(np.eye(4), 1, 3, to=4649776)}, "10 km .* subtract an origin"),
    "overflowing": ({"pose": np.diag([1e300, 1, 1, 1])}, "not rigid"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_an_impossible_camera_is_refused_by_name(kind):
    arguments, sentence = BROKEN[kind]
    with pytest.raises(GeoEvsError, match=f"^camera 'front' .*{sentence}"):
        camera(**arguments)


def test_a_pose_with_the_rounding_of_float32_passes():
    pose = tiny_camera("c", 33.0, np.array([500.0, -200.0, 3.0])).world_from_camera
    assert camera(pose=pose.astype(np.float32)).world_from_camera.dtype == np.float64


@pytest.mark.parametrize("place", [0, 50, 100])
def test_a_principal_point_may_lie_anywhere_in_the_image(place):
    made = camera(changed(K, 0, 2, to=place))
    for side in (1, 7, 1001):  # rounded, it stays inside
        assert made.resized(side, side).width == side


def test_the_arguments_are_copied():
    mine, pose = K.copy(), np.eye(4)
    made = Camera(mine, pose, 80, 100)
    mine[0, 0] = pose[0, 3] = 7
    assert made.K[0, 0] == 100
    assert made.centre[0] == 0


@pytest.mark.parametrize(("yaw", "axis"), [(0, [1, 0]), (90, [0, 1]), (-90, [0, -1])])
def test_yaw_is_counter_clockwise_from_world_x(yaw, axis):
    turned = tiny_camera("c", yaw, np.zeros(3))
    np.testing.assert_allclose(turned.optical_axis, [*axis, 0], atol=1e-15)
    assert turned.yaw == pytest.approx(yaw)


def test_turning_left_moves_the_scene_right():
    ahead = np.array([[10.0, 0.0, 0.0]])
    (u, _), *_ = project_points(ahead, tiny_camera("c", 10.0, np.zeros(3)))[0]
    # The principal point of the tiny camera is 36, its focal length 70.
    assert u == pytest.approx(36 + 70 * math.tan(math.radians(10)))


def test_the_inverse_pose_by_hand():
    # It looks along world x from (1, 2, 3): world y is its left, world z its up.
    inverse = tiny_camera("c", 0.0, np.array([1.0, 2.0, 3.0])).camera_from_world
    np.testing.assert_allclose(inverse @ [11.0, 7.0, 3.5, 1.0], [-5, -0.5, 10, 1], atol=1e-12)


def test_resizing_by_hand():
    fine = camera().resized(160, 50)
    assert (fine.height, fine.width, fine.name) == (160, 50, "front")
    np.testing.assert_array_equal(fine.K, [[50, 0, 25], [0, 240, 80], [0, 0, 1]])


@given(height=st.integers(1, 2000), width=st.integers(1, 2000))
def test_resizing_keeps_the_field_of_view(height, width):
    resized = camera().resized(height, width)
    # Edges of the image in ray slopes: (0 - 50) / 100, (100 - 50) / 100; -40 / 120, 40 / 120.
    left, right = -resized.K[0, 2] / resized.K[0, 0], (width - resized.K[0, 2]) / resized.K[0, 0]
    top, bottom = -resized.K[1, 2] / resized.K[1, 1], (height - resized.K[1, 2]) / resized.K[1, 1]
    np.testing.assert_allclose([left, right, top, bottom], [-0.5, 0.5, -1 / 3, 1 / 3], rtol=1e-12)


@pytest.mark.parametrize("degrees", [0.0, 1e-7, 22.5, 90.0, 180.0 - 1e-7, 180.0])
def test_angles_are_exact_near_the_ends(degrees):
    axis = [math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0]
    assert angle_between(np.array([1.0, 0, 0]), np.array(axis)) == pytest.approx(degrees, abs=1e-13)
