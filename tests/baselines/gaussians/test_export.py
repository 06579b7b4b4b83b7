"""What is exported of a scene draws the pictures that the scene draws."""

import numpy as np
import pytest
import torch

from baselines.gaussians.constants import SH_C0
from baselines.gaussians.export import SKY_COUNT, SKY_RADIUS, scene_splats
from baselines.gaussians.nodes import FOURIER, Actor, Background, SceneGraph, Sky
from baselines.gaussians.rasterizer import rasterize_gaussians
from geoevs.methods.tiny import tiny_camera
from geoevs.scenes.splats import write_splats_ply

CAMERA = tiny_camera("front", 10.0, np.array([-6.0, 0.0, 0.0]))
FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")


@pytest.fixture
def graph(make_gaussians, generator):
    car = make_gaussians([0.3, 0.5, 0.9], scale=0.3)
    car.sh0 = torch.randn(3, FOURIER, 3, generator=generator)
    track = {
        "size": torch.tensor([4.0, 2.0, 1.5]),
        "centres": torch.tensor([[0.0, 1.0, 0.0], [3.0, 1.0, 0.0]]),
        "yaws": torch.tensor([0.2, 0.9]),
        "shifts": torch.full((2, 3), 0.1),
        "turns": torch.tensor([0.0, 0.1]),
    }
    background = Background(make_gaussians([0.4, 0.6, 0.8, 0.9], scale=0.3))
    return SceneGraph(background, [Actor("actor car", car, (2, 3), **track)])


def draw(means, quats, log_scales, logit_opacities, sh):
    tensors = [*map(torch.from_numpy, (means, quats, log_scales, logit_opacities, sh))]
    tensors[2], tensors[3] = tensors[2].exp(), tensors[3].sigmoid()
    return rasterize_gaussians(*tensors, CAMERA).rgb.numpy()


def read_ply(path):
    """The Gaussians of a file as arrays, by the names of its own header."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    names = [line.split()[-1] for line in head.decode().splitlines() if "property" in line]
    table = np.frombuffer(body, [(name, "<f4") for name in names])

    def columns(*names):
        return np.stack([table[name] for name in names], axis=-1)

    colours = [[f"f_dc_{c}", *(f"f_rest_{3 * c + k}" for k in range(3))] for c in range(3)]
    return (
        columns(*"xyz"),
        columns(*(f"rot_{i}" for i in range(4))),
        columns(*(f"scale_{i}" for i in range(3))),
        table["opacity"].copy(),
        np.stack([columns(*one) for one in colours], axis=-1),
    )


@pytest.mark.parametrize("frame", [1, 2, 3])  # in the first the car is not there
def test_a_file_draws_the_pictures_of_its_frame(graph, frame, tmp_path):
    splats = scene_splats(graph, frame)
    assert splats.sky is None
    assert len(splats) == (4 if frame == 1 else 7)
    write_splats_ply(tmp_path / "a.ply", splats)
    with torch.no_grad():
        own = graph.draw(CAMERA, frame).picture.rgb.numpy()
    assert own.max() > 0.2
    np.testing.assert_allclose(draw(*read_ply(tmp_path / "a.ply")), own, rtol=0, atol=1e-6)


def test_the_sky_is_a_shell_that_looks_like_it(graph):
    x = torch.linspace(0, 2 * torch.pi, 65)[:-1]
    waves = torch.stack([x.sin(), x.cos(), torch.zeros(64)]) * 0.3 + 0.5  # [3, azimuth]
    graph.sky = Sky(waves[:, None].repeat(1, 32, 1))
    splats = scene_splats(graph, 2)
    shell = splats.sky
    middle = np.median(splats.means, axis=0)
    assert len(shell) == SKY_COUNT
    assert np.linalg.norm(shell.means - middle, axis=1) == pytest.approx(SKY_RADIUS)
    # A camera of the scene sees behind it what it saw: no gap, the same colours.
    padded = np.concatenate([shell.sh, np.zeros((SKY_COUNT, 3, 3), np.float32)], axis=1)
    parts = [getattr(shell, name) for name in FIELDS[:-1]] + [padded]
    both = [
        np.concatenate([getattr(splats, name), part])
        for name, part in zip(FIELDS, parts, strict=True)
    ]
    with torch.no_grad():
        own = graph.draw(CAMERA, 2).picture.rgb.numpy()
    assert np.abs(draw(*both) - own).max() < 0.02
    colour = draw(*parts)
    ahead = graph.sky.towards(CAMERA.optical_axis[None]).numpy()
    np.testing.assert_allclose(colour[24, 36], ahead[0], atol=0.01)


def test_the_sky_is_the_same_towards_a_pixel_as_in_it(graph, generator):
    sky = Sky(torch.rand(3, 8, 16, generator=generator))
    rows, columns = np.mgrid[:48, :72] + 0.5
    pixels = np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size)])
    rays = CAMERA.world_from_camera[:3, :3] @ np.linalg.solve(CAMERA.K, pixels)
    seen = sky.seen(CAMERA).reshape(-1, 3)
    torch.testing.assert_close(sky.towards(3 * rays.T), seen, rtol=0, atol=1e-5)
    shell = scene_splats(SceneGraph(graph.background, (), sky), 0).sky
    directions = shell.means - np.median(graph.background.gaussians.means.numpy(), axis=0)
    colours = sky.towards(directions.astype(np.float64)).numpy()
    np.testing.assert_allclose(0.5 + SH_C0 * shell.sh[:, 0], colours, atol=1e-3)
