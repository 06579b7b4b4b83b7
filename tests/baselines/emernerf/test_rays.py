"""Rays and motion of scenes whose truth is known."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch

from baselines.emernerf.rays import ERROR_CELL, TrainingRays, find_motion, find_place, pixel_rays
from geoevs.methods.contract import Views
from geoevs.methods.tiny import HEIGHT, MOUNT, ROOM, WIDTH, write_tiny_scene
from geoevs.projection import project_points
from geoevs.scenes.scene import TRACK_COLUMNS


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    scene = write_tiny_scene(tmp_path_factory.mktemp("scenes") / "tiny")
    return Views(scene, scene.cameras, ("lidar", "tracks"))


@pytest.fixture(scope="module")
def clouds(views):
    return {frame: views.lidar(frame).xyz for frame in views.frames}


@pytest.fixture(scope="module")
def place(views, clouds):
    return find_place(views, np.concatenate(list(clouds.values())))


@pytest.fixture(scope="module")
def rays(views, clouds, place):
    return TrainingRays.make(views, clouds, place)


def test_the_box_holds_the_room_and_reaches_up_20_metres(place):
    low, high = place.centre - place.half, place.centre + place.half
    np.testing.assert_allclose(low, ROOM[0], atol=0.5)
    np.testing.assert_allclose(high[:2], ROOM[1, :2], atol=0.5)
    assert high[2] == pytest.approx(low[2] + 20)


def test_without_lidar_the_box_lies_around_the_cameras(views):
    place = find_place(views, np.zeros((0, 3)))
    np.testing.assert_allclose(place.centre, np.add(MOUNT, [0.25, 0, 0]))
    np.testing.assert_allclose(place.half, [40.25, 40, 10])


def test_times_run_from_0_to_1_and_stop_there(place):
    assert [place.time(frame) for frame in (-1, 0, 1, 5)] == [0, 0, 1, 1]
    long = place._replace(first=3, last=11)
    assert long.time(5) == 0.25
    assert long.step == 0.125


def test_pixels_rays_go_through_their_pixels(views, place):
    camera = views.camera("left", 1)
    uv = np.array([[0.5, 0.5], [10.5, 40.5], [WIDTH - 0.5, 3.5]])
    origins, directions = pixel_rays(camera, uv, place)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-6)
    again, depth = project_points(origins + 7.0 * directions + place.centre, camera)
    np.testing.assert_allclose(again, uv, atol=1e-4)
    assert (depth > 0).all()


def test_training_rays_have_the_colours_of_their_pixels(views, rays, place):
    batch, rgb, _, _ = rays.pixels(200, torch.Generator().manual_seed(0))
    names = [(name, frame) for frame in views.frames for name in views.cameras]
    for i in range(0, 200, 9):
        name, frame = names[batch.images[i]]
        point = (batch.origins[i] + 5 * batch.directions[i]).double().numpy() + place.centre
        uv, _ = project_points(point[None], views.camera(name, frame))
        np.testing.assert_allclose(uv % 1, 0.5, atol=1e-3)  # a pixel's centre
        column, row = uv[0].astype(int)
        np.testing.assert_allclose(rgb[i], views.image(name, frame)[row, column], atol=1e-6)
        assert batch.times[i] == frame


def test_half_of_the_pixels_are_where_errors_were_largest(rays):
    generator = torch.Generator().manual_seed(0)
    wrong = dataclasses.replace(rays, errors=torch.zeros_like(rays.errors))
    cell = torch.tensor([3 * rays.errors[0].numel() + 4])  # the 4th image, first row, 5th column
    wrong.learn_errors(cell, torch.tensor([0.5]))
    assert wrong.errors[3, 0, 4] == 0.25  # the mean of now and before
    batch = wrong.pixels(4000, generator)
    assert (batch.rays.images == 3).float().mean() == pytest.approx(0.5 + 0.5 / 6, abs=0.03)
    there = batch.cell == cell
    assert there.float().mean() == pytest.approx(0.5 + 0.5 / wrong.errors.numel(), abs=0.01)
    camera = views_uv(batch.rays, wrong, there)
    assert (camera >= torch.tensor([4 * ERROR_CELL, 0])).all()
    assert (camera <= torch.tensor([5 * ERROR_CELL, ERROR_CELL])).all()
    assert len(camera.round(decimals=3).unique(dim=0)) == ERROR_CELL**2


def views_uv(batch, rays, chosen):
    """Pixels that rays of the 4th image go through."""
    ahead = batch.directions[chosen] @ rays.rotations[3]
    focal, middle = rays.intrinsics[3].split(2)
    return ahead[:, :2] / ahead[:, 2:] * focal + middle


def test_measured_rays_end_at_lidar_points_that_their_camera_sees(views, clouds, rays, place):
    batch, ranges = rays.measured(100, torch.Generator().manual_seed(0))
    ends = (batch.origins + ranges[:, None] * batch.directions).numpy() + place.centre
    names = [(name, frame) for frame in views.frames for name in views.cameras]
    for i in range(100):
        name, frame = names[batch.images[i]]
        assert np.linalg.norm(clouds[frame] - ends[i], axis=1).min() < 1e-4
        uv, _ = project_points(ends[i][None], views.camera(name, frame))
        assert (uv >= 0).all()
        assert (uv <= [WIDTH, HEIGHT]).all()


STATIC = "static scene: no dynamic field"


def boxes(*rows):
    return pd.DataFrame(rows, columns=list(TRACK_COLUMNS))


@pytest.mark.parametrize(
    ("tracks", "reason"),
    [
        (boxes(), "no tracks: a dynamic field in case something moves"),
        (boxes((0, "a", "car", 5, 0, 1, 4, 2, 2, 0.0, False)), STATIC),
        (boxes((0, "a", "car", 5, 0, 1, 4, 2, 2, 0.0, True)), ""),
        # 2 m ahead of the point at x = 5, it holds it only when it stands across.
        (boxes((0, "a", "car", 7, 0, 1, 2, 6, 2, 0.0, True)), STATIC),
        (boxes((0, "a", "car", 7, 0, 1, 2, 6, 2, 90.0, True)), ""),
        (boxes((0, "a", "car", 5, 0, 9, 4, 2, 2, 0.0, True)), STATIC),
    ],
    ids=["no tracks", "parked", "moving", "unseen", "turned", "above"],
)
def test_a_dynamic_field_is_for_moving_boxes_with_points(tracks, reason):
    clouds = {0: np.array([[5.0, 0, 1]]), 1: np.zeros((0, 3))}
    assert find_motion(two_frames(tracks), clouds) == (reason != STATIC, reason)


def two_frames(tracks):
    return SimpleNamespace(frames=(0, 1), tracks=tracks.astype({"moving": bool}))


def car(frame, moving=True, track="a"):
    return frame, track, "car", 5 + frame, 0, 1, 4, 2, 2, 0.0, moving


@pytest.mark.parametrize(
    ("tracks", "reason"),
    [
        (boxes(car(0), car(1)), ""),
        (boxes(car(0), car(1, track="b")), STATIC),
        (boxes(car(0), car(0), car(2)), STATIC),
        (boxes(car(0, moving=False), car(1, moving=False)), STATIC),
        (boxes(), "no tracks: a dynamic field in case something moves"),
    ],
    ids=["moving", "two cars in one frame each", "another frame", "parked", "no tracks"],
)
def test_without_any_lidar_the_tracks_alone_tell_what_moves(tracks, reason):
    clouds = {0: np.zeros((0, 3)), 1: np.zeros((0, 3))}
    assert find_motion(two_frames(tracks), clouds) == (reason != STATIC, reason)


def test_nothing_moves_in_one_frame():
    class OneFrame:
        frames = (7,)

    assert find_motion(OneFrame(), {}) == (False, "one frame: no dynamic field")
