import torch

from geoevs.diffusion.condition_encoder import ConditionEncoder
from geoevs.diffusion.denoiser import Denoiser, conditioned, nano_unet
from geoevs.diffusion.push_pull import push_pull

T = torch.tensor([10, 900])


def noisy(seed=0):
    return torch.randn(2, 4, 8, 12, generator=torch.Generator().manual_seed(seed))


def test_a_widened_denoiser_starts_as_the_prior(networks):
    prior = networks.prior().denoiser
    before = prior(noisy(), T).detach()
    denoiser = conditioned(prior, ConditionEncoder(networks.autoencoder(), channels=6))
    assert denoiser.unet.config.in_channels == 14
    for features in (torch.zeros(2, 10, 8, 12), torch.randn(2, 10, 8, 12)):
        torch.testing.assert_close(denoiser(noisy(), T, features), before, atol=1e-6, rtol=0)


def test_a_denoiser_of_residuals_starts_as_the_conditions_own_latent(networks):
    autoencoder = networks.autoencoder()
    encoder = ConditionEncoder(autoencoder, channels=6)
    denoiser = conditioned(networks.prior().denoiser, encoder, "sample")
    image, valid = torch.rand(2, 3, 16, 24), torch.rand(2, 1, 16, 24) < 0.7
    features = denoiser.features(image, valid)
    filled = autoencoder.encode(push_pull(image, valid))
    assert torch.equal(denoiser(noisy(), T, features), filled)
    # The UNet reads that latent as it read its own, and what it does not use yet, it can learn to.
    weight = denoiser.unet.conv_in.weight
    assert torch.equal(weight[:, 4:8], weight[:, :4])
    assert weight[:, 8:].abs().min() > 0
    denoiser(noisy(), T, features).square().mean().backward()
    assert denoiser.unet.conv_out.weight.grad.abs().max() > 0


def test_the_priors_prompt_is_kept(networks):
    prior = networks.prior().denoiser
    before = prior(noisy(), T).detach()
    denoiser = conditioned(prior, ConditionEncoder(networks.autoencoder(), channels=6))
    assert torch.equal(denoiser.prompt, networks.prior().denoiser.prompt)
    denoiser.prompt.data.zero_()
    changed = denoiser(noisy(), T, torch.zeros(2, 10, 8, 12))
    assert (changed - before).abs().max() > 1e-3  # so it mattered


def test_dropped_samples_have_the_null_condition(networks):
    denoiser = networks.generator().denoiser
    condition, valid = torch.rand(2, 3, 16, 24), torch.ones(2, 1, 16, 24, dtype=bool)
    all_shown = denoiser.features(condition, valid)
    features = denoiser.features(condition, valid, torch.tensor([True, False]))
    assert torch.equal(features[0], denoiser.null[0].expand(10, 8, 12))
    assert torch.equal(features[1], all_shown[1])
    assert torch.equal(denoiser.features(condition, valid, torch.tensor([False, False])), all_shown)


def test_null_condition_and_prompt_are_learned(networks):
    denoiser = networks.generator().denoiser
    condition, valid = torch.rand(2, 3, 16, 24), torch.ones(2, 1, 16, 24, dtype=bool)
    features = denoiser.features(condition, valid, torch.tensor([True, False]))
    denoiser(noisy(), T, features).square().mean().backward()
    for parameter in (denoiser.null, denoiser.prompt, denoiser.encoder.layers[0].weight):
        assert parameter.grad.abs().max() > 0


def test_a_prior_has_no_condition(networks):
    denoiser = Denoiser(networks.unet(), None)
    assert denoiser.encoder is None
    assert not [name for name, _ in denoiser.named_parameters() if "null" in name]


def test_the_nano_unet_takes_any_size():
    denoiser = Denoiser(nano_unet(8), None)
    for size in ((12, 18), (3, 5)):
        assert denoiser(torch.randn(1, 8, *size), T[:1]).shape == (1, 8, *size)
