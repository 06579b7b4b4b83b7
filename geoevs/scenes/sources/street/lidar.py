"""A spinning roof LiDAR: 64 beams, range noise, lost returns."""

from typing import Any

import numpy as np

from geoevs.scenes.scene import PointCloud
from geoevs.scenes.sources.street.rig import LIDAR_MOUNT
from geoevs.scenes.sources.street.stage import cast

BEAMS = 64
ELEVATIONS = np.radians(np.linspace(2.4, -17.6, BEAMS))
RANGE_NOISE = 0.02  # metres, one standard deviation
MAX_RANGE, MIN_RANGE = 75.0, 1.5
LOST, LOST_GLOSSY = 0.02, 0.55  # shares of returns that never come back


def scan(
    scene: Any, world_from_vehicle: np.ndarray, azimuths: int, rng: np.random.Generator
) -> PointCloud:
    """One turn of the LiDAR.

    Args:
        scene: a Mitsuba scene.
        world_from_vehicle: (4, 4) pose.
        azimuths: measurements of each beam in a turn.
        rng: for the noise.

    Returns:
        Uncoloured points in the world, beam by beam from the top.
    """
    turn = np.linspace(0, 2 * np.pi, azimuths, endpoint=False)
    elevation, azimuth = (grid.ravel() for grid in np.meshgrid(ELEVATIONS, turn, indexing="ij"))
    flat = np.cos(elevation)
    local = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    directions = local @ world_from_vehicle[:3, :3].T
    origin = world_from_vehicle[:3, :3] @ LIDAR_MOUNT + world_from_vehicle[:3, 3]
    distance, glossy = cast(scene, origin, directions)
    noise = rng.normal(0, RANGE_NOISE, len(distance))
    luck = rng.random(len(distance))
    # Far surfaces return less light: at the end of the range about half is lost.
    lost = np.where(glossy, LOST_GLOSSY, LOST) + 0.5 * np.minimum(distance / MAX_RANGE, 1.0) ** 3
    kept = (distance > MIN_RANGE) & (distance < MAX_RANGE) & (luck > lost)
    points = origin + (distance + noise)[kept, None] * directions[kept]
    beam = np.repeat(np.arange(BEAMS), azimuths)[kept]
    return PointCloud.uncoloured(points, np.zeros(len(beam)), beam)
