"""A sweep of nuScenes' LiDAR: 32 beams, in a file of plain floats."""

from pathlib import Path

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import check_file
from geoevs.scenes.camera import WORLD_LIMIT
from geoevs.scenes.scene import PointCloud

VALUES = 5
"""Float32 of a point: x to the right, y forward, z up, intensity, ring."""

BEAMS = 32

LARGEST_SWEEP = 64 * 2**20
"""Bytes of a sweep at most; the largest of a release has a hundredth."""

CAR = ((-0.7, 3.5), (-0.9, 0.9))
"""Metres from the middle of the rear axle, forward and to the left: where the car stands that
carries the sensors, a Renault Zoe (4.08 m x 1.73 m)."""


def read_sweep(path: Path, car_from_lidar: np.ndarray, world_from_car: np.ndarray) -> PointCloud:
    """The points of a sweep in the world, without those on the car that carries the LiDAR.

    nuScenes counts rings from the lowest one, a PointCloud counts beams from the top.

    Args:
        path: a file of (N, 5) float32 (see VALUES).
        car_from_lidar: (4, 4) where the LiDAR is on the car.
        world_from_car: (4, 4) where the car is.

    Raises:
        GeoEvsError: the file is missing, is cut off, or holds what no LiDAR measures.
    """
    size = check_file(path).stat().st_size
    if size % (4 * VALUES) or not 0 < size <= LARGEST_SWEEP:
        raise GeoEvsError(
            f"{path} has {size} bytes, but a sweep has {4 * VALUES} for each of its points, and "
            f"{LARGEST_SWEEP // 2**20} MiB at most; download it again"
        )
    values = np.frombuffer(path.read_bytes(), "<f4").reshape(-1, VALUES)
    xyz, ring = values[:, :3].astype(np.float64), values[:, 4]
    good = (np.abs(xyz) <= WORLD_LIMIT).all(axis=1)  # NaN is not good either
    if not good.all():
        raise GeoEvsError(
            f"{path} has {(~good).sum()} of {len(xyz)} points that are NaN, infinite or more than "
            f"{WORLD_LIMIT / 1000:g} km away; download it again"
        )
    if not np.isin(ring, np.arange(BEAMS)).all():
        raise GeoEvsError(
            f"{path} has points whose ring is none of 0 to {BEAMS - 1}; download it again"
        )
    xyz = _moved(car_from_lidar, xyz)
    along, across = (
        (xyz[:, axis] > low) & (xyz[:, axis] < high) for axis, (low, high) in enumerate(CAR)
    )
    seen = ~(along & across)
    beam = BEAMS - 1 - ring[seen].astype(int)
    return PointCloud.uncoloured(
        _moved(world_from_car, xyz[seen]), sensor=np.zeros(seen.sum()), beam=beam
    )


def _moved(pose: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """(N, 3) points by a rigid (4, 4) transform."""
    return np.asarray(xyz @ pose[:3, :3].T + pose[:3, 3])
