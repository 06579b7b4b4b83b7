import pytest
import torch

from geoevs.geometry.vggt import VggtConfig, new_vggt, save_vggt
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.scenes.depths import write_depths
from geoevs.scenes.scene import Frame


@pytest.fixture(scope="session")
def small_vggt(tmp_path_factory):
    """A file with a small network of patches of 8."""
    path = tmp_path_factory.mktemp("vggt") / "small.safetensors"
    config = VggtConfig(8, 16, 4, 2, (0, 1, 2, 3), (4, 4, 4, 4), 8, layer_scale=1.0)
    save_vggt(new_vggt(config, torch.Generator().manual_seed(0)), path)
    return path


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """The tiny scene."""
    return write_tiny_scene(tmp_path_factory.mktemp("tiny") / "scene")


@pytest.fixture(scope="session")
def tiny_depths(tiny, tmp_path_factory):
    """The folder of its dense true depth."""
    folder = tmp_path_factory.mktemp("tiny") / "depths"
    for number in tiny.frames:
        cameras = {name: tiny.camera(name, number) for name in tiny.cameras}
        depths = {name: tiny_truth(camera).depth for name, camera in cameras.items()}
        write_depths(folder, Frame(number, 0.0, cameras, {}, tiny.points(number), depths))
    return folder
