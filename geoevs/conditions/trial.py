"""What a training reads, of the tiny scene: for `geoevs check-adapter`."""

from pathlib import Path

import geoevs
from geoevs.geometry.depth_models import LidarDepth
from geoevs.geometry.point_maps import write_point_maps
from geoevs.methods.training import Inputs
from geoevs.scenes.store import Scene

MASK_POSES = {"yaw": [0.0, 0.5], "lateral": [-1.0, 1.0]}


def trial_inputs(scene: Scene, folder: Path) -> Inputs:
    """Inputs of every kind: depth by LiDAR, a few mask poses, this suite's pretrained weights.

    Args:
        scene: the tiny scene.
        folder: where files that must be made go.
    """
    maps = folder / "point-maps.npz"
    write_point_maps(maps, scene, LidarDepth(), lambda: None)
    weights = Path(geoevs.__file__).parent / "weights"
    return Inputs(point_maps=maps, mask_poses=MASK_POSES, geometry="lidar", weights=weights)
