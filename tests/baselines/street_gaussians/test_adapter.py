"""The method as the protocol meets it, and its actors against truth."""

import numpy as np
import pytest
import torch

from baselines.street_gaussians import losses
from geoevs.core.errors import GeoEvsError
from geoevs.core.randomness import Rng
from geoevs.methods import tiny as room
from geoevs.methods.check import contract_failures
from geoevs.methods.contract import Budget, Views
from geoevs.methods.finding import make_method

STEP = -0.9  # metres along y a frame


def fit(scene, steps=20, **options):
    method = make_method("street-gaussians", {"iterations": steps, "gaussians": 400, **options})
    views = Views(scene, scene.cameras, method.info.needs)
    return method, method.fit(views, Budget(), Rng(0))


def test_contract():
    assert contract_failures("street-gaussians", iterations=20, gaussians=300) == []


def is_red(rgb):
    """Where the car's tint is: the room is never so."""
    return rgb[..., 0] - rgb[..., 1] > 0.3


def overlap(one, other):
    return np.count_nonzero(one & other) / np.count_nonzero(one | other)


def test_an_actor_moved_along_its_track_moves_in_the_picture(moving, truth_with_car):
    method, report = fit(moving, steps=300, gaussians=600)
    assert "1 actors" in report.note
    camera = room.tiny_camera("virtual", 0.0, room.MOUNT)
    for frame in range(4):
        assert overlap(is_red(method.render(camera, frame).rgb), truth_with_car(frame)[1]) > 0.7
    # To where it never was, half-way between two frames and beyond the last one.
    (actor,) = method._graph.actors
    for place in (1.5, 3.6):
        actor.centres[1] = actor.centres[0] + torch.tensor([0.0, place * STEP, 0.0])
        picture = method.render(camera, 1).rgb
        truth, car = truth_with_car(place)
        assert overlap(is_red(picture), car) > 0.7
        assert abs(picture - truth).mean() < 0.05


def test_a_moving_scene_is_the_same_after_reload(moving, tmp_path):
    method, _ = fit(moving)
    method.save(tmp_path)
    again = type(method).load(tmp_path)
    camera = room.tiny_camera("virtual", 20.0, room.MOUNT)
    one, other = method.render(camera, 2), again.render(camera, 2)
    np.testing.assert_array_equal(one.rgb, other.rgb)
    np.testing.assert_array_equal(one.depth, other.depth)
    assert not np.array_equal(one.rgb, method.render(camera, 0).rgb)


def test_what_stands_still_is_no_actor(write_room, boxes):
    method, report = fit(write_room(boxes(moving=False)))
    assert method._graph.actors == []
    assert report.note.endswith("no actor nodes")
    method, report = fit(write_room(boxes()[:0]))
    assert method._graph.actors == []


def test_the_road_is_left_and_the_car_taken_from_the_background(moving):
    method, _ = fit(moving, steps=1)
    xyz = method._graph.background.gaussians.means.detach().numpy()
    low, high = room.CAR + np.array([[0.05, 0.05, 0.15], [-0.05, -0.05, -0.05]])
    assert not ((xyz > low) & (xyz < high)).all(axis=1).any()


def test_without_lidar_it_starts_elsewhere(write_room, boxes):
    method, report = fit(write_room(boxes(), lidar=False))
    assert "0 LiDAR points, too few" in report.note
    assert "1 actors" in report.note
    assert np.isfinite(method.render(room.tiny_camera("front", 0.0, room.MOUNT), 0).rgb).all()


@pytest.mark.parametrize("guilty", ["shifts of actor car-0", "sh0 of actor car-0"])
def test_a_broken_gradient_of_an_actor_names_it(moving, monkeypatch, guilty):
    real = losses.street_loss

    def broken(graph, photo, drawn, done):
        (actor,) = graph.actors
        value = actor.shifts if "shifts" in guilty else actor.gaussians.sh0
        return real(graph, photo, drawn, done) + value.sum() * (np.nan if done >= 0.5 else 0.0)

    monkeypatch.setattr(losses, "street_loss", broken)
    with pytest.raises(GeoEvsError, match=f"gradient of {guilty} is not finite at step 10;"):
        fit(moving)
