import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.sources.waymo.camera import (
    Lens,
    line_time,
    pinhole,
    read_exposure,
    vehicle_pose,
)
from geoevs.scenes.sources.waymo.segment import CameraCalibration, CameraImage

CALIBRATION = CameraCalibration(  # wdl_limited/camera/camera_model_test.cc: numbers alone
    intrinsic=np.array(
        [
            *(2055.55614936, 2055.55614936, 939.657469886, 641.072182194),
            *(0.032316008498, -0.321412482553, 0.000793258395371, -0.000625749354133, 0.0),
        ]
    ),
    extrinsic=np.array(
        [
            [0.999892684989, -0.00599320840002, 0.0133678704017, 1.53891424471],
            [0.00604223652133, 0.999975156055, -0.0036302411765, -0.0236339408393],
            [-0.0133457814992, 0.00371062343188, 0.999904056092, 2.11527057298],
            [0, 0, 0, 1],
        ]
    ),
    width=1920,
    height=1280,
    readout=2,
    where="calibration",
)
IMAGE = CameraImage(
    jpeg=b"",
    pose=np.array(
        [
            [-0.913574384152, -0.406212760482, -0.0193141875914, -4069.03497872],
            [0.406637479491, -0.913082565675, -0.0304333457449, 11526.3118079],
            [-0.00527303457417, -0.0356569976572, 0.999350175676, 86.504],
            [0, 0, 0, 1],
        ]
    ),
    linear=np.array([-3.3991382122, 1.50920391083, -0.0169006548822]),
    angular=np.array([0.00158374733292, 0.00212493073195, -0.0270753838122]),
    pose_time=1553640277.26,
    shutter=0.000424383993959,
    trigger=1553640277.23,
    done=1553640277.28,
    where="file: record 7",
)


def undistorted(intrinsic: np.ndarray, pixel) -> np.ndarray:
    """(2,) the direction of a pixel: OpenCV's model, turned round by a fixed-point iteration."""
    f, c = intrinsic[:2], intrinsic[2:4]
    k1, k2, p1, p2, k3 = intrinsic[4:]
    seen = place = (np.array(pixel) - c) / f
    for _ in range(100):
        x, y = place
        r = x * x + y * y
        bent = [2 * p1 * x * y + p2 * (r + 2 * x * x), 2 * p2 * x * y + p1 * (r + 2 * y * y)]
        place = (seen - bent) / (1 + k1 * r + k2 * r**2 + k3 * r**3)
    return place


def world_of_pixel(calibration: CameraCalibration, pixel, depth: float) -> np.ndarray:
    """(3,) the point of a pixel at a depth along the optical axis, at its own line's instant."""
    x, y = undistorted(calibration.intrinsic, pixel)
    pose = vehicle_pose(IMAGE, line_time(calibration, IMAGE, *pixel)) @ calibration.extrinsic
    return pose[:3, :3] @ (depth * np.array([1, -x, -y])) + pose[:3, 3]


@pytest.mark.parametrize(
    ("readout", "expected"),
    [
        (5, (-4091.97180, 11527.48092, 84.46586)),  # a global shutter
        (2, (-4091.88016, 11527.42299, 84.46667)),  # left to right
    ],
)
def test_waymos_own_golden_values(readout, expected):
    """Its C++ test; the Python one passes times as float32 and so expects the global value."""
    calibration = CALIBRATION._replace(readout=readout)
    np.testing.assert_allclose(world_of_pixel(calibration, (100, 1000), 20), expected, atol=5e-4)


def test_a_line_is_exposed_around_its_middle():
    image = IMAGE._replace(trigger=10.0, shutter=0.2, done=11.2, pose_time=10.5)

    # Read from 10.2 to 11.2, each line exposed for 0.2 s before.
    for readout, place, expected in (
        (2, (0, 0), 10.1),
        (2, (1920, 0), 11.1),
        (2, (480, 640), 10.35),
        (4, (480, 640), 10.85),
        (1, (480, 320), 10.35),
        (3, (480, 320), 10.85),
        (5, (480, 320), 10.5),
    ):
        time = line_time(CALIBRATION._replace(readout=readout), image, *place)
        assert time == pytest.approx(expected, abs=1e-12), readout
    exposure = read_exposure(CALIBRATION, image)
    assert (exposure.start, exposure.end) == pytest.approx((10.1, 11.1))
    assert exposure.time == pytest.approx(10.1 + 939.657469886 / 1920)


