"""Training Geo-EVS on eight synthetic pairs."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch

from geoevs.conditions.injection import INJECTIONS, ArtifactInjection
from geoevs.core.errors import GeoEvsError
from geoevs.core.optimising import Optimisation, optimise
from geoevs.core.randomness import Rng
from geoevs.diffusion import latents
from geoevs.diffusion.autoencoder import to_tensor
from geoevs.diffusion.condition_encoder import FrozenEncoder
from geoevs.diffusion.latents import denoising_losses
from geoevs.diffusion.pretraining import (
    AutoencoderTask,
    Images,
    PriorTask,
    random_crops,
    read_images,
)
from geoevs.diffusion.process import Diffusion
from geoevs.diffusion.sampling import TIMESTEPS, Sampling
from geoevs.generator.geo_evs import task as module
from geoevs.generator.geo_evs.model import Generator
from geoevs.generator.geo_evs.task import GeoEvsTask, train_geo_evs
from geoevs.generator.geo_evs.training import Settings
from geoevs.methods.tiny import HEIGHT, WIDTH, write_tiny_scene

SETTINGS = Settings(
    prior="nano",
    prediction=None,
    schedule=None,
    steps=4,
    batch=4,
    learning_rate=1e-2,
    drop=0.0,
    encoder="trained",
    validity=True,
    filled=True,
    weighting="uniform",
    timesteps="uniform",
    masks="none",
    probability=0.0,
    sampling=Sampling(steps=2),
)


@pytest.fixture
def make(networks, pairs, library):
    """Makes a task of settings that differ from the above.

    It keeps conditions in `shown`, what is encoded of them in `features`.
    """

    def task(seed=0, data=pairs, **changed):
        settings = replace(SETTINGS, **changed)
        injection = ArtifactInjection(
            settings.masks, settings.probability, *data.rgb.shape[1:3], library
        )
        made = GeoEvsTask(networks.prior(), data, injection, settings, seed)
        made.shown, made.features = [], []
        features = made.model.features

        def remember(condition, valid, dropped=None, latent=None):
            made.shown.append((condition, valid, dropped))
            made.features.append(features(condition, valid, dropped, latent))
            return made.features[-1]

        made.model.features = remember
        return made

    return task


def rng(step=0):
    return Rng(0, "geo-evs", str(step))


@torch.no_grad()
def mean_loss(task):
    """Of the same eight batches whatever was learned."""
    return np.mean([task.losses(rng(f"test {n}"))["loss"].item() for n in range(8)])


def picked(task, pairs):
    """The numbers of the pairs in a batch, from their names."""
    names = [f"{s}/{c}/{f}" for s, c, f in zip(pairs.scene, pairs.camera, pairs.frame, strict=True)]
    assert len(set(names)) == len(pairs)
    return [names.index(name) for name in task.batch(rng())]


def test_a_batch_is_what_it_is_called(make, pairs):
    task = make(batch=6)
    task.losses(rng())
    ((condition, valid, _),) = task.shown
    numbers = picked(task, pairs)
    assert len(set(numbers)) > 1
    # Without injection the conditions are the pairs' own.
    np.testing.assert_array_equal(valid[:, 0], pairs.valid[numbers])
    torch.testing.assert_close(condition, to_tensor(pairs.rgb[numbers]))


@pytest.mark.parametrize("probability", [0, 0.5, 1])
@pytest.mark.parametrize("encoder", ["trained", "frozen"])
def test_latents_known_beforehand_change_no_features(make, monkeypatch, encoder, probability):
    for place in (module, latents):
        monkeypatch.setattr(place, "mixed_precision", lambda device: nullcontext())
    task = make(masks="boxes-unmatched", probability=probability, batch=12, encoder=encoder)
    task.losses(rng())
    (shown,), (features,) = task.shown, task.features
    torch.testing.assert_close(task.model.features(*shown), features)


def test_targets_are_the_pairs_latents(make, pairs, networks, monkeypatch):
    task = make()
    seen = []
    monkeypatch.setattr(
        module,
        "denoising_losses",
        lambda model, diffusion, clean, *_: seen.append(clean) or clean.new_zeros(4),
    )
    task.losses(rng())
    wanted = networks.autoencoder().encode(to_tensor(pairs.target[picked(task, pairs)]))
    torch.testing.assert_close(seen[0], wanted, atol=0.05, rtol=0)  # bfloat16


def test_the_loss_is_the_predictions_squared_error(networks):
    denoiser = networks.prior().denoiser
    clean = torch.randn(64, 4, 8, 12, generator=torch.Generator().manual_seed(0))
    seen = []

    def predict(noisy, timesteps, features):
        seen.append((noisy, timesteps, features))
        return torch.zeros_like(noisy)

    every = torch.arange(TIMESTEPS)
    losses = denoising_losses(predict, Diffusion("sample"), clean, None, every, rng())
    torch.testing.assert_close(losses, clean.square().mean(dim=(1, 2, 3)))
    ((noisy, timesteps, _),) = seen
    assert timesteps.min() < TIMESTEPS / 8
    assert timesteps.max() > TIMESTEPS * 7 / 8
    # Early ones are almost clean, late ones almost noise.
    correlation = [(noisy[n] * clean[n]).mean().item() for n in timesteps.argsort()]
    assert np.mean(correlation[:8]) > 0.7
    assert abs(np.mean(correlation[-8:])) < 0.2
    assert denoising_losses(denoiser, Diffusion(), clean[:2], None, every, rng()).shape == (2,)


@pytest.mark.parametrize("steps", [1, 3])
def test_timesteps_that_sampling_visits_are_all_that_is_learned(make, monkeypatch, steps):
    task = make(timesteps="sampled", sampling=Sampling(steps=steps), batch=16)
    learned, visited = set(), []
    noisy = task._diffusion.__class__.noisy

    def watch(diffusion, clean, noise, timesteps):
        learned.update(timesteps.tolist())
        return noisy(diffusion, clean, noise, timesteps)

    monkeypatch.setattr(task._diffusion.__class__, "noisy", watch)
    for step in range(4):
        task.losses(Rng(0, str(step)))
    task._diffusion.sample(
        lambda latent, t: visited.append(int(t)) or latent, torch.zeros(1, 4, 2, 2), steps
    )
    assert learned == set(visited)


@pytest.mark.parametrize("kind", [kind for kind in INJECTIONS if kind != "none"])
def test_masks_hide_what_they_should(make, pairs, kind):
    plain, masked = make(), make(masks=kind, probability=1.0)
    for task in (plain, masked):
        task.losses(rng())
    ((_, before, _),), ((condition, valid, _),) = plain.shown, masked.shown
    assert not (valid & ~before).any()
    assert (valid.sum(dim=(1, 2, 3)) < before.sum(dim=(1, 2, 3))).all()
    assert not condition.mul(~valid).any()
    off = make(masks=kind, probability=0.0)
    off.losses(rng())
    assert torch.equal(off.shown[0][1], before)


def test_trainings_that_differ_in_masks_share_the_rest(make, monkeypatch):
    tasks = make(drop=0.5, batch=16), make(drop=0.5, batch=16, masks="boxes", probability=0.5)
    drawn = []
    monkeypatch.setattr(
        module,
        "denoising_losses",
        lambda model, diffusion, clean, features, choices, rng: (
            drawn.append((clean, torch.rand(3, generator=rng.torch))) or clean.new_zeros(16)
        ),
    )
    for task in tasks:
        task.losses(rng())
    (_, _, first), (_, _, second) = tasks[0].shown[0], tasks[1].shown[0]
    assert torch.equal(first, second)
    assert 0 < first.sum() < 16
    assert all(torch.equal(*both) for both in zip(*drawn, strict=True))


@pytest.mark.parametrize(("drop", "dropped"), [(0.0, 0), (1.0, 16)])
def test_conditions_are_dropped_with_their_probability(make, drop, dropped):
    task = make(drop=drop, batch=16)
    task.losses(rng())
    assert task.shown[0][2].sum() == dropped


def test_support_weighs_samples_by_hand(make, pairs, monkeypatch):
    errors = torch.tensor([1.0, 2.0, 3.0, 4.0])
    monkeypatch.setattr(module, "denoising_losses", lambda *_: errors)
    # Pair n has 16 - n of 16 rows; the eight have 12.5 in the mean.
    task = make(weighting="support")
    rows = [16 - n for n in picked(task, pairs)]
    assert len(set(rows)) > 1
    by_hand = sum(w / 12.5 * e for w, e in zip(rows, (1, 2, 3, 4), strict=True)) / 4
    losses = task.losses(rng())
    assert losses["loss"].item() == pytest.approx(by_hand, rel=1e-5)
    assert losses["support"].item() == pytest.approx(sum(rows) / 4 / 16)
    assert make().losses(rng())["loss"].item() == pytest.approx(2.5)


@pytest.mark.parametrize(
    "changed",
    [
        {"masks": "reprojected", "probability": 0.5, "weighting": "support"},
        {"encoder": "frozen"},
        {"validity": False, "filled": False},
    ],
)
def test_a_few_steps_lower_the_loss(make, tmp_path, changed):
    task = make(**changed)
    before = {name: value.clone() for name, value in task._autoencoder.state_dict().items()}
    first = mean_loss(task)
    optimise(task, Optimisation(40, 1e-2), 0, "geo-evs", tmp_path)
    assert mean_loss(task) < 0.85 * first
    # The autoencoder is frozen.
    after = task._autoencoder.state_dict()
    assert all(torch.equal(after[name], value) for name, value in before.items())
    assert (task.model.encoder.channels == 5) == isinstance(task.model.encoder, FrozenEncoder)
    assert (tmp_path / "previews/000040.png").exists()


def test_previews_show_condition_sample_and_target(make, pairs):
    task = make()
    picture = task.preview(task.model)
    assert picture.shape == (6 * 16, 3 * 24, 3)
    numbers = [0, 1, 2, 4, 5, 7]
    np.testing.assert_allclose(
        picture[:, 48:], pairs.target[numbers].reshape(96, 24, 3) / 255, atol=1e-6
    )
    np.testing.assert_allclose(
        picture[:, :24], pairs.rgb[numbers].reshape(96, 24, 3) / 255, atol=1e-6
    )
    np.testing.assert_array_equal(picture, task.preview(task.model))


def identities(make, pairs):
    darker = replace(pairs, target=pairs.target // 2)
    emptier = replace(pairs, valid=pairs.valid & (np.arange(24) > 3))
    yield make()
    for changed in (
        {"batch": 5},
        {"drop": 0.2},
        {"probability": 0.1},
        {"masks": "boxes"},
        {"data": darker},
        {"data": emptier},
    ):
        yield make(**changed)


def test_settings_and_data_are_the_trainings_identity(make, pairs):
    found = [task.identity for task in identities(make, pairs)]
    assert len(set(found)) == len(found)
    assert make().identity == found[0]


def test_the_seed_decides_the_encoders_first_weights(make):
    first, again, other = (make(seed).model.encoder.layers[0].weight for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_training_starts_from_the_named_prior(pairs, library, weights, tmp_path):
    def run(folder, seed=0, **changed):
        settings = replace(SETTINGS, **changed)
        return train_geo_evs(
            settings, pairs, library, weights, seed, tmp_path / folder, lambda loss: None
        )

    generator = run("a", prediction="sample", schedule="linear")
    assert generator.diffusion == Diffusion("sample", "linear")
    kept = run("b")
    assert kept.diffusion == Diffusion()
    generator.save(tmp_path)
    loaded = Generator.load(tmp_path)
    image = loaded.generate(
        pairs.rgb[:1] / np.float32(255),
        pairs.valid[:1],
        Sampling(2),
        torch.Generator().manual_seed(0),
    )
    assert np.isfinite(image).all()
    # The same seed gives the same weights, from another folder too.
    again, other = run("c"), run("d", seed=1)
    state, same, different = (
        made.denoiser.state_dict()["unet.conv_in.weight"] for made in (kept, again, other)
    )
    assert torch.equal(state, same)
    assert not torch.equal(state, different)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"encoder": "frosen"}, r"'frosen' for its option 'encoder'; did you mean 'frozen'\?"),
        ({"weighting": "suport"}, r"'suport' for its option 'weighting'; did you mean 'support'\?"),
        ({"timesteps": "sample"}, r"'sample' for its option 'timesteps'; did you mean 'sampled'\?"),
        ({"masks": "box"}, r"'box' for its option 'masks'; did you mean 'boxes'\?"),
        ({"probability": float("nan")}, r"nan for its option 'probability'; write a finite number"),
    ],
)
def test_wrong_settings_are_one_sentence(changed, sentence):
    with pytest.raises(GeoEvsError, match=f"^the training of Geo-EVS cannot have {sentence}"):
        replace(SETTINGS, **changed)


def test_images_that_do_not_divide_are_refused(make, pairs, networks):
    odd = replace(
        pairs, **{name: getattr(pairs, name)[:, :15] for name in ("rgb", "valid", "target")}
    )
    injection = ArtifactInjection("none", 0.0, 15, 24)
    sentence = "images of 15 x 24 do not divide into latents; choose sides that are multiples of 2"
    with pytest.raises(GeoEvsError, match=f"^{sentence}$"):
        GeoEvsTask(networks.prior(), odd, injection, SETTINGS, 0)


def named(rgb):
    return Images(rgb, [f"scene/front/{n}" for n in range(len(rgb))])


def test_an_autoencoder_learns(networks, tmp_path):
    images = named(networks.images(6, seed=1))
    task = AutoencoderTask(networks.autoencoder(), images, 4, (8, 8))
    first = mean_loss(task)
    optimise(task, Optimisation(40, 3e-3, weight_decay=0.0), 0, "autoencoder", tmp_path)
    assert mean_loss(task) < 0.85 * first
    assert task.preview(task.model).shape == (2 * 16, 6 * 24, 3)


def test_a_prior_learns(networks, tmp_path):
    prior = networks.prior()
    images = named(networks.images(6, seed=1))
    task = PriorTask(prior.denoiser, prior.autoencoder, prior.diffusion, images, 4)
    first = mean_loss(task)
    picked = rng().numpy.integers(6, size=4)
    assert task.batch(rng()) == [f"scene/front/{n}" for n in picked]
    optimise(task, Optimisation(40, 1e-2), 0, "prior", tmp_path)
    assert mean_loss(task) < 0.85 * first
    assert task.preview(task.model).shape == (2 * 16, 4 * 24, 3)


def test_crops_are_parts_of_images_some_of_them_mirrored(networks):
    images = np.arange(2 * 6 * 8 * 3, dtype=np.uint8).reshape(2, 6, 8, 3)
    task = AutoencoderTask(networks.autoencoder(), named(images), 12, (4, 2))
    crops = random_crops(images, 12, (4, 2), rng().numpy)
    parts = {
        images[n, top : top + 4, left : left + 2][:, ::flip].tobytes(): (n, flip)
        for n in (0, 1)
        for top in range(3)
        for left in range(7)
        for flip in (1, -1)
    }
    found = np.rint(crops.numpy().transpose(0, 2, 3, 1) * 255).astype(np.uint8)
    places = [parts[crop.tobytes()] for crop in found]
    assert task.batch(rng()) == [f"scene/front/{n}" for n, _ in places]
    assert {flip for _, flip in places} == {1, -1}
    assert len(set(map(bytes, found))) > 6


def test_crops_must_fit(networks):
    sentence = r"^crops of 24 x 24 do not fit into images of 16 x 24; choose a smaller crop$"
    with pytest.raises(GeoEvsError, match=sentence):
        AutoencoderTask(networks.autoencoder(), named(networks.images(2)), 4, (24, 24))
    task = AutoencoderTask(networks.autoencoder(block=4), named(networks.images(2)), 4, (10, 10))
    with pytest.raises(GeoEvsError, match=r"^images of 10 x 10 do not divide .* multiples of 4$"):
        task.losses(rng())


def test_images_of_scenes_are_read_in_order(tmp_path):
    scene = write_tiny_scene(tmp_path / "a")
    images = read_images([scene.folder, scene.folder])
    assert images.rgb.shape == (12, HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(images.rgb[:6], images.rgb[6:])
    np.testing.assert_allclose(images.rgb[4] / 255, scene.image(scene.cameras[1], 1), atol=1e-6)
    assert images.names[:6] == images.names[6:]
    assert images.names[4] == f"{scene.info.name}/{scene.cameras[1]}/1"
