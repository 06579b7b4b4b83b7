"""Depth models by name, on the tiny scene."""

import subprocess
import sys
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.geometry.depth_models import DEPTH_MODELS, make_depth_model
from geoevs.geometry.lift import lidar_depths
from geoevs.geometry.vggt import DepthPrediction, VggtConfig, load_vggt, new_vggt, save_vggt
from geoevs.methods.contract import Views
from geoevs.methods.tiny import HEIGHT, WIDTH, write_tiny_scene
from geoevs.projection import zbuffer

# As the suite's own, whose patches fit the tiny scene of 48 x 72, and as the public one.
CONFIGS = {
    "vggt-nano": VggtConfig(8, 16, 4, 2, (0, 1, 2, 3), (4, 4, 4, 4), 8, layer_scale=1.0),
    "vggt-1b": VggtConfig(
        14, 16, 4, 2, (0, 1, 2, 3), (4, 4, 4, 4), 8, layer_scale=1.0, dino_depth=1, longest=518
    ),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("models") / "tiny")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A small network's file for every model."""
    folder = tmp_path_factory.mktemp("weights")
    paths = {name: folder / f"{name}.safetensors" for name in CONFIGS}
    for name, config in CONFIGS.items():
        save_vggt(new_vggt(config, torch.Generator().manual_seed(0)), paths[name])
    return paths


class Squashed(Views):
    """The tiny scene's views as a run at another height and width has them."""

    def __init__(self, scene, cameras, needs, size):
        super().__init__(scene, cameras, needs)
        self.size = size

    def camera(self, name, frame):
        return super().camera(name, frame).resized(*self.size)

    def image(self, name, frame):
        return cv2.resize(super().image(name, frame), self.size[::-1])


def direct(path, views, frame):
    """What the network says of all views at once, at their own size."""
    images = np.stack([views.image(name, frame) for name in views.cameras])
    with torch.inference_mode():
        return load_vggt(path)(torch.from_numpy(images).permute(0, 3, 1, 2)[None]).depth[0]


def test_without_lidar_it_is_the_network_alone(scene, weights):
    views = Views(scene, ("left", "front"), ())
    depths = make_depth_model("vggt-nano", weights["vggt-nano"]).depths(views, 1)
    assert list(depths) == ["left", "front"]
    expected = direct(weights["vggt-nano"], views, 1).numpy()
    for found, exact in zip(depths.values(), expected, strict=True):
        np.testing.assert_array_equal(found, exact)


@pytest.mark.parametrize("name", CONFIGS)
def test_with_lidar_it_meets_the_visible_points(scene, weights, name):
    views = Views(scene, scene.cameras, ("lidar",))
    depths = make_depth_model(name, weights[name]).depths(views, 0)
    points = views.lidar(0).xyz
    for camera, depth in depths.items():
        assert depth.shape == (HEIGHT, WIDTH)
        assert depth.dtype == np.float32
        lidar = zbuffer(points, views.camera(camera, 0), visibility="footprint").depth
        assert (lidar > 0).any()
        np.testing.assert_allclose(depth[lidar > 0], lidar[lidar > 0], rtol=1e-4)


def asked(model):
    """The shapes of all pictures that a model shows its network from now on."""
    shapes = []
    model.model.register_forward_pre_hook(lambda _, inputs: shapes.append(tuple(inputs[0].shape)))
    return shapes


@pytest.mark.parametrize("size", [(32, 108), (96, 48), (540, 810)])
def test_a_public_network_sees_what_was_recorded(scene, weights, size):
    model = make_depth_model("vggt-1b", weights["vggt-1b"])
    shapes = asked(model)
    for views in (Views(scene, ("front",), ()), Squashed(scene, ("front",), (), size)):
        depth = model.depths(views, 0)["front"]
        camera = views.camera("front", 0)
        assert depth.shape == (camera.height, camera.width)
        assert depth.dtype == np.float32
        assert (depth > 0).all()
    assert shapes == [(1, 1, 3, 350, 518)] * 2  # of 48 x 72, whatever the run made of it


def test_the_suites_own_network_sees_the_runs_images(scene, weights):
    model = make_depth_model("vggt-nano", weights["vggt-nano"])
    shapes = asked(model)
    model.depths(Squashed(scene, ("front",), (), (32, 108)), 0)
    model.depths(Squashed(scene, ("front",), (), (384, 384)), 0)
    assert shapes == [(1, 1, 3, 32, 112), (1, 1, 3, 192, 192)]


def test_depth_lies_where_it_was_predicted(scene, weights):
    model = make_depth_model("vggt-1b", weights["vggt-1b"])
    # Says how far down and to the right a pixel of what it is shown lies.
    model.model.forward = lambda images: DepthPrediction(
        torch.arange(1.0, 351)[:, None] + 1000 * torch.arange(518) + 0 * images[:, :, 0],
        torch.ones_like(images[:, :, 0]),
    )
    depth = model.depths(Squashed(scene, ("front", "left"), (), (50, 37)), 0)["left"]
    rows, columns = depth % 1000 - 0.5, depth // 1000 + 0.5
    np.testing.assert_allclose(rows[:, 0], (np.arange(50) + 0.5) * 7, atol=0.5)
    np.testing.assert_allclose(columns[0], (np.arange(37) + 0.5) * 14, atol=0.5)


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
        assert all(one.dtype == np.uint8 and one.shape == (336, 504, 3) for one in image)
        depth = np.full((len(image), 8, 12), 3.0, np.float32)
        return SimpleNamespace(depth=depth + np.arange(len(image))[:, None, None], conf=None)


@pytest.fixture
def package(monkeypatch):
    module = ModuleType("depth_anything_3.api")
    module.DepthAnything3 = FakeDepthAnything3
    monkeypatch.setitem(sys.modules, "depth_anything_3", ModuleType("depth_anything_3"))
    monkeypatch.setitem(sys.modules, "depth_anything_3.api", module)


@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (60, 60)])
def test_depth_anything_through_its_package(scene, package, tmp_path, size):
    model = make_depth_model("depth-anything-3", tmp_path)
    assert model.model.folder == str(tmp_path)
    depths = model.depths(Squashed(scene, ("front", "left"), (), size), 0)
    assert {name: set(depth.ravel()) for name, depth in depths.items()} == {
        "front": {3.0},
        "left": {4.0},
    }
    assert depths["front"].shape == size


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
