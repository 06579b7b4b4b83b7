"""The diffusion process against formulas written out in float64, and samplers against an oracle."""

import numpy as np
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.diffusion.process import (
    LARGEST_LATENT,
    PREDICTIONS,
    SAMPLERS,
    SCHEDULES,
    TIMESTEPS,
    Diffusion,
    guided,
)


def signal_by_hand(prediction, schedule):
    """(1000,) alpha bar, the clean latent's share of the variance, in float64."""
    if schedule == "squaredcos_cap_v2":
        times = np.arange(TIMESTEPS + 1) / TIMESTEPS
        bar = np.cos((times + 0.008) / 1.008 * np.pi / 2) ** 2
        beta = np.minimum(1 - bar[1:] / bar[:-1], 0.999)
    elif schedule == "scaled_linear":
        beta = np.linspace(0.00085**0.5, 0.012**0.5, TIMESTEPS) ** 2
    else:
        beta = np.linspace(0.00085, 0.012, TIMESTEPS)
    root = np.sqrt(np.cumprod(1 - beta))
    if prediction != "epsilon":  # zero terminal signal (Lin et al., WACV 2024)
        root = (root - root[-1]) * root[0] / (root[0] - root[-1])
    return root**2


def tensors(*seeds):
    return [torch.randn(2, 4, 6, 8, generator=torch.Generator().manual_seed(s)) for s in seeds]


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("prediction", PREDICTIONS)
@pytest.mark.parametrize("times", [(0, 999), (250, 700)])
def test_noise_and_target_are_those_of_the_formulas(prediction, schedule, times):
    clean, noise = tensors(0, 1)
    noisy, wanted = Diffusion(prediction, schedule).noisy(clean, noise, torch.tensor(times))
    bar = signal_by_hand(prediction, schedule)[list(times)].reshape(2, 1, 1, 1)
    z, e = clean.double().numpy(), noise.double().numpy()
    np.testing.assert_allclose(noisy, np.sqrt(bar) * z + np.sqrt(1 - bar) * e, atol=1e-4)
    expected = {
        "epsilon": e,
        "v_prediction": np.sqrt(bar) * e - np.sqrt(1 - bar) * z,
        "sample": z,
    }[prediction]
    np.testing.assert_allclose(wanted, expected, atol=1e-4)


@pytest.mark.parametrize("prediction", ["v_prediction", "sample"])
def test_the_last_timestep_is_pure_noise(prediction):
    clean, noise = tensors(0, 1)
    noisy, _ = Diffusion(prediction).noisy(clean, noise, torch.tensor([999, 999]))
    torch.testing.assert_close(noisy, noise)


def oracle(diffusion, clean):
    """Predicts as if it knew the clean latent."""
    bar = signal_by_hand(diffusion.prediction, diffusion.schedule)

    def predict(noisy, timestep):
        share = float(np.sqrt(bar[int(timestep)]))
        rest = float(np.sqrt(1 - bar[int(timestep)]))
        noise = (noisy - share * clean) / rest
        return {
            "epsilon": noise,
            "v_prediction": share * noise - rest * clean,
            "sample": clean,
        }[diffusion.prediction]

    return predict


@pytest.mark.parametrize("steps", [1, 2, 30])
@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("schedule", SCHEDULES[:2])
@pytest.mark.parametrize("prediction", PREDICTIONS)
def test_every_sampler_finds_what_an_oracle_knows(prediction, schedule, sampler, steps):
    clean, noise = tensors(0, 1)
    diffusion = Diffusion(prediction, schedule)
    found = diffusion.sample(oracle(diffusion, clean), noise, steps, sampler)
    # One step divides by almost no signal, or multiplies by a sigma of 4096, in float32.
    np.testing.assert_allclose(found, clean, atol=0.02 if steps == 1 else 1e-5)


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("prediction", PREDICTIONS)
def test_sampling_starts_at_the_last_timestep_with_the_noise_itself(prediction, sampler):
    (noise,) = tensors(1)
    seen = []

    def predict(noisy, timestep):
        seen.append((noisy, float(timestep)))
        return torch.zeros_like(noisy)

    Diffusion(prediction).sample(predict, noise, 4, sampler)
    assert [time for _, time in seen] == [999, 749, 499, 249]
    torch.testing.assert_close(seen[0][0], noise, atol=1e-5, rtol=0)


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("schedule", SCHEDULES[:2])
def test_a_slightly_wrong_noise_makes_no_huge_latent(schedule, sampler):
    (noise,) = tensors(1)
    largest = []

    def predict(noisy, timestep):
        largest.append(noisy.abs().max().item())
        return 0.99 * noisy

    found = Diffusion("epsilon", schedule).sample(predict, noise, 30, sampler)
    # A hundredth of the noise is two hundred times its trace of signal at the first step.
    assert max(largest) < 2 * noise.abs().max()
    assert found.abs().max() <= LARGEST_LATENT + 0.01


def test_guidance_of_one_does_not_ask_for_the_null_condition():
    (features,) = tensors(0)
    calls = []

    def predict(noisy, times, shown):
        calls.append((times.tolist(), shown))
        return noisy

    noisy, timestep = tensors(1)[0], torch.tensor(7)
    assert torch.equal(
        guided(predict, features, torch.zeros(1, 4, 1, 1), 1)(noisy, timestep), noisy
    )
    ((times, shown),) = calls
    assert times == [7, 7]
    assert torch.equal(shown, features)


@pytest.mark.parametrize("scale", [0.0, 1.0, 1.5, 7.0])
def test_guidance_is_the_formula_with_two_separate_passes(networks, scale):
    generator = networks.generator()
    denoiser = generator.denoiser
    noisy, timestep = tensors(1)[0], torch.tensor(700)
    features = torch.randn(2, 10, 6, 8, generator=torch.Generator().manual_seed(2))
    with torch.inference_mode():
        found = guided(denoiser, features, denoiser.null, scale)(noisy, timestep)
        times = timestep.expand(2)
        shown = denoiser(noisy, times, features)
        null = denoiser(noisy, times, denoiser.null.expand(2, 10, 6, 8))
    assert (shown - null).abs().max() > 0.01  # so that the scale matters
    torch.testing.assert_close(found, null + scale * (shown - null), atol=1e-5, rtol=1e-5)


def test_mistakes_are_one_sentence():
    with pytest.raises(GeoEvsError, match=r"'eps' for .* 'prediction'; did you mean 'epsilon'\?"):
        Diffusion("eps")
    with pytest.raises(GeoEvsError, match=r"'cosine' for .* 'schedule'; did you mean 'linear'\?"):
        Diffusion(schedule="cosine")
    with pytest.raises(GeoEvsError, match=r"no sampler 'dpmsolver'; did you mean 'dpm-solver'\?"):
        Diffusion().scheduler("dpmsolver")
