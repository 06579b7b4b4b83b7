"""On a GPU the fields are the same functions, by torch ops and by tiny-cuda-nn."""

import numpy as np
import pytest
import torch

from baselines.emernerf import hash_grid
from baselines.emernerf.hash_grid import HashGrid
from baselines.emernerf.tcnn_backend import tcnn_installed
from geoevs.core import networks
from geoevs.core.randomness import Rng
from geoevs.methods.check import contract_failures
from geoevs.methods.contract import Budget, Views
from geoevs.methods.finding import make_method
from geoevs.methods.tiny import write_tiny_scene

pytestmark = pytest.mark.cuda
SMALL = {"rays": 64, "levels": 4, "log2_entries": 8, "width": 8, "samples": (8, 4, 4)}


@pytest.mark.parametrize("tcnn", [False, True], ids=["torch", "tiny-cuda-nn"])
@pytest.mark.parametrize(
    ("dims", "levels", "finest"), [(3, 8, 4096), (4, 4, 128)], ids=["static", "dynamic"]
)
def test_encoding_and_both_gradients_are_the_cpus(dims, levels, finest, tcnn, monkeypatch):
    if tcnn and not tcnn_installed():
        pytest.skip("tiny-cuda-nn is not installed")
    monkeypatch.setattr(hash_grid, "tcnn_installed", lambda: tcnn)
    draw = torch.Generator().manual_seed(0)
    grid = HashGrid(dims, levels, 16, finest, 17, draw)
    with torch.no_grad():
        grid.table.copy_(torch.randn(grid.table.shape, generator=draw))
    positions = torch.rand(5000, dims, generator=draw)
    positions[:64] = positions[:64].round()  # corners of the cube
    slopes = torch.randn(5000, grid.out_features, generator=draw)
    found = {}
    for device in ("cpu", "cuda"):
        grid.to(device).zero_grad()
        places = positions.to(device).requires_grad_()
        features = grid(places)
        features.backward(slopes.to(device))
        found[device] = [x.cpu() for x in (features.detach(), grid.table.grad, places.grad)]
    # A float32 position is off by 6e-8 of the cube, which is `finest` times as much of a cell.
    near = 1e-4 + 4e-7 * finest
    (here, table, moved), (there, its_table, its_moved) = found["cpu"], found["cuda"]
    torch.testing.assert_close(there, here, atol=near, rtol=1e-3)
    torch.testing.assert_close(its_table, table, atol=10 * near, rtol=1e-3)
    # At a cell's border, where rounding decides the side, the slope jumps.
    assert (its_moved - moved)[64:].norm(dim=1).gt(
        0.01 * moved[64:].norm(dim=1)
    ).float().mean() < 0.02


def test_a_fit_learns_and_its_field_renders_the_same_on_the_cpu(tmp_path, monkeypatch):
    scene = write_tiny_scene(tmp_path / "scene")
    method = make_method("emernerf", {**SMALL, "iterations": 60})
    views = Views(scene, scene.cameras, method.info.needs)
    method.fit(views, Budget(), Rng(0))
    camera = scene.camera("front", 0)
    shown = method.render(camera, 0)
    assert np.abs(shown.rgb - scene.image("front", 0)).mean() < 0.15
    method.save(tmp_path)
    monkeypatch.setattr(networks, "best_device", lambda: "cpu")
    again = type(method).load(tmp_path)
    assert next(again._model.parameters()).device.type == "cpu"
    assert np.abs(shown.rgb - again.render(camera, 0).rgb).max() < 0.02


def test_contract():
    assert contract_failures("emernerf", iterations=4, **SMALL) == []
