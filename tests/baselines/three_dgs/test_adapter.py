"""The method as the protocol meets it."""

import numpy as np
import pytest

from baselines.gaussians import size
from baselines.gaussians.options import FEWEST, STRATEGIES
from geoevs.core.errors import GeoEvsError
from geoevs.core.randomness import Rng
from geoevs.methods.check import contract_failures
from geoevs.methods.contract import Budget, Views
from geoevs.methods.finding import make_method
from geoevs.methods.tiny import write_tiny_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("tiny") / "scene")


def fit(scene, cameras=("front", "left", "right"), seconds=None, **options):
    method = make_method("three-dgs", {"iterations": 20, **options})
    views = Views(scene, cameras, method.info.needs)
    return method, method.fit(views, Budget(seconds), Rng(0))


def test_contract():
    assert contract_failures("three-dgs", iterations=20, gaussians=300) == []


def test_the_note_says_where_it_starts(scene):
    # The tiny room is too smooth for features.
    _, report = fit(scene, gaussians=300)
    assert report.note.startswith("starts from 225 of")
    assert "LiDAR points; 0 points of SfM, too few; 75 far ones" in report.note
    assert report.primitives == 300
    assert report.parameters == 300 * 23


def test_depth_is_only_where_something_is(scene):
    method, _ = fit(scene)
    method._graph.background.gaussians.logit_opacities.data[:] = -8.0
    rendering = method.render(scene.camera("front", 0), 0)
    assert not rendering.depth.any()


def test_two_images_are_enough_but_choose_no_size(scene):
    method, report = fit(scene, cameras=("front",))
    assert "2 views are too few to choose a size by" in report.note
    assert np.isfinite(method.render(scene.camera("left", 0), 0).rgb).all()


def test_a_size_is_chosen_from_as_many_points_as_the_largest(scene, monkeypatch):
    monkeypatch.setattr(size, "HELD_OUT", 2)
    monkeypatch.setattr(size, "MOST", 400)
    _, report = fit(scene, seconds=0.0)
    assert report.note.startswith("starts from 300 of")
    assert "too few to choose" not in report.note


def test_a_spent_budget_still_leaves_a_scene(scene):
    method, report = fit(scene, seconds=0.0)
    assert "0 of 20 iterations in the budget" in report.note
    assert method.render(scene.camera("front", 0), 0).rgb.shape == (48, 72, 3)


def test_steps_are_as_many_as_the_photographs_ask_for(scene):
    _, one = fit(scene, seconds=0.0, iterations=None, cameras=("front",))
    _, both = fit(scene, seconds=0.0, iterations=None, cameras=("front", "left"))
    photographs = len(scene.frames)
    assert f"0 of {62 * photographs} iterations" in one.note
    assert f"0 of {124 * photographs} iterations" in both.note


@pytest.mark.parametrize(("option", "least"), [("iterations", 1), ("gaussians", FEWEST)])
def test_bad_options_are_one_sentence(option, least):
    sentence = f"cannot have {least - 1} for its option '{option}'; make it {least} or more$"
    with pytest.raises(GeoEvsError, match=sentence):
        make_method("three-dgs", {option: least - 1})


@pytest.mark.parametrize("name", ["three-dgs", "street-gaussians"])
@pytest.mark.parametrize("densification", STRATEGIES)
def test_the_fewest_gaussians_are_enough(scene, name, densification):
    options = {"iterations": 40, "gaussians": FEWEST, "densification": densification}
    method = make_method(name, options)
    views = Views(scene, ("front", "left", "right"), method.info.needs)
    assert method.fit(views, Budget(), Rng(0)).primitives >= FEWEST - 10
    assert np.isfinite(method.render(scene.camera("front", 0), 0).rgb).all()


def test_an_unknown_densification_is_one_sentence_before_a_fit():
    with pytest.raises(GeoEvsError, match=r"'grad' for its .*; did you mean 'gradient'"):
        make_method("three-dgs", {"densification": "grad"})
