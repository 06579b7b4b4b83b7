"""Checking a whole method on the tiny scene, its training included: `geoevs check-adapter`."""

import tempfile
from pathlib import Path
from typing import Any

import geoevs
from geoevs.geometry.depth_models import LidarDepth
from geoevs.geometry.point_maps import write_point_maps
from geoevs.methods.check import check_isolated
from geoevs.methods.check_training import check_imports_no_torch, check_training
from geoevs.methods.finding import check_free_name, find_methods, find_trainings
from geoevs.methods.training import Inputs
from geoevs.methods.trial import Check
from geoevs.scenes.store import Scene

MASK_POSES = {"yaw": [0.0, 0.5], "lateral": [-1.0, 1.0]}


def check_method(name: str, options: dict[str, Any], settings: dict[str, Any]) -> list[Check]:
    """Run every check on a method, on its training first, whose weights the others then take.

    Args:
        name: the method's.
        options: its own; with `weights` among them no training is checked.
        settings: of its training, where they are not the defaults.

    Raises:
        GeoEvsError: there is no such method, or an option or setting is wrong.
    """
    check_free_name(name)
    checks = [check_imports_no_torch(name)] if name in find_methods() else []
    if name not in find_trainings() or "weights" in options:
        return checks + check_isolated(name, options)
    with tempfile.TemporaryDirectory() as temporary:
        weights = Path(temporary) / "weights"
        checks += check_training(name, settings, trial_inputs, weights)
        if not weights.exists():
            return checks
        return checks + check_isolated(name, options | {"weights": str(weights)})


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
