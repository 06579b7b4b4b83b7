"""Clips of the tiny scene, and networks trained on nothing."""

from dataclasses import asdict

import pytest
import torch

from baselines.freevs.clips import make_clips
from baselines.freevs.denoiser import ClipDenoiser
from baselines.freevs.model import ClipGenerator
from baselines.freevs.sampling import Sampling
from baselines.freevs.training import Noise, Settings
from geoevs.core.files import write_json
from geoevs.core.networks import seeded
from geoevs.methods.tiny import write_tiny_scene

FRAMES = 2  # as many as the tiny scene has

SETTINGS = Settings(
    prior="nano",
    frames=FRAMES,
    steps=4,
    batch=2,
    learning_rate=1e-2,
    drop=0.1,
    simulated=0.5,
    noise=Noise(0.7, 1.6),
    sampling=Sampling(steps=2, guidance=1.0, sigma_max=20.0),
)


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def settings():
    return SETTINGS


@pytest.fixture(scope="session")
def clips(tmp_path_factory):
    scene = write_tiny_scene(tmp_path_factory.mktemp("tiny") / "scene")
    return make_clips(scene, lambda: None)


@pytest.fixture
def generator(networks):
    """Makes an untrained generator that looks at its condition and at all of a clip."""

    def make(frames=FRAMES, block=2):
        prior = networks.prior(block=block)
        with seeded(0, "freevs"):
            denoiser = ClipDenoiser.from_prior(prior, frames, spread=0.5)
            for name, parameter in denoiser.named_parameters():
                if "over_time" in name or "conv_out" in name or "encoder.head" in name:
                    torch.nn.init.normal_(parameter, std=0.1)
        return ClipGenerator(prior.autoencoder, denoiser.eval())

    return make


@pytest.fixture
def trained(generator, tmp_path):
    """What `geoevs train freevs` writes; blocks of five pixels divide neither side of a view."""
    folder = tmp_path / "trained"
    folder.mkdir()
    generator(frames=3, block=5).save(folder)
    write_json(folder / "settings.json", {"sampling": asdict(SETTINGS.sampling)})
    return folder
