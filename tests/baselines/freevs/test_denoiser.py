"""The denoiser against diffusers' own EDM, and what it is before its first step."""

from itertools import pairwise

import diffusers
import numpy as np
import pytest
import torch

from baselines.freevs.denoiser import ClipDenoiser, Preconditioning
from baselines.freevs.model import ClipGenerator, sample
from baselines.freevs.sampling import Sampling
from geoevs.core.errors import GeoEvsError

FRAMES = 3


def draw(*shape, seed=0):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture
def denoiser(networks):
    return ClipDenoiser.from_prior(networks.prior(), FRAMES, spread=0.5)


@pytest.mark.parametrize("sigma", [0.01, 0.5, 3.0, 80.0])
def test_preconditioning_is_edms(sigma):
    twin = diffusers.EDMEulerScheduler(sigma_data=0.5, prediction_type="epsilon")
    noisy, output = draw(2, 4, 3, 5), draw(2, 4, 3, 5, seed=1)
    scales = Preconditioning.at(torch.full((2,), sigma), 0.5)
    wanted = twin.precondition_outputs(noisy, output, torch.tensor(sigma))
    torch.testing.assert_close(scales.skip * noisy + scales.out * output, wanted)
    by_hand = (sigma**2 + 0.25) / (sigma * 0.5) ** 2
    torch.testing.assert_close(scales.weight, torch.full((2, 1, 1, 1), by_hand))


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_sampling_is_diffusers_euler_steps(steps):
    twin = diffusers.EulerDiscreteScheduler(
        sigma_min=0.002,
        sigma_max=80.0,
        use_karras_sigmas=True,
        timestep_spacing="trailing",
        prediction_type="sample",
    )
    twin.set_timesteps(steps)
    noise = draw(1, 4, 3, 5)
    latent = noise * twin.init_noise_sigma
    for sigma, t in zip(twin.sigmas, twin.timesteps, strict=False):
        twin.scale_model_input(latent, t)
        latent = twin.step(torch.tanh(latent / (1 + sigma)), t, latent).prev_sample
    ours = sample(lambda x, s: torch.tanh(x / (1 + s)), noise, Sampling(steps, 1.0, 80.0))
    torch.testing.assert_close(ours, latent, rtol=1e-4, atol=1e-4)


def test_noise_falls_to_zero():
    sigmas = Sampling(25).sigmas()
    assert sigmas[0] == pytest.approx(700)
    assert sigmas[-2:] == [pytest.approx(0.002), 0.0]
    assert all(before > after for before, after in pairwise(sigmas))


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"steps": 0}, "sampling cannot have 0 for its option 'steps'; make it 1 or more"),
        ({"average": 0}, "sampling cannot have 0 for its option 'average'; make it 1 or more"),
        (
            {"sigma_max": 0.001},
            "sampling cannot have 0.001 for its option 'sigma_max'; make it more",
        ),
    ],
)
def test_wrong_sampling_is_one_sentence(wrong, sentence):
    with pytest.raises(GeoEvsError, match=f"^{sentence}"):
        Sampling(**wrong)


@torch.no_grad()
def test_the_first_prediction_is_the_condition_and_what_noise_leaves(denoiser):
    noisy, condition = draw(6, 4, 8, 12), draw(6, 4, 8, 12, seed=1)
    found = denoiser(noisy, torch.full((6,), 1e5), condition)
    torch.testing.assert_close(found, condition)
    half = denoiser(noisy, torch.full((6,), 0.5), condition)  # as much noise as data
    torch.testing.assert_close(half, (noisy + condition) / 2)


@torch.no_grad()
def test_layers_over_time_start_as_nothing(networks, denoiser):
    """What the prior's UNet computes is computed, for every frame by itself."""
    alone = networks.prior().denoiser.unet
    inputs, times = draw(6, 4, 8, 12), torch.full((6,), 500.0)
    prompt = denoiser.prompt.expand(6, -1, -1)
    wanted = alone(inputs, times, encoder_hidden_states=prompt).sample
    unet = denoiser.unet
    torch.nn.init.zeros_(unet.conv_in.weight[:, 4:])
    unet.conv_out.load_state_dict(alone.conv_out.state_dict())
    twice = torch.cat([inputs, draw(6, 4, 8, 12, seed=1)], dim=1)
    found = unet(twice, times, encoder_hidden_states=prompt).sample
    torch.testing.assert_close(found, wanted)


@torch.no_grad()
def test_frames_of_a_clip_see_each_other_and_no_other_clip(generator):
    denoiser = generator(FRAMES).denoiser
    noisy, condition = draw(6, 4, 8, 12), draw(6, 4, 8, 12, seed=1)
    sigma = torch.full((6,), 2.0)
    before = denoiser(noisy, sigma, condition)
    noisy[0] += 1
    changed = (denoiser(noisy, sigma, condition) - before).abs().amax(dim=(1, 2, 3)) > 1e-6
    assert changed.tolist() == [True, True, True, False, False, False]


def test_the_prior_is_told_its_own_time(denoiser):
    signal = denoiser.prior.scheduler().alphas_cumprod
    times = torch.tensor([3, 500, 990])
    sigma = ((1 - signal[times]) / signal[times]).sqrt()
    torch.testing.assert_close(denoiser._timesteps(sigma), times.float(), atol=0.02, rtol=0)


def test_saved_networks_are_the_same(generator, tmp_path):
    made = generator(FRAMES)
    made.save(tmp_path)
    loaded = ClipGenerator.load(tmp_path)
    assert (loaded.denoiser.frames, loaded.denoiser.spread) == (FRAMES, 0.5)
    state, again = made.denoiser.state_dict(), loaded.denoiser.state_dict()
    assert state.keys() == again.keys()
    assert all(torch.equal(state[name], again[name].cpu()) for name in state)


def test_the_middle_of_each_clip_is_shown(generator):
    made = generator(FRAMES)
    images = torch.rand(6, 16, 24, 3, generator=torch.Generator().manual_seed(0)).numpy()
    valid = images[..., 0] > 0.5

    def run(images, valid):
        random = torch.Generator().manual_seed(0)
        return made.generate(images * valid[..., None], valid, Sampling(1, 1.0, 20.0), random)

    both = run(images, valid)
    assert both.shape == (2, 16, 24, 3)
    again = run(images[:3], valid[:3])
    np.testing.assert_allclose(again[0], both[0], atol=0.02)  # bfloat16
    assert np.abs(both[0] - both[1]).max() > 0.05
