"""Nodes of a scene: where actors are, what turns with them, the sky, and files."""

import math

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from baselines.gaussians.nodes import FOURIER, Actor, Background, SceneGraph, Sky
from baselines.gaussians.rasterizer import rasterize_gaussians
from baselines.gaussians.reference import shade
from baselines.gaussians.rotations import rotation_matrices
from baselines.gaussians.storage import scene_arrays, scene_from_arrays
from geoevs.core.files import read_arrays, write_arrays
from geoevs.methods.tiny import tiny_camera

FRAMES = (2, 3, 6)
YAW, CENTRE = 0.7, [1.0, -2.0, 0.5]
AHEAD = tiny_camera("front", 0.0, np.zeros(3))  # along the world's x


@pytest.fixture
def actor(make_gaussians, generator):
    gaussians = make_gaussians([0.3, 0.5, 0.9])
    gaussians.sh0 = torch.randn(3, FOURIER, 3, generator=generator)
    return Actor(
        "actor car-1",
        gaussians,
        FRAMES,
        size=torch.tensor([4.0, 2.0, 1.5]),
        centres=torch.tensor([[0.0, 0.0, 0.0], CENTRE, [9.0, 0.0, 0.0]]),
        yaws=torch.tensor([0.0, YAW, 0.0]),
        shifts=torch.zeros(3, 3),
        turns=torch.zeros(3),
    )


@pytest.fixture
def graph(actor, make_gaussians, generator):
    sky = Sky(torch.rand(3, 8, 16, generator=generator))
    return SceneGraph(Background(make_gaussians([0.4, 0.6])), [actor], sky)


def turn(yaw):
    c, s = math.cos(yaw), math.sin(yaw)
    return torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def test_an_actor_is_where_its_box_is(actor):
    placed = actor.placed(3)
    local = actor.gaussians
    expected = local.means @ turn(YAW).T + torch.tensor(CENTRE)
    torch.testing.assert_close(placed.means, expected)
    rotations = rotation_matrices(placed.quats)
    torch.testing.assert_close(rotations, turn(YAW) @ rotation_matrices(local.quats))


def test_corrections_add_to_the_box(actor):
    before = actor.placed(3).means
    actor.shifts[1] = torch.tensor([0.1, 0.2, 0.3])
    torch.testing.assert_close(actor.placed(3).means, before + actor.shifts[1])
    actor.turns[1], actor.shifts[1] = -YAW, 0.0
    torch.testing.assert_close(actor.placed(3).means, actor.gaussians.means + torch.tensor(CENTRE))


def test_colours_turn_with_the_actor(actor, generator):
    rays = torch.randn(3, 3, generator=generator)
    still = torch.cat([actor.placed(3).sh[:, :1], actor.gaussians.sh_rest], dim=1)
    turned = shade(rays @ turn(YAW).T, actor.placed(3).sh)
    torch.testing.assert_close(turned, shade(rays, still))


def test_colours_change_over_time_as_published(actor):
    # At times 0, 1/4 and 1: 1, sin 2pi t, cos 2pi t, sin 4pi t, cos 4pi t, by Street Gaussians'
    # code with pi for 2pi, so that the first and the last frame differ.
    waves = {2: [1, 0, 1, 0, 1], 3: [1, 1, 0, 0, -1], 6: [1, 0, 1, 0, 1]}
    for frame, factors in waves.items():
        expected = (torch.tensor(factors)[:, None] * actor.gaussians.sh0).sum(1)
        torch.testing.assert_close(actor.placed(frame).sh[:, 0], expected, atol=1e-5, rtol=0)


def test_gaussians_stay_in_the_box(actor):
    actor.gaussians.means[0] = torch.tensor([9.0, -0.5, -9.0])
    kept = actor.gaussians.means[1].clamp(-0.75, 0.75)
    actor.gaussians.means[1] = kept
    actor.confine()
    assert actor.gaussians.means[0].tolist() == [2.0, -0.5, -0.75]
    assert torch.equal(actor.gaussians.means[1], kept)


