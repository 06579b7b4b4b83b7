"""On a GPU: the same networks, trained and sampled in bfloat16."""

import numpy as np
import pytest
import torch

from geoevs.diffusion.process import Diffusion
from geoevs.diffusion.sampling import Sampling
from geoevs.generator.geo_evs.model import Generator
from geoevs.generator.geo_evs.task import train_geo_evs
from geoevs.generator.geo_evs.training import Settings

pytestmark = pytest.mark.cuda


@pytest.mark.parametrize("sampler", ["ddim", "dpm-solver", "euler"])
def test_a_generator_is_the_cpus_but_for_rounding(networks, pairs, sampler):
    generator = networks.generator(Diffusion("sample"))
    valid = pairs.valid[4:]
    shown = pairs.rgb[4:].astype(np.float32) / 255 * valid[..., None]
    sampling = Sampling(steps=4, guidance=1.5, sampler=sampler, average=1)

    def on(device):
        moved = Generator(
            generator.autoencoder.to(device), generator.denoiser.to(device), generator.diffusion
        )
        return moved.generate(shown, valid, sampling, torch.Generator().manual_seed(0))

    there, here = on("cuda"), on("cpu")
    assert np.isfinite(there).all()
    assert np.abs(there - here).mean() < 0.02


def test_a_training_learns_there_and_goes_on(networks, pairs, library, weights, tmp_path):
    settings = Settings(
        **{"prior": "nano", "prediction": "sample", "schedule": None, "encoder": "trained"},
        **{"steps": 40, "batch": 4, "learning_rate": 1e-2, "drop": 0.1, "validity": True},
        **{"filled": True, "weighting": "uniform", "timesteps": "sampled", "masks": "reprojected"},
        **{"probability": 0.4, "sampling": {"steps": 1}},
    )
    losses = []
    arguments = settings, pairs, library, weights, 0, tmp_path / "work"
    trained = train_geo_evs(*arguments, losses.append)
    assert next(trained.denoiser.parameters()).is_cuda
    assert np.mean(losses[-10:]) < np.mean(losses[:10])
    trained.save(tmp_path)
    loaded = Generator.load(tmp_path)
    assert next(loaded.denoiser.parameters()).is_cuda
    again = []
    train_geo_evs(*arguments, again.append)  # its state says that all steps were taken
    assert np.isnan(again).all()
