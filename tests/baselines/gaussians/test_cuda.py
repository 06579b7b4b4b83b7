"""On a GPU gsplat draws what our kernels draw, and training goes on there."""

import importlib.util
import math

import numpy as np
import pytest
import torch

from baselines.gaussians.initialisation import starting_points
from baselines.gaussians.model import gaussians_from_points
from baselines.gaussians.nodes import Background, SceneGraph, Sky
from baselines.gaussians.rasterizer import blending_weights, rasterize_gaussians
from baselines.gaussians.size import HELD_OUT, psnr
from baselines.gaussians.training import Trainer, make_strategy, photos_of, train
from geoevs.methods.check import contract_failures
from geoevs.methods.tiny import tiny_camera

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not importlib.util.find_spec("gsplat"), reason="gsplat is not installed"),
]
CAMERA = tiny_camera("front", 20.0, np.array([0.0, 0.0, 1.6]))


def random_gaussians(count=400):
    """In front of the camera and around it, some behind."""
    draw = torch.Generator().manual_seed(0)
    ahead = torch.rand(count, generator=draw) * 12 - 1
    aside = torch.randn(count, 2, generator=draw)
    along, left = torch.tensor([[0.94, 0.34], [-0.34, 0.94]])
    ground = ahead[:, None] * along + aside[:, :1] * left
    return (
        torch.column_stack([ground, 1.6 + aside[:, 1]]),
        torch.randn(count, 4, generator=draw),
        torch.exp(torch.randn(count, 3, generator=draw) * 0.6 - 2),
        torch.rand(count, generator=draw),
        torch.randn(count, 4, 3, generator=draw) * 0.5,
    )


def drawn_on(device):
    """Pictures, gradients and footprints of random Gaussians, on the CPU again."""
    leaves = [part.to(device).requires_grad_() for part in random_gaussians()]
    background = torch.tensor([0.2, 0.5, 0.8], device=device)
    drawn = rasterize_gaussians(*leaves, CAMERA, background)
    draw = torch.Generator().manual_seed(1)
    sum((p * torch.randn(p.shape, generator=draw).to(device)).sum() for p in drawn[:3]).backward()
    grads = [leaf.grad.cpu() for leaf in leaves] + [drawn.footprints.means2d_grad.cpu()]
    pictures = [picture.detach().cpu() for picture in drawn[:3]]
    return pictures, grads, drawn.footprints.radii.cpu()


def test_gsplat_draws_our_pictures_and_has_our_gradients():
    (pictures, grads, radii), (twins, twin_grads, twin_radii) = drawn_on("cuda"), drawn_on("cpu")
    for picture, twin in zip(pictures, twins, strict=True):
        torch.testing.assert_close(picture, twin, rtol=1e-3, atol=1e-3)
    for grad, twin in zip(grads, twin_grads, strict=True):
        assert (grad - twin).norm() <= 1e-2 * twin.norm()
    shown = twin_radii > 0
    assert ((radii > 0) == shown).float().mean() > 0.99
    assert (radii - twin_radii)[shown].abs().max() <= 2  # gsplat's are whole pixels


def test_blending_weights_are_the_same():
    gaussians = random_gaussians()[:4]
    found = blending_weights(*(part.cuda() for part in gaussians), CAMERA).cpu()
    torch.testing.assert_close(found, blending_weights(*gaussians, CAMERA), rtol=1e-2, atol=1e-2)


@pytest.mark.parametrize("densification", ["mcmc", "gradient"])
def test_training_makes_the_views_right(views_of_wall, densification):
    aside = [(0.0, 0.25 * frame, 1.6) for frame in range(HELD_OUT)]
    views = views_of_wall(aside, needs=("lidar",))
    photos, steps = photos_of(views, "cuda"), 120
    points = starting_points(views, 1000, np.random.default_rng(0), "lidar")
    made = gaussians_from_points(points.xyz, points.rgb, 1).to("cuda")
    graph = SceneGraph(Background(made))
    graph.sky = Sky(torch.full((3, 4, 8), 0.5, device="cuda"))
    strategy = make_strategy(densification, 1200, steps)
    draw = torch.Generator().manual_seed(0)
    trainer = Trainer(graph, steps, {"background": 5.0}, strategy, lambda *_: 0.0, draw)
    before = psnr(graph, photos)
    train(trainer, photos, None, math.inf, draw, lambda loss, more: None)
    assert psnr(graph, photos) > before + 3
    assert graph.background.gaussians.means.is_cuda
    assert len(graph) > 1000


@pytest.mark.parametrize("name", ["three-dgs", "street-gaussians"])
def test_contract(name):
    assert contract_failures(name, iterations=20, gaussians=300) == []
