"""The recipes of this suite's own weights: what decides their numbers is in the library."""

import pytest
import torch

from geoevs.diffusion import pretraining
from geoevs.diffusion.autoencoder import to_tensor
from geoevs.diffusion.pretraining import (
    CROP,
    STATISTICS,
    pretrain_autoencoder,
    pretrain_prior,
    read_images,
)
from geoevs.diffusion.prior import load_autoencoder
from geoevs.methods.tiny import write_tiny_scene


@pytest.fixture
def scene(tmp_path):
    return write_tiny_scene(tmp_path / "scene").folder


@pytest.fixture
def recipe(networks, monkeypatch):
    """Small networks, and what `optimise` was asked; it changes no weight."""
    monkeypatch.setattr(pretraining, "nano_autoencoder", lambda: networks.network(48))
    monkeypatch.setattr(pretraining, "nano_unet", networks.unet)
    asked = []

    def optimise(task, optimisation, *others):
        asked.append((task, optimisation, *others))
        return task.model

    monkeypatch.setattr(pretraining, "optimise", optimise)
    return asked


def test_the_autoencoder_starts_from_the_best_linear_code_without_weight_decay(
    recipe, networks, scene, tmp_path
):
    out = tmp_path / "autoencoder.safetensors"
    pretrain_autoencoder([scene], 3, 7, 1e-3, 5, tmp_path / "work", out, crop=(16, 16))
    ((task, optimisation, seed, key, work, _),) = recipe
    assert (optimisation.steps, optimisation.learning_rate) == (7, 1e-3)
    assert optimisation.weight_decay == 0.0
    assert (seed, key, work) == (5, "autoencoder", tmp_path / "work")
    assert (task._batch, task._crop) == (3, (16, 16))
    # Untrained, the linear code beats one colour: random weights would not.
    images = to_tensor(read_images([scene]).rgb)
    model = task.model.eval()
    with torch.no_grad():
        error = (model.decode_raw(model.posterior(images).mean) - images).square().mean()
    assert error < 0.5 * images.var()
    # Latents have unit variance on the images: `fit_statistics` ran after training.
    made = load_autoencoder(out)
    with torch.no_grad():
        latents = made.encode(images)
    assert latents.std() == pytest.approx(1.0, abs=0.1)
    assert latents.mean() == pytest.approx(0.0, abs=0.1)


def test_the_first_weights_are_fitted_to_some_of_many_images(recipe, scene, monkeypatch, tmp_path):
    fitted = []
    many = pretraining.Images(read_images([scene]).rgb[:1].repeat(300, axis=0), ["image"] * 300)
    monkeypatch.setattr(pretraining, "read_images", lambda scenes: many)
    for name in ("fit_linear", "fit_statistics"):
        monkeypatch.setattr(
            pretraining.Autoencoder, name, lambda self, images: fitted.append(len(images))
        )
    out = tmp_path / "autoencoder.safetensors"
    pretrain_autoencoder([scene], 1, 1, 1e-3, 0, tmp_path / "work", out, crop=(16, 16))
    assert fitted == [150, 150]  # every second one: 128 would need a step of 2.3
    assert (STATISTICS, CROP) == (128, (64, 64))


def test_the_prior_learns_the_autoencoders_latents_with_the_usual_decay(recipe, scene, tmp_path):
    autoencoder, out = tmp_path / "autoencoder.safetensors", tmp_path / "prior.safetensors"
    pretrain_autoencoder([scene], 1, 1, 1e-3, 0, tmp_path / "a", autoencoder, crop=(16, 16))
    pretrain_prior([scene], autoencoder, 4, 9, 2e-3, 6, tmp_path / "work", out)
    task, optimisation, seed, key, work, _ = recipe[-1]
    assert (optimisation.steps, optimisation.learning_rate) == (9, 2e-3)
    assert optimisation.weight_decay == 0.01
    assert (seed, key, work) == (6, "prior", tmp_path / "work")
    assert task._batch == 4
    assert task._diffusion == pretraining.Diffusion()
    assert task._latents.shape[:2] == (2, len(read_images([scene])))  # both ways round
