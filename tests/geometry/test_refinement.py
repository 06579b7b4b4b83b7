"""The refiner: what it sees, what it starts as, and that it learns."""

import numpy as np
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import seeded
from geoevs.core.optimising import Optimisation, optimise
from geoevs.core.randomness import Rng
from geoevs.geometry.depth_models import make_depth_model
from geoevs.geometry.finetuning import FAR
from geoevs.geometry.lidar import complete_depth, lidar_reach
from geoevs.geometry.refinement import (
    COLOURS,
    DIFFERENCE,
    FITTED,
    INPUTS,
    MEASURED,
    DepthRefiner,
    refiner_inputs,
)
from geoevs.geometry.refiner_training import RefinementTask, RefinerViews, read_refiner_views
from geoevs.geometry.vggt import VggtConfig, load_vggt, new_vggt, save_vggt
from geoevs.methods.contract import Views
from geoevs.methods.tiny import FOCAL, HEIGHT, WIDTH, tiny_truth, write_tiny_scene
from geoevs.projection import zbuffer

CHANNELS = (4, 4)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("refined") / "tiny")


@pytest.fixture(scope="module")
def truth(scene, tmp_path_factory):
    """The scene's folder of dense true depth."""
    folder = tmp_path_factory.mktemp("truth")
    for frame in scene.frames:
        depths = {name: tiny_truth(scene.camera(name, frame)).depth for name in scene.cameras}
        np.savez(folder / f"{frame:06d}.npz", **depths)
    return folder


@pytest.fixture
def weights(tmp_path):
    config = VggtConfig(8, 16, 4, 2, (0, 1, 2, 3), (4, 4, 4, 4), 8)
    save_vggt(new_vggt(config, torch.Generator().manual_seed(0)), tmp_path / "v.safetensors")
    return tmp_path / "v.safetensors"


@pytest.fixture
def view(scene):
    """Image, some depth, LiDAR points and calibration of the front view."""
    camera = scene.camera("front", 0)
    depth = np.full((HEIGHT, WIDTH), 6.0, np.float32)
    return scene.image("front", 0), depth, scene.points(0).xyz, camera


def new_refiner():
    with seeded(0, "refiner"):
        return DepthRefiner(CHANNELS)


