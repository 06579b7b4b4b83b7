"""Waymo's cameras: when a column was exposed, where the vehicle was then, and the lens removed."""

from typing import NamedTuple, Self

import cv2
import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera
from geoevs.scenes.checks import check_exposure, number
from geoevs.scenes.scene import Exposure
from geoevs.scenes.sources.conventions import FORWARD_FROM_OPENCV
from geoevs.scenes.sources.waymo.segment import CameraCalibration, CameraImage

READOUTS = {1: (0, 1), 2: (1, 0), 3: (0, -1), 4: (-1, 0), 5: (0, 0)}
"""Of each readout direction, along which axis of the image (x right, y down) time goes on: 1 down,
2 right, 3 up, 4 left; 5 is a global shutter."""

LONGEST_GAP = 1.0
"""Seconds between a pose and its image at most; real ones are some milliseconds apart."""

CENTRE_SHIFT = 0.5
"""Waymo's pixel 0 begins at 0, as ours; OpenCV's is centred there."""


def line_time(calibration: CameraCalibration, image: CameraImage, x: float, y: float) -> float:
    """Seconds at which pixel (x, y) was exposed: the middle of its line's exposure.

    dataset.proto: lines are read one after the other from `trigger + shutter` to `done`, and each
    was exposed for `shutter` before. A global shutter exposes all at the pose's time.

    Raises:
        GeoEvsError: the camera reads out in a direction that there is not.
    """
    if calibration.readout not in READOUTS:
        raise GeoEvsError(
            f"{calibration.where}: a camera reads out in direction {calibration.readout}, and "
            "there are 1 to 5; download the file again"
        )
    across, down = READOUTS[calibration.readout]
    if not (across or down):
        return image.pose_time
    share = across * x / calibration.width + down * y / calibration.height
    share += across < 0 or down < 0
    first = image.trigger + image.shutter / 2
    return first + share * (image.done - image.trigger - image.shutter)


def read_exposure(calibration: CameraCalibration, image: CameraImage) -> Exposure:
    """When the principal point, the first and the last line of an image were exposed.

    Raises:
        GeoEvsError: the times are impossible, or more than LONGEST_GAP from the pose.
    """
    for name in ("pose_time", "shutter", "trigger", "done"):
        number(getattr(image, name), f"the {name} of an image", image.where)
    time = line_time(calibration, image, *calibration.intrinsic[2:4].tolist())
    first, last = image.trigger + image.shutter / 2, image.done - image.shutter / 2
    if READOUTS[calibration.readout] == (0, 0):
        first = last = time
    if max(abs(first - image.pose_time), abs(last - image.pose_time)) > LONGEST_GAP:
        raise GeoEvsError(
            f"{image.where}: an image was exposed more than {LONGEST_GAP:g} s from its pose's "
            "time; download the file again"
        )
    return check_exposure(Exposure(time, first, last), image.where)


def vehicle_pose(image: CameraImage, time: float) -> np.ndarray:
    """(4, 4) world from vehicle at `time`, from the pose and velocity at `pose_time`.

    The velocity is of the world, the turn about the vehicle's own axes: t + v dt and R exp([w] dt).
    (dataset.proto says dR = W R, but its camera model turns in the vehicle, as here.)

    Raises:
        GeoEvsError: the velocity is not finite.
    """
    if not (np.isfinite(image.linear).all() and np.isfinite(image.angular).all()):
        raise GeoEvsError(
            f"{image.where}: an image's velocity is not finite; download the file again"
        )
    seconds = time - image.pose_time
    pose = image.pose.copy()
    pose[:3, :3] = image.pose[:3, :3] @ cv2.Rodrigues(image.angular * seconds)[0]
    pose[:3, 3] += image.linear * seconds
    return pose


class Lens(NamedTuple):
    """A camera's pinhole and where its pixels lie in the distorted image."""

    K: np.ndarray  # [3, 3]
    maps: tuple[np.ndarray, np.ndarray]  # as cv2.remap takes them

    @classmethod
    def of(cls, calibration: CameraCalibration, name: str) -> Self:
        """The lens of a calibration; K stays as it is.

        Raises:
            GeoEvsError: the calibration has not nine finite numbers, or K is none of its image
                (see Camera).
        """
        intrinsic = calibration.intrinsic
        if len(intrinsic) != 9 or not np.isfinite(intrinsic).all():
            raise GeoEvsError(
                f"{calibration.where}: the intrinsic of camera '{name}' is not nine finite "
                "numbers; download the file again"
            )
        fx, fy, cx, cy = intrinsic[:4]
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        size = calibration.width, calibration.height
        try:
            Camera(K, np.eye(4), size[1], size[0], name)
        except GeoEvsError as error:
            raise GeoEvsError(f"{calibration.where}: {error}") from error
        shifted = K - CENTRE_SHIFT * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        x, y = cv2.initUndistortRectifyMap(
            shifted, intrinsic[4:], None, shifted, size, cv2.CV_32FC1
        )
        # cv2.remap rounds to 1/32 pixel in either form; this one is half the size and faster.
        return cls(K, cv2.convertMaps(x, y, cv2.CV_16SC2))

    def undistort(self, image: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 as a pinhole with K sees it; what lies outside repeats the border."""
        return cv2.remap(image, *self.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def pinhole(
    calibration: CameraCalibration,
    lens: Lens,
    name: str,
    image: CameraImage,
    time: float,
    origin: tuple[float, float, float],
) -> Camera:
    """The undistorted camera of an image, at its own size.

    Args:
        calibration: of the camera.
        lens: of the calibration.
        name: of the camera.
        image: which has the vehicle's pose.
        time: the instant of the camera's pose, in seconds.
        origin: metres that are subtracted.

    Raises:
        GeoEvsError: the camera is impossible (see Camera).
    """
    pose = vehicle_pose(image, time) @ calibration.extrinsic @ FORWARD_FROM_OPENCV
    pose[:3, 3] -= origin
    try:
        return Camera(lens.K, pose, calibration.height, calibration.width, name)
    except GeoEvsError as error:
        raise GeoEvsError(f"{image.where}: {error}") from error
