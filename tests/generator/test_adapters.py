"""Geo-EVS as a method: the contract, its options, and what it does without support."""

import re

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_json
from geoevs.core.randomness import Rng
from geoevs.methods.check import contract_failures
from geoevs.methods.contract import Budget, Views
from geoevs.methods.finding import make_method
from geoevs.methods.tiny import MOUNT, tiny_camera, write_tiny_scene
from geoevs.methods.trial import VIRTUAL

METHODS = ("geo-evs", "geo-evs-support")


@pytest.fixture
def trained(networks, tmp_path):
    """What `geoevs train` writes; blocks of five pixels divide neither side of the tiny scene."""
    folder = tmp_path / "trained"
    folder.mkdir()
    networks.generator(block=5).save(folder)
    made_with = {"geometry": "lidar", "timesteps": "uniform", "sampling": {"steps": 2}}
    write_json(folder / "settings.json", made_with)
    write_json(folder / "seconds.json", {"training": 100.0, "geometry": 46.0})
    return folder


@pytest.fixture
def fitted(trained, tmp_path):
    """Makes a method with options and fits it to the tiny scene."""
    scene = write_tiny_scene(tmp_path / "scene")

    def fit(name="geo-evs", cameras=scene.cameras, seed=0, **options):
        method = make_method(name, {"weights": str(trained), **options})
        views = Views(scene, cameras, method.info.needs)
        method.report = method.fit(views, Budget(), Rng(seed, "fit"))
        return method

    return fit


@pytest.mark.parametrize("name", METHODS)
def test_the_contract_is_kept(name, trained):
    assert contract_failures(name, weights=str(trained)) == []


def test_support_is_kept_exactly_where_it_is_asked_for(fitted):
    plain, kept = (fitted(name).render(VIRTUAL, 1) for name in METHODS)
    assert 0.2 < plain.support.mean() <= kept.support.mean() < 1  # other frames explain more
    assert kept.support[plain.support].all()
    condition = fitted("geo-evs-support")._lifted.condition(VIRTUAL, 1)
    np.testing.assert_array_equal(kept.rgb[kept.support], condition.image[kept.support])
    assert np.abs(plain.rgb - kept.rgb)[kept.support].max() > 0.05
    np.testing.assert_array_equal(kept.depth > 0, kept.support)


def test_renders_do_not_depend_on_their_order(fitted):
    other = tiny_camera("other", 10.0, MOUNT)
    first, second = fitted(), fitted()
    ahead = [first.render(VIRTUAL, 0), first.render(VIRTUAL, 1), first.render(other, 1)]
    back = [second.render(other, 1), second.render(VIRTUAL, 1), second.render(VIRTUAL, 0)]
    for one, same in zip(ahead, back[::-1], strict=True):
        np.testing.assert_array_equal(one.rgb, same.rgb)


def test_the_seed_decides_the_samples(fitted):
    first, again, other = (fitted(seed=s).render(VIRTUAL, 1).rgb for s in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


def test_options_replace_what_the_training_says(fitted, tmp_path):
    asked = {"steps": 3, "guidance": 4.0, "sampler": "euler", "average": 2}
    as_trained = fitted()
    assert as_trained._sampling.steps == 2
    changed = {name: fitted(**{name: value}) for name, value in asked.items()}
    for name, method in changed.items():
        assert getattr(method._sampling, name) == asked[name]
        assert np.abs(method.render(VIRTUAL, 1).rgb - as_trained.render(VIRTUAL, 1).rgb).max() > 0
    (tmp_path / "saved").mkdir()
    changed["guidance"].save(tmp_path / "saved")
    loaded = type(as_trained).load(tmp_path / "saved")
    assert loaded._sampling == changed["guidance"]._sampling


def test_a_wrong_option_is_found_when_it_is_fitted(fitted):
    with pytest.raises(
        GeoEvsError, match=r"'ddmi' for its option 'sampler'; did you mean 'ddim'\?"
    ):
        fitted(sampler="ddmi")


def test_timesteps_that_were_not_trained_are_refused(fitted, trained):
    made_with = {"geometry": "lidar", "timesteps": "sampled", "sampling": {"steps": 2}}
    write_json(trained / "settings.json", made_with)
    assert fitted(guidance=2.0)._sampling.guidance == 2.0
    assert fitted(steps=1)._sampling.steps == 1  # one of the two
    sentence = (
        f"{trained} was trained at the 2 timesteps of sampling with steps=2 and sampler=ddim "
        "alone, and steps=3 with sampler=ddim visits others; set `timesteps: uniform` in its "
        "training section, or drop the options steps and sampler"
    )
    with pytest.raises(GeoEvsError, match=f"^{re.escape(sentence)}$"):
        fitted(steps=3)
    made_with["timesteps"] = "uniform"
    write_json(trained / "settings.json", made_with)
    assert fitted(steps=3)._sampling.steps == 3


def test_saved_scenes_share_the_weights(fitted, trained, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        fitted().save(tmp_path / name)
    file = "denoiser.safetensors"
    assert (
        len(
            {
                (folder / file).stat().st_ino
                for folder in (trained, tmp_path / "a/weights", tmp_path / "b/weights")
            }
        )
        == 1
    )


def test_costs_count_source_pixels_and_weights(fitted):
    method = fitted()
    depths = [depth for maps in method._lifted.depths.values() for depth in maps.values()]
    assert method.report.primitives == sum(np.count_nonzero(depth) for depth in depths) > 1000
    networks = method._generator.autoencoder, method._generator.denoiser
    assert method.report.parameters == sum(p.numel() for n in networks for p in n.parameters())


def test_costs_hold_the_training_that_was_timed(fitted, trained):
    assert fitted().report.training_seconds == 146.0
    (trained / "seconds.json").unlink()
    assert fitted().report.training_seconds is None


@pytest.mark.parametrize("name", METHODS)
def test_a_view_without_support_is_one_sentence(fitted, name):
    method = fitted(name, cameras=("front",))
    behind = tiny_camera("behind", 180.0, MOUNT)
    sentence = "the condition map of 'behind' in frame 1 has no valid pixel, so its picture is the"
    with pytest.warns(UserWarning, match=f"^{re.escape(sentence)}"):
        rendering = method.render(behind, 1)
    assert np.isfinite(rendering.rgb).all()
    assert not rendering.support.any()


@pytest.mark.parametrize("name", METHODS)
def test_a_masked_view_is_generated_from_what_is_kept(fitted, name):
    method = fitted(name)
    whole = method.render(VIRTUAL, 1)
    keep = np.ones((VIRTUAL.height, VIRTUAL.width), bool)
    np.testing.assert_array_equal(method.render_masked(VIRTUAL, 1, keep).rgb, whole.rgb)
    keep[:, 20:40] = False
    masked = method.render_masked(VIRTUAL, 1, keep)
    np.testing.assert_array_equal(masked.support, whole.support & keep)
    assert np.abs(masked.rgb - whole.rgb)[~keep].max() > 0.01


def test_missing_weights_are_one_sentence(fitted, trained):
    (trained / "settings.json").unlink()
    with pytest.raises(GeoEvsError, match=r"settings.json is missing; make or copy it there$"):
        fitted()
