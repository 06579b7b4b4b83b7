"""Training FreeVS on the tiny scene, and the files it learns from."""

import dataclasses

import numpy as np
import pytest
import torch

from baselines.freevs import task as module
from baselines.freevs.clips import Clips, make_clips, read_clips, write_clips
from baselines.freevs.task import FreeVSTask, train_freevs
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json
from geoevs.core.optimising import Optimisation, optimise
from geoevs.core.randomness import Rng
from geoevs.methods.tiny import HEIGHT, WIDTH, write_tiny_scene
from geoevs.methods.training import Inputs
from geoevs.methods.training_steps import prepare_scene, train_method


@pytest.fixture
def make(networks, clips, settings):
    """Makes a task of settings that differ from the usual."""

    def task(seed=0, data=clips, **changed):
        wanted = dataclasses.replace(settings, **changed)
        return FreeVSTask(networks.prior(), data, wanted, seed)

    return task


def rng(step=0):
    return Rng(0, "freevs", str(step))


@torch.no_grad()
def mean_loss(task):
    """Of the same eight batches whatever was learned."""
    return np.mean([task.losses(rng(f"test {n}"))["loss"].item() for n in range(8)])


def test_clips_are_written_and_read(clips, tmp_path):
    assert clips.rgb.shape == (6, 3, HEIGHT, WIDTH, 3)
    assert clips.camera.tolist() == ["front", "front", "left", "left", "right", "right"]
    assert clips.frame.tolist() == [0, 1] * 3
    assert 0.1 < clips.valid.mean() < 0.6
    assert not clips.rgb[~clips.valid].any()
    for name in ("a", "b"):
        write_clips(tmp_path / f"{name}.npz", clips)
    both = read_clips([tmp_path / "a.npz", tmp_path / "b.npz"])
    for field in dataclasses.fields(Clips):
        once = getattr(clips, field.name)
        np.testing.assert_array_equal(getattr(both, field.name), np.concatenate([once, once]))


def test_points_show_what_is_there(clips):
    """Colours of points are those of the pixels they fall into, to within a pixel's slope."""
    difference = np.abs(clips.rgb[:, 0].astype(int) - clips.target)[clips.valid[:, 0]]
    assert np.median(difference) < 4
    shuffled = np.abs(clips.rgb[:, 0].astype(int) - clips.target[::-1])[clips.valid[:, 0]]
    assert np.median(shuffled) > 12


def test_a_clip_is_of_one_camera(clips):
    assert clips.starts(1).tolist() == [0, 1, 2, 3, 4, 5]
    assert clips.starts(2).tolist() == [0, 2, 4]
    sentence = "no scene under partitions.clips has 3 frames; lower trainings.freevs.frames or name"
    with pytest.raises(GeoEvsError, match=f"^{sentence}"):
        clips.starts(3)


def test_no_clips_are_one_sentence():
    with pytest.raises(GeoEvsError, match=r"^there are no clips; name scenes under partitions"):
        read_clips([])


def test_a_few_steps_lower_the_loss(make, tmp_path):
    task = make()
    before = {name: value.clone() for name, value in task._autoencoder.state_dict().items()}
    first = mean_loss(task)
    optimise(task, Optimisation(30, 1e-2), 0, "freevs", tmp_path)
    assert mean_loss(task) < 0.85 * first
    # The autoencoder is frozen, layers over time are not.
    after = task._autoencoder.state_dict()
    assert all(torch.equal(after[name], value) for name, value in before.items())
    assert task.model.unet.mid_block.resnets[0].over_time.weight.abs().max() > 0
    assert (tmp_path / "previews/000030.png").exists()
    assert (tmp_path / "losses.csv").read_text().startswith("step,loss,condition\n0,")


def test_the_first_loss_is_that_of_the_best_guess_without_learning(make):
    """EDM weighs errors so that a network that says nothing has a loss of about 1."""
    with torch.no_grad():
        loss = make(batch=24, drop=0.0).losses(rng())["loss"].item()
    assert loss == pytest.approx(1, abs=0.25)
    task = make()
    residual = (task._latents[:, None] - task._filled).std().item()
    assert task.model.spread == pytest.approx(residual)


