"""On a GPU: clips are learned and generated there."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.freevs.model import ClipGenerator
from baselines.freevs.task import train_freevs
from geoevs.methods.check import contract_failures

pytestmark = pytest.mark.cuda


def test_a_training_learns_there(clips, settings, weights, tmp_path):
    losses = []
    longer = replace(settings, steps=40)
    trained = train_freevs(longer, clips, weights, 0, tmp_path / "work", losses.append)
    assert next(trained.denoiser.parameters()).is_cuda
    assert np.mean(losses[-10:]) < np.mean(losses[:10])
    trained.save(tmp_path)
    assert next(ClipGenerator.load(tmp_path).denoiser.parameters()).is_cuda


def test_contract(trained):
    assert contract_failures("freevs", weights=str(trained)) == []
