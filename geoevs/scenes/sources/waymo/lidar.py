"""Range images to points: a row is a beam from the top down, a column an azimuth."""

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import WORLD_LIMIT
from geoevs.scenes.scene import PointCloud
from geoevs.scenes.sources.waymo.segment import LASERS, LaserCalibration, RangeImages

MOST_ROWS = 65_536
"""Rows of a range image at most, as a point's `beam` is a uint16."""


def sweep_points(
    name: str,
    sweep: RangeImages,
    calibration: LaserCalibration,
    frame_pose: np.ndarray,  # [4, 4]
    origin: tuple[float, float, float],
    second_returns: bool,
) -> PointCloud:
    """The points of one LiDAR in the world, computed in float64, less the origin.

    Args:
        name: of LASERS.
        sweep: its range images.
        calibration: its extrinsic and the elevations of its beams.
        frame_pose: world from vehicle, for images without a pose of each pixel.
        origin: metres that are subtracted.
        second_returns: whether these follow the first ones, along the same rays.

    Raises:
        GeoEvsError: images and calibration do not fit, or points are NaN or beyond WORLD_LIMIT.
    """
    images = [sweep.first, sweep.second] if second_returns else [sweep.first]
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is refused below
        points = [
            unproject(image, sweep.poses, calibration, frame_pose, sweep.where)
            for image in images
            if image is not None
        ]
    if not points:
        return no_points()
    xyz = np.concatenate([part[0] for part in points]) - origin
    rows = np.concatenate([part[1] for part in points])
    bad = ~(np.abs(xyz) <= WORLD_LIMIT).all(axis=1)  # NaN is bad too
    if bad.any():
        raise GeoEvsError(
            f"{sweep.where}: {bad.sum()} of {len(xyz)} points of LiDAR '{name}' are NaN, "
            f"infinite or more than {WORLD_LIMIT / 1000:g} km from where the scene begins; "
            "download the file again or leave out the frame"
        )
    return PointCloud.uncoloured(xyz, np.full(len(xyz), LASERS.index(name)), rows)


def no_points() -> PointCloud:
    """The points of LiDARs that measured nothing."""
    return PointCloud.uncoloured(np.zeros((0, 3)), np.zeros(0), np.zeros(0))


def joined(clouds: list[PointCloud]) -> PointCloud:
    """The points of several LiDARs as one cloud, in their order."""
    fields = ("xyz", "sensor", "beam")
    parts = [[getattr(cloud, field) for cloud in (no_points(), *clouds)] for field in fields]
    return PointCloud.uncoloured(*(np.concatenate(part) for part in parts))


def unproject(
    image: np.ndarray,  # [H, W, 4]
    poses: np.ndarray | None,  # [H, W, 6]
    calibration: LaserCalibration,
    frame_pose: np.ndarray,  # [4, 4]
    where: str,
) -> tuple[np.ndarray, np.ndarray]:
    """The pixels that measured something, as points in the world.

    dataset.proto has the format: column 0 is the azimuth pi, and azimuths fall to the right, in
    axes turned by the extrinsic's yaw. A pixel's pose stands in place of the frame's.

    Returns:
        (N, 3) float64 metres and (N,) their rows, row after row.

    Raises:
        GeoEvsError: the image has another size than the beams or the poses.
    """
    height, width = image.shape[:2]
    inclinations = beam_inclinations(calibration, height, where)
    if poses is not None and poses.shape[:2] != (height, width):
        raise GeoEvsError(
            f"{where}: a range image has {height} x {width} pixels but its poses "
            f"{poses.shape[0]} x {poses.shape[1]}; download the file again"
        )
    extrinsic = calibration.extrinsic
    share = (width - np.arange(width) - 0.5) / width
    azimuths = (2 * share - 1) * np.pi - np.arctan2(extrinsic[1, 0], extrinsic[0, 0])
    rows, columns = np.nonzero(image[..., 0] > 0)
    metres = image[rows, columns, 0].astype(np.float64)
    azimuth, inclination = azimuths[columns], inclinations[rows]
    level = metres * np.cos(inclination)
    beams = np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), metres * np.sin(inclination)], axis=1
    )
    xyz = _moved(beams, extrinsic)
    if poses is None:
        return _moved(xyz, frame_pose), rows
    return _moved_each(xyz, poses[rows, columns].astype(np.float64)), rows


def beam_inclinations(calibration: LaserCalibration, height: int, where: str) -> np.ndarray:
    """(H,) float64 radians above the level of each row, the top row first.

    Raises:
        GeoEvsError: the calibration names another number of beams, or no finite ones.
    """
    listed = calibration.inclinations
    low, high = calibration.low, calibration.high
    upwards = listed if len(listed) else low + (np.arange(height) + 0.5) / height * (high - low)
    if not np.isfinite(upwards).all():
        raise GeoEvsError(f"{calibration.where}: a LiDAR's beams are NaN; download the file again")
    if len(upwards) != height or height > MOST_ROWS:
        raise GeoEvsError(
            f"{where}: a range image has {height} rows, but its LiDAR {len(upwards)} beams; "
            "download the file again"
        )
    return upwards[::-1]


def _moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return points @ pose[:3, :3].T + pose[:3, 3]


def _moved_each(
    points: np.ndarray,  # [N, 3]
    poses: np.ndarray,  # [N, 6] roll, pitch, yaw, x, y, z
) -> np.ndarray:
    """Each point by its own pose: Rz(yaw) Ry(pitch) Rx(roll), then the translation."""
    x, y, z = points.T
    (roll, pitch, yaw), place = poses[:, :3].T, poses[:, 3:]
    y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
    x, z = np.cos(pitch) * x + np.sin(pitch) * z, np.cos(pitch) * z - np.sin(pitch) * x
    x, y = np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y
    return np.stack([x, y, z], axis=1) + place
