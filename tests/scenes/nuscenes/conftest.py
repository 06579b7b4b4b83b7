"""The tiny nuScenes folder, and the real frame where it lies on the machine."""

import os
from pathlib import Path

import pytest

from tests.scenes.nuscenes.demo import write_demo
from tests.scenes.nuscenes.writer import write_folder


@pytest.fixture
def nuscenes(tmp_path: Path) -> Path:
    """A folder with the tiny scene `scene-0061` in it."""
    return write_folder(tmp_path / "nuscenes")


@pytest.fixture(scope="session")
def real_nuscenes(tmp_path_factory) -> Path:
    """A folder in which `scene-0061@0-0` is the real keyframe."""
    if "GEOEVS_NUSCENES" not in os.environ:
        pytest.skip("set GEOEVS_NUSCENES to nuScenes' folder, or to mmdetection3d's demo frame")
    folder = Path(os.environ["GEOEVS_NUSCENES"])
    if (folder / "v1.0-mini").is_dir():
        return folder
    return write_demo(folder, tmp_path_factory.mktemp("nuscenes"))
