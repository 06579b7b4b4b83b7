import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.sources.waymo.lidar import (
    beam_inclinations,
    joined,
    no_points,
    sweep_points,
    unproject,
)
from geoevs.scenes.sources.waymo.segment import LaserCalibration, RangeImages

EVEN = LaserCalibration(np.zeros(0), -1.0, 1.0, np.eye(4), "calibration")
LISTED = LaserCalibration(np.array([-np.pi / 2, 0, np.pi / 2]), 0.0, 0.0, np.eye(4), "calibration")
IMAGE = np.arange(-12, 12, dtype=np.float32).reshape(3, 2, 4)


def poses(*, roll=0.0, pitch=0.0, yaw=0.0, place=(0, 0, 0)) -> np.ndarray:
    return np.tile(np.array([roll, pitch, yaw, *place]), (3, 2, 1))


def test_waymos_own_golden_values():
    """v2/perception/utils/lidar_utils_test.py; its float32 poses are here exact."""
    pose = poses(roll=np.pi / 2, pitch=np.pi / 2, yaw=np.pi / 2, place=(1, 2, 3))
    xyz, rows = unproject(IMAGE, pose, LISTED, np.eye(4), "x")

    # By hand: ranges 4 and 8 lie in the last row, which looks down; R = [[0,0,1],[0,1,0],[-1,0,0]]
    np.testing.assert_allclose(xyz, [[-3, 2, 3], [-7, 2, 3]], atol=1e-15)
    assert rows.tolist() == [2, 2]


def test_even_beams_lie_in_the_middles_of_their_shares_top_first():
    assert beam_inclinations(EVEN, 4, "x").tolist() == [0.75, 0.25, -0.25, -0.75]


def test_columns_turn_to_the_right_from_behind():
    image = np.zeros((1, 4, 4), np.float32)
    image[..., 0] = 2.0
    level = EVEN._replace(low=0.0, high=0.0)
    xyz, _ = unproject(image, None, level, np.eye(4), "x")

    # Azimuths 135, 45, -45 and -135 degrees: x forward, y left.
    root = np.sqrt(2)
    expected = [[-root, root, 0], [root, root, 0], [root, -root, 0], [-root, -root, 0]]
    np.testing.assert_allclose(xyz, expected, atol=1e-15)


def test_the_extrinsics_yaw_cancels_in_the_vehicle():
    image = np.zeros((1, 4, 4), np.float32)
    image[..., 0] = 2.0
    level = EVEN._replace(low=0.0, high=0.0)
    straight, _ = unproject(image, None, level, np.eye(4), "x")
    cos, sin = np.cos(2.5), np.sin(2.5)
    turned = np.array([[cos, -sin, 0, 1], [sin, cos, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1.0]])
    xyz, _ = unproject(image, None, level._replace(extrinsic=turned), np.eye(4), "x")

    np.testing.assert_allclose(xyz - [1, 2, 3], straight, atol=1e-14)


def test_a_frames_pose_serves_where_pixels_have_none():
    pose = np.eye(4)
    pose[:3, 3] = [100, 200, 300]
    without, _ = unproject(IMAGE, None, LISTED, pose, "x")
    same, _ = unproject(IMAGE, poses(place=(100, 200, 300)), LISTED, np.eye(4), "x")
    replaced, _ = unproject(IMAGE, poses(), LISTED, pose, "x")

    np.testing.assert_allclose(without, same, atol=1e-13)
    np.testing.assert_allclose(replaced, same - [100, 200, 300], atol=1e-13)


def test_far_from_the_worlds_origin_no_millimetre_is_lost():
    place = (-25211.0, 42391.0, -161.0)  # whole metres, which float32 holds
    sweep = RangeImages(IMAGE, None, poses(place=place).astype(np.float32), "x")
    cloud = sweep_points("top", sweep, LISTED, np.eye(4), place, False)

    np.testing.assert_allclose(cloud.xyz, [[0, 0, -4], [0, 0, -8]], atol=2e-6)
    assert cloud.xyz.dtype == np.float32


def test_second_returns_follow_by_option():
    second = IMAGE + np.float32(1)
    sweep = RangeImages(IMAGE, second, poses(), "x")
    first = sweep_points("rear", sweep, LISTED, np.eye(4), (0, 0, 0), False)
    both = sweep_points("rear", sweep, LISTED, np.eye(4), (0, 0, 0), True)

    np.testing.assert_allclose(first.xyz[:, 2], [-4, -8], atol=1e-6)
    # A range of 0 + 1 more lies in the middle row.
    np.testing.assert_allclose(both.xyz[:, 2], [-4, -8, 0, -5, -9], atol=1e-6)
    assert both.beam.tolist() == [2, 2, 1, 2, 2]
    assert set(both.sensor.tolist()) == {4}


def test_lidars_without_points_are_an_empty_cloud():
    empty = sweep_points(
        "front", RangeImages(None, None, None, "x"), EVEN, np.eye(4), (0, 0, 0), True
    )
    assert len(empty) == len(no_points()) == len(joined([])) == len(joined([empty, empty])) == 0
    nothing = RangeImages(-np.ones((3, 2, 4), np.float32), None, None, "x")
    assert len(sweep_points("front", nothing, LISTED, np.eye(4), (0, 0, 0), False)) == 0


@pytest.mark.parametrize(
    ("sweep", "laser", "what"),
    [
        ((IMAGE[:2], None, None), LISTED, "2 rows, but its LiDAR 3 beams"),
        ((IMAGE, None, poses()[:, :1]), LISTED, "3 x 2 pixels but its poses 3 x 1"),
        ((IMAGE, None, poses(place=(1e7, 0, 0))), LISTED, "2 of 2 points of LiDAR 'top'"),
        ((IMAGE, None, poses(yaw=np.nan)), LISTED, "2 of 2 points"),
        ((IMAGE, None, poses(yaw=np.inf)), LISTED, "2 of 2 points"),
        ((np.full((3, 2, 4), np.inf, np.float32), None, None), LISTED, "6 of 6 points"),
        ((IMAGE, None, None), LISTED._replace(inclinations=np.full(3, np.nan)), "beams are NaN"),
        ((IMAGE, None, None), EVEN._replace(high=np.inf), "beams are NaN"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_sweeps_that_cannot_be_are_named(sweep, laser, what):
    with pytest.raises(GeoEvsError) as caught:
        sweep_points(
            "top", RangeImages(*sweep, "file: record 7"), laser, np.eye(4), (0, 0, 0), False
        )
    assert what in str(caught.value)
    assert str(caught.value).startswith(("file: record 7: ", "calibration: "))