@pytest.mark.parametrize(("simulated", "kinds"), [(0.0, {0}), (1.0, {1, 2}), (0.5, {0, 1, 2})])
def test_transformations_are_simulated(make, clips, monkeypatch, simulated, kinds):
    task, seen = make(batch=24, simulated=simulated), []
    kind = np.broadcast_to(np.arange(3, dtype=np.uint8)[None, :, None, None, None], clips.rgb.shape)
    task._clips = dataclasses.replace(clips, rgb=kind.copy())
    encode = module.to_tensor
    monkeypatch.setattr(module, "to_tensor", lambda rgb: seen.append(rgb) or encode(rgb))
    with torch.no_grad():
        task.losses(rng())
    drawn = seen[0][:, 0, 0, 0].reshape(24, -1)
    assert set(drawn.ravel().tolist()) == kinds
    assert (drawn == drawn[:, :1]).all()  # a clip is shown in one way
    if len(kinds) > 1:
        assert abs((drawn[:, 0] > 0).mean() - simulated) < 0.25


@pytest.mark.parametrize(("drop", "share"), [(0.0, 0), (1.0, 1)])
def test_conditions_are_dropped_with_their_probability(make, drop, share):
    task, seen = make(batch=16, drop=drop), []
    forward = task.model.forward
    task.model.forward = lambda x, s, c: seen.append(c) or forward(x, s, c)
    with torch.no_grad():
        task.losses(rng())
    assert (seen[0] == 0).all(dim=(1, 2, 3)).float().mean() == share


def test_previews_show_points_samples_and_targets(make, clips):
    task = make()
    picture = task.preview(task.model)
    assert picture.shape == (6 * HEIGHT, 5 * WIDTH, 3)
    # Of clips of two frames, the second is in the middle.
    shown = task._starts[np.linspace(0, len(task._starts) - 1, 6).astype(int)] + 1
    for column, wanted in ((0, clips.rgb[shown, 0]), (4, clips.target[shown])):
        found = picture[:, column * WIDTH : (column + 1) * WIDTH]
        np.testing.assert_allclose(found, wanted.reshape(-1, WIDTH, 3) / 255, atol=1e-6)
    np.testing.assert_array_equal(picture, task.preview(task.model))


def test_settings_data_and_seed_tell_trainings_apart(make, clips):
    darker = dataclasses.replace(clips, target=clips.target // 2)
    emptier = dataclasses.replace(clips, valid=clips.valid & (np.arange(WIDTH) > 3))
    tasks = [make(), make(batch=5), make(simulated=0.1), make(data=darker), make(data=emptier)]
    assert len({task.identity for task in tasks}) == len(tasks)
    assert make().identity == tasks[0].identity
    one, other = (make(seed).model.encoder.stem.weight for seed in (0, 1))
    assert not torch.equal(one, other)


def test_a_loss_that_is_no_number_names_its_batch_and_keeps_weights(make, tmp_path):
    task = make()
    optimise(task, Optimisation(4, 1e-3), 0, "freevs", tmp_path / "fine")
    broken = make()
    broken._latents = broken._latents * torch.nan
    sentence = r"^the loss 'loss' is nan at step 0, whose batch is tiny/\w+/\d, tiny/"
    with pytest.raises(GeoEvsError, match=sentence):
        optimise(broken, Optimisation(4, 1e-3), 0, "freevs", tmp_path / "broken")
    assert (tmp_path / "broken/state.pt").exists()


def test_training_repeats_and_seeds_differ(settings, clips, weights, tmp_path):
    def run(folder, seed):
        made = train_freevs(settings, clips, weights, seed, tmp_path / folder, lambda loss: None)
        return made.denoiser.state_dict()["encoder.head.weight"]

    first, again, other = run("a", 0), run("b", 0), run("c", 1)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_the_steps_make_clips_and_write_down_what_failed(settings, weights, tmp_path, capsys):
    scene, clips = write_tiny_scene(tmp_path / "scene"), tmp_path / "clips.npz"
    prepare_scene("freevs", scene.folder, Inputs(), clips)
    np.testing.assert_array_equal(read_clips([clips]).rgb, make_clips(scene, lambda: None).rgb)

    def run(out, **changed):
        values = dataclasses.asdict(dataclasses.replace(settings, **changed))
        inputs = Inputs(weights=weights)
        train_method("freevs", values, [clips], inputs, 0, tmp_path / "work", out)

    run(tmp_path / "fine")
    sampling = dataclasses.asdict(settings.sampling)
    assert read_json(tmp_path / "fine/settings.json") == {"sampling": sampling}
    assert read_json(tmp_path / "fine/seconds.json")["training"] > 0
    assert not (tmp_path / "work/state.pt").exists()
    run(tmp_path / "failed", frames=7)
    reason = read_json(tmp_path / "failed/failure.json")["reason"]
    assert reason.startswith("no scene under partitions.clips has 7 frames")
    assert reason in capsys.readouterr().err