def test_the_track_learns_from_the_picture(graph):
    actor = graph.actors[0]
    actor.gaussians.means = actor.gaussians.means.clamp(-0.5, 0.5)
    actor.centres = torch.tensor([[6.0, 0.0, 0.0]] * 3)
    actor.shifts.requires_grad_()
    actor.turns.requires_grad_()
    weights = torch.linspace(-1, 1, 72).double()[:, None]  # of columns: where it is across

    def value():
        return (graph.draw(AHEAD, 3).picture.rgb.double() * weights).sum()

    value().backward()
    for tensor, place in ((actor.shifts, (1, 1)), (actor.turns, (1,))):
        step, moved = 0.02, []
        for sign in (1, -1):
            with torch.no_grad():
                tensor[place] += sign * step
                moved.append(value().item())
                tensor[place] -= sign * step
        assert tensor.grad[place].item() == pytest.approx((moved[0] - moved[1]) / 2 / step, rel=0.1)
    assert actor.shifts.grad[0].tolist() == [0, 0, 0]


def test_rows_are_told_apart(graph):
    drawn = graph.draw(AHEAD, 3)
    assert drawn.rows == {"background": slice(0, 2), "actor car-1": slice(2, 5)}
    assert list(graph.draw(AHEAD, 4).rows) == ["background"]
    radii = drawn.picture.footprints.radii
    assert torch.equal(drawn.footprints("actor car-1").radii, radii[2:])
    assert len(graph) == 5
    assert graph.parameters() == 2 * (3 + 4 + 3 + 1 + 12) + 3 * (11 + 15 + 9) + 3 * 4 + 3 * 8 * 16


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    distance=st.floats(4, 40),
    azimuth=st.floats(-180, 180),
    height=st.floats(-4, 4),
    scale=st.floats(0.01, 0.2),
)
def test_actors_are_left_out_only_where_they_do_not_show(
    make_gaussians, distance, azimuth, height, scale
):
    angle = math.radians(azimuth)
    place = torch.tensor([[distance * math.cos(angle), distance * math.sin(angle), height]])
    gaussians = make_gaussians([0.5, 0.9, 0.98], scale)
    size, zero = torch.tensor([6.0, 6.0, 6.0]), torch.zeros(1)
    actor = Actor("car", gaussians, (0,), size, place, zero, torch.zeros(1, 3), zero)
    actor.confine()
    if rasterize_gaussians(*actor.placed(0), AHEAD).opacity.any():
        assert actor.reaches(AHEAD, 0)
    if abs(azimuth) > 135 and distance > 10:
        assert not actor.reaches(AHEAD, 0)
    assert not actor.reaches(AHEAD, 1)


@pytest.mark.parametrize("yaw", [0.0, 90.0, 180.0, -135.0])
def test_the_sky_is_seen_where_it_lies(yaw):
    columns, rows = 360, 180
    # Its colour is its own azimuth and elevation, the azimuth as cosine and sine.
    azimuth = np.radians((np.arange(columns) + 0.5) * 360 / columns - 180)
    elevation = np.radians(90 - (np.arange(rows) + 0.5) * 180 / rows)
    planes = np.broadcast_arrays(np.cos(azimuth), np.sin(azimuth), elevation[:, None])
    sky = Sky(torch.tensor(np.stack(planes), dtype=torch.float32))
    seen = sky.seen(tiny_camera("virtual", yaw, np.ones(3))).numpy()
    rows, columns = np.mgrid[:48, :72] + 0.5
    right, up = (columns - 36) / 70, (24 - rows) / 70
    heading = np.radians(yaw) - np.arctan2(right, 1)
    expected = [np.cos(heading), np.sin(heading), np.arctan2(up, np.hypot(right, 1))]
    np.testing.assert_allclose(seen, np.stack(expected, axis=-1), atol=2e-3)


def test_the_sky_fills_what_gaussians_leave(graph):
    picture = graph.draw(AHEAD, 4).picture
    alone = SceneGraph(graph.background).draw(AHEAD, 4).picture
    behind = (1 - alone.opacity)[..., None] * graph.sky.seen(AHEAD)
    torch.testing.assert_close(picture.rgb, alone.rgb + behind)


@pytest.mark.parametrize("whole", [True, False])
def test_a_scene_comes_back_from_its_file(graph, tmp_path, whole):
    if not whole:
        graph = SceneGraph(graph.background)
    write_arrays(tmp_path / "scene.npz", scene_arrays(graph))
    again = scene_from_arrays(read_arrays(tmp_path / "scene.npz"), "cpu")
    assert [node.name for node in again.nodes()] == [node.name for node in graph.nodes()]
    for frame in (3, 4):
        assert torch.equal(
            again.draw(AHEAD, frame).picture.rgb, graph.draw(AHEAD, frame).picture.rgb
        )
