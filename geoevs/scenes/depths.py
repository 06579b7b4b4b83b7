"""Dense true depth of recorded views: it supervises and judges geometry, and no method sees it."""

from pathlib import Path

import numpy as np

from geoevs.core.files import read_arrays, write_arrays
from geoevs.scenes.checks import check_depth
from geoevs.scenes.scene import Frame


def write_depths(folder: Path, frame: Frame) -> Frame:
    """Write what a source knows of a frame's depth as `<frame>.npz`; the frame passes through."""
    if frame.depths:
        write_arrays(folder / f"{frame.frame:06d}.npz", frame.depths)
    return frame


def read_depths(folder: Path, frame: int) -> dict[str, np.ndarray]:
    """(H, W) float32 metres by camera, 0 = none; empty where nobody knows the depth.

    Raises:
        GeoEvsError: the file is damaged, or holds something else.
    """
    path = Path(folder) / f"{frame:06d}.npz"
    depths = read_arrays(path) if path.exists() else {}
    for camera, depth in depths.items():
        check_depth(depth, f"{path}: the depth of camera '{camera}'")
    return depths
