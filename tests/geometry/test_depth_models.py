"""Depth models by name, on the tiny scene."""

import subprocess
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.geometry.depth_models import DEPTH_MODELS, make_depth_model
from geoevs.geometry.lift import lidar_depths
from geoevs.geometry.vggt import VggtConfig, load_vggt, new_vggt, save_vggt
from geoevs.methods.contract import Views
from geoevs.methods.tiny import HEIGHT, WIDTH, write_tiny_scene
from geoevs.projection import zbuffer

# The tiny scene is 48 x 72: patches of 14 need 42 x 70, and patches of 8 fit.
SIZES = {"vggt-nano": 8, "vggt-1b": 14}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("models") / "tiny")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A small network's file for every patch size."""
    folder = tmp_path_factory.mktemp("weights")
    paths = {}
    for patch in SIZES.values():
        config = VggtConfig(patch, 16, 4, 2, (0, 1, 2, 3), (4, 4, 4, 4), 8, layer_scale=1.0)
        paths[patch] = folder / f"{patch}.safetensors"
        save_vggt(new_vggt(config, torch.Generator().manual_seed(0)), paths[patch])
    return paths


def direct(path, views, frame):
    """What the network says of all views at once, at their own size."""
    images = np.stack([views.image(name, frame) for name in views.cameras])
    with torch.inference_mode():
        return load_vggt(path)(torch.from_numpy(images).permute(0, 3, 1, 2)[None]).depth[0]


def test_without_lidar_it_is_the_network_alone(scene, weights):
    views = Views(scene, ("left", "front"), ())
    depths = make_depth_model("vggt-nano", weights[8]).depths(views, 1)
    assert list(depths) == ["left", "front"]
    for found, expected in zip(depths.values(), direct(weights[8], views, 1), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize("name", SIZES)
def test_with_lidar_it_meets_the_visible_points(scene, weights, name):
    views = Views(scene, scene.cameras, ("lidar",))
    depths = make_depth_model(name, weights[SIZES[name]]).depths(views, 0)
    points = views.lidar(0).xyz
    for camera, depth in depths.items():
        assert depth.shape == (HEIGHT, WIDTH)
        assert depth.dtype == np.float32
        lidar = zbuffer(points, views.camera(camera, 0), visibility="footprint").depth
        assert (lidar > 0).any()
        np.testing.assert_allclose(depth[lidar > 0], lidar[lidar > 0], rtol=1e-4)


def test_images_of_any_size_fit(scene, weights):
    views = Views(scene, scene.cameras, ())
    depths = make_depth_model("vggt-1b", weights[14]).depths(views, 0)
    assert {depth.shape for depth in depths.values()} == {(HEIGHT, WIDTH)}
    # Nearest pixels, so no value that was not predicted: 42 rows were.
    assert len({row.tobytes() for row in depths["front"]}) == 42


def test_lidar_is_the_completed_depth(scene):
    views = Views(scene, scene.cameras, ("lidar",))
    found = make_depth_model("lidar", None).depths(views, 0)
    for name, expected in lidar_depths(views, 0).items():
        np.testing.assert_array_equal(found[name], expected)


class FakeDepthAnything3:
    """Says 3 m in the first view, 4 m in the second, ..., at a size of its own."""

    @classmethod
    def from_pretrained(cls, folder):
        model = cls()
        model.folder = folder
        return model

    def to(self, device):
        assert device in ("cpu", "cuda")
        return self

    def inference(self, image):
        assert all(one.dtype == np.uint8 and one.shape == (HEIGHT, WIDTH, 3) for one in image)
        depth = np.full((len(image), 8, 12), 3.0, np.float32)
        return SimpleNamespace(depth=depth + np.arange(len(image))[:, None, None], conf=None)


@pytest.fixture
def package(monkeypatch):
    module = ModuleType("depth_anything_3.api")
    module.DepthAnything3 = FakeDepthAnything3
    monkeypatch.setitem(sys.modules, "depth_anything_3", ModuleType("depth_anything_3"))
    monkeypatch.setitem(sys.modules, "depth_anything_3.api", module)


def test_depth_anything_through_its_package(scene, package, tmp_path):
    model = make_depth_model("depth-anything-3", tmp_path)
    assert model.model.folder == str(tmp_path)
    depths = model.depths(Views(scene, ("front", "left"), ()), 0)
    assert {name: set(depth.ravel()) for name, depth in depths.items()} == {
        "front": {3.0},
        "left": {4.0},
    }
    assert depths["front"].shape == (HEIGHT, WIDTH)


def test_depth_anything_needs_a_folder(package, tmp_path):
    with pytest.raises(GeoEvsError, match="none is no folder of Depth Anything 3 weights"):
        make_depth_model("depth-anything-3", tmp_path / "none")


def test_a_missing_package_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "depth_anything_3.api", None)
    with pytest.raises(GeoEvsError, match=r"cannot be imported .* run `pip install git\+https"):
        make_depth_model("depth-anything-3", tmp_path)


def test_an_unknown_name_is_mended():
    with pytest.raises(GeoEvsError, match="no depth model 'vgt-nano'; did you mean 'vggt-nano'"):
        make_depth_model("vgt-nano", None)


@pytest.mark.parametrize("name", [name for name in DEPTH_MODELS if name != "lidar"])
def test_networks_need_weights(name):
    with pytest.raises(GeoEvsError, match=f"'{name}' needs weights"):
        make_depth_model(name, None)


def test_lidar_needs_none(tmp_path):
    with pytest.raises(GeoEvsError, match="'lidar' has no weights"):
        make_depth_model("lidar", tmp_path)


def test_names_are_listed_without_torch():
    code = "import sys, geoevs.geometry.depth_models; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
