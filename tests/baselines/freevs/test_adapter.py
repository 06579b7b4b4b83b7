"""FreeVS as a method: the contract, its clips, and what it does without its inputs."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from baselines.freevs.adapter import Method
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_json
from geoevs.core.randomness import Rng
from geoevs.methods.check import contract_failures
from geoevs.methods.contract import Budget, Views
from geoevs.methods.tiny import STEP, write_tiny_scene
from geoevs.methods.trial import VIRTUAL
from geoevs.scenes.scene import PointCloud


@pytest.fixture
def fitted(trained, tmp_path):
    """Makes a method with options and fits it to the tiny scene, or to one that lacks something."""
    scene = write_tiny_scene(tmp_path / "scene")

    def fit(seed=0, views=None, **options):
        method = Method(str(trained), **options)
        views = views or Views(scene, scene.cameras, method.info.needs)
        method.report = method.fit(views, Budget(), Rng(seed, "fit"))
        return method

    fit.scene = scene
    return fit


def test_the_contract_is_kept(trained):
    assert contract_failures("freevs", weights=str(trained)) == []


def test_clips_end_with_the_scene(fitted):
    method = fitted()
    method._views = SimpleNamespace(frames=(4, 5, 6, 7))
    assert [method._clip(frame) for frame in (4, 5, 7)] == [[4, 4, 5], [4, 5, 6], [6, 7, 7]]


def test_a_clips_cameras_stand_still_on_the_vehicle(fitted):
    method = fitted()
    moved = method._moved(VIRTUAL, 1, 0)
    np.testing.assert_allclose(moved.centre, VIRTUAL.centre - STEP, atol=1e-6)
    np.testing.assert_allclose(moved.optical_axis, VIRTUAL.optical_axis, atol=1e-12)
    assert method._moved(VIRTUAL, 1, 1) is VIRTUAL


def test_support_and_depth_are_the_pseudo_images(fitted):
    method = fitted()
    shown, whole = method._sweeps.pseudo_image(VIRTUAL, 1), method.render(VIRTUAL, 1)
    np.testing.assert_array_equal(whole.support, shown.mask)
    np.testing.assert_array_equal(whole.depth, shown.depth)
    keep = np.ones(shown.mask.shape, bool)
    keep[:, 20:40] = False
    masked = method.render_masked(VIRTUAL, 1, keep)
    np.testing.assert_array_equal(masked.support, shown.mask & keep)
    assert np.abs(masked.rgb - whole.rgb)[~keep].max() > 0.01


def test_the_seed_and_the_options_decide_the_samples(fitted):
    first, again, other = (fitted(seed=seed).render(VIRTUAL, 1).rgb for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01
    for option in ({"steps": 3}, {"guidance": 2.0}, {"sigma_max": 5.0}, {"average": 2}):
        assert np.abs(first - fitted(**option).render(VIRTUAL, 1).rgb).max() > 0.001
    with pytest.raises(GeoEvsError, match=r"^sampling cannot have 0 for its option 'steps'"):
        fitted(steps=0)


def without(views, **changed):
    """Views whose scene lacks something."""
    made = SimpleNamespace(camera=views.camera, cameras=views.cameras, frames=views.frames)
    made.lidar, made.tracks, made.image = views.lidar, views.tracks, views.image
    for name, value in changed.items():
        setattr(made, name, value)
    return made


def test_a_scene_that_lacks_something_is_said_and_rendered(fitted):
    needs = Method.info.needs
    views = Views(fitted.scene, fitted.scene.cameras, needs)
    nothing = PointCloud.uncoloured(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    dark = fitted(views=without(views, lidar=lambda frame: nothing))
    assert "there are none: pictures are the prior's alone" in dark.report.note
    assert dark.report.primitives == 0
    still = fitted(views=without(views, tracks=views.tracks[:0]))
    assert still.report.note.endswith("no tracks: what moves is smeared")
    alone = fitted(views=without(views, frames=(1,)))
    assert alone.report.note.endswith("one frame: no neighbours' points, and its clip repeats it")
    assert "one frame" not in still.report.note
    for method in (dark, still, alone):
        rendering = method.render(VIRTUAL, 1)
        assert np.isfinite(rendering.rgb).all()
        assert (method is dark) == (not rendering.support.any())


def test_costs_count_points_and_weights(fitted):
    method = fitted()
    views = Views(fitted.scene, fitted.scene.cameras, method.info.needs)
    seen = sum(int((views.lidar(frame).camera >= 0).sum()) for frame in views.frames)
    assert method.report.primitives == seen > 1000
    networks = method._generator.autoencoder, method._generator.denoiser
    assert method.report.parameters == sum(p.numel() for n in networks for p in n.parameters())


def test_a_failed_training_is_the_reason(fitted, trained):
    write_json(trained / "failure.json", {"reason": "it diverged"})
    with pytest.raises(GeoEvsError, match=r"^its training failed: it diverged$"):
        fitted()


def test_points_that_score_are_never_shown(fitted):
    """Colouring them otherwise changes nothing."""
    scene = fitted.scene
    plain = fitted().render(VIRTUAL, 1).rgb
    points = scene.points
    scores = scene.info.rig.scores

    def poisoned(frame):
        cloud = points(frame)
        return dataclasses.replace(cloud, rgb=np.where(scores(cloud)[:, None], 1, cloud.rgb))

    object.__setattr__(scene, "points", poisoned)
    np.testing.assert_array_equal(fitted().render(VIRTUAL, 1).rgb, plain)