def test_it_sees_colours_both_depths_and_elevation(view):
    image, _, points, camera = view
    inputs = refiner_inputs(*view)
    assert inputs.shape == (INPUTS, HEIGHT, WIDTH)
    np.testing.assert_allclose(inputs[COLOURS].transpose(1, 2, 0), image * 2 - 1, atol=1e-6)
    completed = complete_depth(points, camera, image)
    np.testing.assert_allclose(inputs[DIFFERENCE], np.log(completed / 6.0), atol=1e-5)
    np.testing.assert_allclose(inputs[4] - inputs[FITTED], inputs[DIFFERENCE], atol=1e-5)
    measured = zbuffer(points, camera, visibility="footprint").depth
    known = measured > 0
    np.testing.assert_array_equal(inputs[7], known)
    expected = np.log(measured[known] / completed[known])
    np.testing.assert_allclose(inputs[6][known], expected, atol=1e-5)
    assert not inputs[6][~known].any()
    # A level camera: the middle of the image looks at the horizon, the top rises by 24 / FOCAL.
    middle = HEIGHT // 2
    np.testing.assert_allclose(inputs[8][middle - 1], -inputs[8][middle], atol=1e-6)
    rise = (middle - 0.5) / np.sqrt((middle - 0.5) ** 2 + 0.5**2 + FOCAL**2)
    assert inputs[8][0, WIDTH // 2] == pytest.approx(4 * rise, abs=1e-6)


def test_too_little_lidar_gives_nothing_to_see(view):
    image, fitted, points, camera = view
    assert refiner_inputs(image, fitted, points[:0], camera) is None


@pytest.mark.parametrize("size", [(48, 72), (37, 41)])
def test_untrained_it_is_the_geometric_mean(size):
    inputs = torch.zeros(1, INPUTS, *size)
    first, second = np.random.default_rng(0).uniform(1, 90, (2, *size))
    inputs[0, FITTED] = torch.from_numpy(np.log(first) - 2.5)
    inputs[0, DIFFERENCE] = torch.from_numpy(np.log(second / first))
    found = DepthRefiner((4, 8, 8))(inputs)[0].exp().detach().numpy()
    np.testing.assert_allclose(found, np.sqrt(first * second), rtol=1e-4)


def test_a_stored_refiner_refines_where_lidar_may_be_seen(scene, weights, tmp_path):
    plain = make_depth_model("vggt-nano", weights)
    network = load_vggt(weights)
    refiner = new_refiner()
    torch.nn.init.normal_(refiner.last.weight, generator=torch.Generator().manual_seed(1))
    network.set_refiner(refiner, CHANNELS)
    save_vggt(network, tmp_path / "both.safetensors")
    both = make_depth_model("vggt-nano", tmp_path / "both.safetensors")
    assert both.model.config.refiner == CHANNELS
    assert both.parameters == plain.parameters + sum(p.numel() for p in refiner.parameters())
    blind = Views(scene, scene.cameras, ())
    for name, depth in plain.depths(blind, 0).items():
        np.testing.assert_array_equal(both.depths(blind, 0)[name], depth)
    views = Views(scene, scene.cameras, ("lidar",))
    fitted, refined = plain.depths(views, 0), both.depths(views, 0)
    for name, depth in refined.items():
        camera = views.camera(name, 0)
        inputs = refiner_inputs(views.image(name, 0), fitted[name], views.lidar(0).xyz, camera)
        with torch.inference_mode():
            expected = refiner(torch.from_numpy(inputs)[None])[0].exp().numpy()
        reach = lidar_reach(inputs[MEASURED] > 0, camera)
        assert (reach == 1).any()
        np.testing.assert_allclose(depth[reach == 1], expected[reach == 1], rtol=1e-5)
        np.testing.assert_allclose(depth[reach == 0], fitted[name][reach == 0], rtol=1e-5)


def test_views_are_read_with_their_truth(scene, truth, weights):
    model = make_depth_model("vggt-nano", weights)
    done = []
    views = read_refiner_views([scene.folder], [truth], model, lambda: done.append(1))
    assert len(views) == len(scene.frames) * len(scene.cameras)
    assert len(done) == 1
    assert views.names[:2] == ["tiny/front/0", "tiny/left/0"]
    expected = tiny_truth(scene.camera("left", 0)).depth
    np.testing.assert_allclose(views.depths[1], expected, rtol=1e-3)
    assert views.depths.max() <= FAR


def test_scenes_without_truth_or_lidar_are_one_sentence(scene, truth, weights, tmp_path):
    model = make_depth_model("vggt-nano", weights)
    with pytest.raises(GeoEvsError, match=f"^{tmp_path} has no dense depth; leave scenes without"):
        read_refiner_views([scene.folder], [tmp_path], model)
    with pytest.raises(GeoEvsError, match=r"^LiDAR sees none of these scenes' views; name scenes"):
        read_refiner_views([], [], model)


def one_view(inputs, depth):
    return RefinerViews(inputs[None].astype(np.float16), depth[None].astype(np.float16), ["view"])


def test_it_learns_and_previews(view, tmp_path):
    inputs = refiner_inputs(*view)
    task = RefinementTask(new_refiner(), one_view(inputs, tiny_truth(view[3]).depth), 2)
    first = np.mean([task.losses(Rng(0, str(k)))["loss"].item() for k in range(4)])
    trained = optimise(task, Optimisation(60, 1e-2), 0, "refiner", tmp_path)
    task.model = trained
    assert np.mean([task.losses(Rng(0, str(k)))["loss"].item() for k in range(4)]) < 0.6 * first
    assert task.batch(Rng(0, "0")) == ["view", "view"]
    assert task.preview(trained).shape == (4 * HEIGHT, 6 * WIDTH, 3)


def test_inputs_and_truth_are_mirrored_together_and_colours_dimmed(view):
    inputs = refiner_inputs(*view)
    inputs[FITTED] = np.linspace(0, 1, WIDTH)
    task = RefinementTask(Recorder(), one_view(inputs, np.exp(inputs[FITTED])), 1)
    mirrored, exposures = 0, set()
    for step in range(12):
        losses = task.losses(Rng(0, str(step)))
        seen = task.model.seen.pop()[0]
        assert losses["relative_error"].item() < 0.01  # the truth is where the input is
        plain = torch.from_numpy(inputs.astype(np.float16)).float()
        flipped = seen[FITTED, 0, 0] > seen[FITTED, 0, -1]
        back = seen.flip(-1) if flipped else seen
        assert torch.equal(back[3:], plain[3:])
        inside = back[COLOURS].abs() < 0.99
        ratio = ((back[COLOURS] + 1) / (plain[COLOURS] + 1))[inside]
        torch.testing.assert_close(ratio, ratio.mean().expand_as(ratio), atol=1e-3, rtol=1e-3)
        exposures.add(round(ratio.mean().item(), 2))
        mirrored += bool(flipped)
    assert 0 < mirrored < 12
    assert len(exposures) > 6


class Recorder(torch.nn.Module):
    """Gives back the fitted log-depth, and keeps what it was shown."""

    def __init__(self):
        super().__init__()
        self.nothing = torch.nn.Parameter(torch.zeros(()))
        self.seen = []

    def forward(self, inputs):
        self.seen.append(inputs.clone())
        return inputs[:, FITTED] + self.nothing