def test_the_vehicle_turns_about_its_own_axes():
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # z of the vehicle is -y of the world
    image = IMAGE._replace(
        pose=pose, linear=np.array([1.0, 2, 3]), angular=np.array([0, 0, np.pi]), pose_time=10.0
    )
    later = vehicle_pose(image, 10.5)

    np.testing.assert_allclose(later[:3, 3], [0.5, 1, 1.5])
    # A quarter turn about the vehicle's z: its x now points where its y did, world z.
    np.testing.assert_allclose(later[:3, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_array_equal(image.pose, pose)


def test_the_camera_looks_along_its_x():
    image = IMAGE._replace(pose=np.eye(4), linear=np.zeros(3), angular=np.zeros(3))
    calibration = CALIBRATION._replace(extrinsic=np.eye(4))
    lens = Lens.of(calibration, "front")
    camera = pinhole(calibration, lens, "front", image, IMAGE.pose_time, (1.0, 2.0, 3.0))

    np.testing.assert_array_equal(camera.optical_axis, [1, 0, 0])
    np.testing.assert_array_equal(camera.world_from_camera[:3, 0], [0, -1, 0])
    np.testing.assert_array_equal(camera.world_from_camera[:3, 1], [0, 0, -1])
    np.testing.assert_array_equal(camera.centre, [-1, -2, -3])
    np.testing.assert_array_equal(camera.K[:2, 2], CALIBRATION.intrinsic[2:4])


def test_undistorting_takes_pixels_from_where_the_lens_bent_their_rays_to():
    intrinsic = np.array([205.0, 206.0, 95.3, 62.7, -0.33, 0.04, 0.001, -0.0015, 0.01])
    calibration = CALIBRATION._replace(intrinsic=intrinsic, width=192, height=128)
    # A picture of places, with Waymo's pixel 0 from 0 to 1, tells where each pixel came from.
    places = np.stack(np.meshgrid(np.arange(192) + 0.5, np.arange(128) + 0.5), axis=-1)
    seen = Lens.of(calibration, "front").undistort(places.astype(np.float32))

    f, c = intrinsic[:2], intrinsic[2:4]
    k1, k2, p1, p2, k3 = intrinsic[4:]
    x, y = np.moveaxis((places - c) / f, -1, 0)
    r = x * x + y * y
    radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    bent_y = y * radial + 2 * p2 * x * y + p1 * (r + 2 * y * y)
    expected = np.stack([bent_x, bent_y], axis=-1) * f + c
    # OpenCV rounds to 1/32 pixel. A centre that is half a pixel off moves the border by 0.1.
    assert np.abs(expected - places).max() > 5
    np.testing.assert_allclose(seen, np.clip(expected, 0.5, [191.5, 127.5]), atol=0.025)


def test_a_lens_that_does_not_bend_changes_nothing():
    intrinsic = np.array([205.0, 206.0, 95.3, 62.7, 1e-9, 0, 0, 0, 0])
    calibration = CALIBRATION._replace(intrinsic=intrinsic, width=192, height=128)
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (128, 192, 3), np.uint8)

    np.testing.assert_array_equal(Lens.of(calibration, "front").undistort(image), image)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"readout": 0}, "calibration: a camera reads out in direction 0"),
        ({"readout": 9}, "reads out in direction 9"),
    ],
)
def test_unknown_readouts_are_refused(change, what):
    with pytest.raises(GeoEvsError, match=what):
        read_exposure(CALIBRATION._replace(**change), IMAGE)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"pose_time": IMAGE.pose_time + 2}, "more than 1 s from its pose"),
        ({"trigger": np.nan}, "the trigger of an image is nan"),
        ({"done": IMAGE.trigger - 0.2}, "the exposure's time"),
        ({"pose_time": np.inf}, "the pose_time of an image is inf"),
    ],
)
def test_impossible_times_are_refused(change, what):
    with pytest.raises(GeoEvsError, match=what) as caught:
        read_exposure(CALIBRATION, IMAGE._replace(**change))
    assert "file: record 7" in str(caught.value)


def test_a_velocity_that_is_not_finite_is_refused():
    with pytest.raises(GeoEvsError, match="file: record 7: an image's velocity is not finite"):
        vehicle_pose(IMAGE._replace(linear=np.array([np.nan, 0, 0])), 1.0)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"intrinsic": CALIBRATION.intrinsic[:8]}, "'front' is not nine finite numbers"),
        ({"intrinsic": CALIBRATION.intrinsic * np.nan}, "'front' is not nine finite numbers"),
        ({"intrinsic": CALIBRATION.intrinsic * [-1] + 0}, "focal length"),
        ({"width": 192}, "focal|principal"),
        ({"height": 0}, "no pixels"),
        ({"width": 10**6}, "side of"),
    ],
)
def test_impossible_lenses_are_refused(change, what):
    with pytest.raises(GeoEvsError, match=f"^calibration: .*({what})"):
        Lens.of(CALIBRATION._replace(**change), "front")
