"""Surfaces from neighbouring frames, colours from all views; expectations are derived by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from geoevs.geometry import blending
from geoevs.geometry.blending import LEAST_ANGLE, MARGIN, TOLERANCE, BlendedViews, weigh
from geoevs.geometry.lifted import LiftedViews
from geoevs.methods.contract import Views
from geoevs.methods.tiny import CAR, MOUNT, STEP, tiny_camera, tiny_truth
from geoevs.projection import unproject_depth
from geoevs.scenes.camera import Camera

TARGET = tiny_camera("target", 15.0, MOUNT + np.array([0.2, 0.6, 0.0]))
DECLARED = ("lidar", "tracks")


class Driving(Views):
    """Views of a scene whose parked car is said to drive."""

    @property
    def tracks(self):
        return super().tracks.assign(moving=True)


def true_depths(views):
    return {
        frame: {name: tiny_truth(views.camera(name, frame)).depth for name in views.cameras}
        for frame in views.frames
    }


@pytest.fixture
def make(tiny):
    """Makes lifted views of the tiny scene by its true depth."""

    def lifted(kind=BlendedViews, views=Views):
        seen = views(tiny, tiny.cameras, DECLARED)
        return kind(seen, true_depths(seen))

    return lifted


def on_car(camera):
    """(H, W) bool: pixels whose true point lies on the car."""
    points, _ = unproject_depth(tiny_truth(camera).depth, camera)
    inside = (points > CAR[0] - 1e-3) & (points < CAR[1] + 1e-3)
    return inside.all(axis=1).reshape(camera.height, camera.width)


def error(raster):
    truth = tiny_truth(TARGET).rgb / 255.0
    return np.abs(raster.image - truth)[raster.mask].mean()


def test_by_true_depth_all_views_together_are_nearer_to_the_truth(make):
    alone, together = (make(kind).condition(TARGET, 0) for kind in (LiftedViews, BlendedViews))
    assert error(together) < 0.6 * error(alone) < 0.02
    assert (together.mask | ~alone.mask).all()
    truth = tiny_truth(TARGET).depth
    wrong = np.abs(together.depth / truth - 1) > 0.1
    assert wrong[together.mask].mean() < 0.02  # outlines of the car
    assert not together.image[~together.mask].any()
    assert not together.depth[~together.mask].any()


def test_a_source_view_comes_back_as_it_was(make):
    lifted = make()
    shown = lifted.condition(lifted.views.camera("front", 1), 1)
    assert shown.mask.all()
    apart = np.abs(shown.image - lifted.views.image("front", 1)).max(axis=2)
    assert np.median(apart) < 1e-3  # other views may say a little
    assert np.quantile(apart, 0.95) < 0.02


def test_a_view_on_the_ray_is_right_whatever_the_depth(make):
    """Wrong by a tenth everywhere: a metre aside the frame alone is off by pixels."""
    lifted = make()
    ahead = tiny_camera("ahead", 0.0, MOUNT + STEP)  # where the front camera is in frame 1
    for maps in lifted.depths.values():
        for name in maps:
            maps[name] = maps[name] * np.float32(1.1)
    alone = LiftedViews(lifted.views, lifted.depths).condition(ahead, 0)
    together = lifted.condition(ahead, 0)
    truth = tiny_truth(ahead).rgb / 255.0
    assert np.abs(together.image - truth).mean() < 0.25 * np.abs(alone.image - truth).mean()


@pytest.mark.parametrize("off", [0.0, 1.0, -2.0, 3.1])
def test_weights_by_hand(off):
    """A 3-4-5 triangle: the rays from (0, 0, 0) and (3, 0, 0) to (0, 0, 4) are 0.6 apart."""
    K = [[10.0, 0, 20], [0, 10, 20], [0, 0, 1]]
    aside = np.eye(4)
    aside[0, 3] = 3.0
    target, source = Camera(K, np.eye(4), 40, 40), Camera(K, aside, 40, 40)
    known = np.zeros((40, 40))
    known[20, 12] = 4 * (1 + off * TOLERANCE)  # u = 20 - 10 * 3 / 4 = 12.5
    points = np.array([[0.0, 0, 4], [0, 0, -4], [30, 0, 4], [1, 0, 4]])  # behind, outside, no depth
    seen, uv, weights = weigh(points, target, source, known)
    if abs(off) > 3:
        assert len(seen) == len(uv) == len(weights) == 0
        return
    np.testing.assert_array_equal(seen, [0])
    np.testing.assert_allclose(uv, [[12.5, 20.0]])
    # asin(0.6) would be the angle; its sine stands for it, as the two agree where it matters.
    np.testing.assert_allclose(weights, math.exp(-(off**2)) / (0.6 + LEAST_ANGLE) ** 2)


def test_what_moves_is_left_to_its_own_frame(make):
    driving, parked = make(views=Driving), make()
    camera, depth = driving.views.camera("front", 0), driving.depths[0]["front"]
    assert (driving.still[0]["front"][on_car(camera)] == 0).all()
    far = depth > CAR[1, 0] - camera.centre[0] + MARGIN
    np.testing.assert_array_equal(driving.still[0]["front"][far], depth[far])
    np.testing.assert_array_equal(parked.still[0]["front"], depth)
    for lifted in (driving, parked):
        lifted.images[1].update((name, image * 0) for name, image in lifted.images[1].items())
    truth = tiny_truth(TARGET)
    shown = [lifted.condition(TARGET, 0) for lifted in (driving, parked)]
    car = on_car(TARGET) & (np.abs(shown[0].depth / truth.depth - 1) < 0.01)
    apart = [np.abs(raster.image - truth.rgb / 255.0)[car].mean() for raster in shown]
    assert apart[0] < 0.02 < apart[1]  # the other frame's black is in it only where it is parked


def test_holes_are_filled_by_neighbours_and_by_nothing_else(make, monkeypatch):
    lifted = make()
    for name in lifted.views.cameras:
        lifted.depths[0][name] = np.zeros_like(lifted.depths[0][name])
    shown = lifted.condition(TARGET, 0)
    assert shown.mask.mean() > 0.9
    assert error(shown) < 0.02
    monkeypatch.setattr(blending, "NEIGHBOURS", 0)
    assert not lifted.condition(TARGET, 0).mask.any()


def test_the_surface_is_the_median_or_the_frames_own_or_the_nearest(monkeypatch):
    own = np.array([[4.0, 4.0, 4.0, 0.0, 0.0, 0.0]])
    others = {0: np.array([[5.0, 5.0, 0.0, 7.0, 0.0, 0.0]]), 2: np.array([[9.0, 9, 9, 6, 8, 0]])}
    moving = np.array([[False, True, False, False, False, False]])
    lifted = BlendedViews(SimpleNamespace(frames=(0, 1, 2, 3)), {})
    monkeypatch.setattr(BlendedViews, "_still_depth", lambda self, camera, frame: others[frame])
    surface = lifted._surface(own, moving, TARGET, 1)
    np.testing.assert_array_equal(surface, [[5.0, 4.0, 4.0, 6.0, 8.0, 0.0]])


def test_one_neighbour_fills_holes_and_moves_no_surface(monkeypatch):
    lifted = BlendedViews(SimpleNamespace(frames=(0, 1)), {})
    other = np.array([[9.0, 0.0, 7.0]])
    monkeypatch.setattr(BlendedViews, "_still_depth", lambda self, camera, frame: other)
    surface = lifted._surface(np.array([[4.0, 4.0, 0.0]]), np.zeros((1, 3), bool), TARGET, 0)
    np.testing.assert_array_equal(surface, [[4.0, 4.0, 7.0]])


def test_outside_what_is_kept_nothing_is_known(make):
    lifted = make()
    whole = lifted.condition(TARGET, 0)
    keep = np.zeros(whole.mask.shape, bool)
    keep[:, 20:40] = True
    part = lifted.condition(TARGET, 0, keep)
    for all_of_it, kept in zip(whole, part, strict=True):
        np.testing.assert_array_equal(kept[keep], all_of_it[keep])
        assert not kept[~keep].any()


def test_a_view_that_nothing_overlaps_is_empty(tiny):
    views = Views(tiny, ("front",), DECLARED)
    behind = tiny_camera("behind", 180.0, MOUNT)
    assert not BlendedViews(views, true_depths(views)).condition(behind, 0).mask.any()
