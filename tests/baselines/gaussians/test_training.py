"""Training of nodes, and the choice of their number, on views of a wall."""

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from baselines.gaussians import size, training
from baselines.gaussians.densification import GradientStrategy, MCMCStrategy, Schedule
from baselines.gaussians.initialisation import starting_points
from baselines.gaussians.model import gaussians_from_points
from baselines.gaussians.nodes import Background, SceneGraph, Sky
from baselines.gaussians.size import HELD_OUT, SizeChoice, held_out, psnr
from baselines.gaussians.training import Trainer, make_strategy, photos_of, train
from geoevs.core.errors import GeoEvsError

ASIDE = [(0.0, 0.25 * frame, 1.6) for frame in range(HELD_OUT)]
STEPS = 120


@pytest.fixture(scope="module")
def photos(views_of_wall):
    return photos_of(views_of_wall(ASIDE, needs=("lidar",)), "cpu")


@pytest.fixture
def make_trainer(views_of_wall, generator):
    """A trainer of Gaussians from the wall's LiDAR."""
    views = views_of_wall(ASIDE, needs=("lidar",))

    def make(count=300, cap=300, steps=STEPS, densification="mcmc", own_loss=lambda *_: 0.0):
        points = starting_points(views, count, np.random.default_rng(0), "lidar")
        graph = SceneGraph(Background(gaussians_from_points(points.xyz, points.rgb, 1)))
        graph.sky = Sky(torch.full((3, 4, 8), 0.5))
        strategy = make_strategy(densification, cap, steps)
        return Trainer(graph, steps, {"background": 5.0}, strategy, own_loss, generator)

    return make


def run(trainer, photos, choice=None, until=math.inf):
    reports = []
    generator = torch.Generator().manual_seed(0)
    report = lambda loss, more: reports.append((loss, more))  # noqa: E731
    return train(trainer, photos, choice, until, generator, report), reports


def test_training_makes_the_views_right(make_trainer, photos):
    trainer = make_trainer(count=1000, cap=1200)
    before = psnr(trainer.graph, photos)
    steps, reports = run(trainer, photos)
    assert steps == len(reports) == STEPS
    assert psnr(trainer.graph, photos) > before + 3
    assert len(trainer.graph) == 1200
    assert reports[-1][0] < reports[0][0]
    assert reports[-1][1].endswith(" it/s, 1,200 Gaussians")
    assert not torch.equal(trainer.graph.sky.colours, torch.full((3, 4, 8), 0.5))


def test_two_trainings_of_one_seed_are_the_same_bytes(make_trainer, photos):
    made = []
    for _ in range(2):
        trainer = make_trainer(steps=20)
        trainer._generator.manual_seed(3)
        run(trainer, photos, SizeChoice(20))
        made.append(trainer.graph.background.gaussians.means.detach().numpy().tobytes())
    assert made[0] == made[1]


def test_an_end_in_time_is_an_end(make_trainer, photos):
    steps, reports = run(make_trainer(), photos, until=time.monotonic())
    assert (steps, reports) == (0, [])


@pytest.mark.parametrize("guilty", ["sh0 of background", "colours of sky"])
def test_a_broken_gradient_names_itself_and_changes_nothing(make_trainer, photos, guilty):
    def broken(graph, photo, drawn, done):
        value = graph.sky.colours if "sky" in guilty else graph.background.gaussians.sh0
        return value.sum() * (torch.nan if done >= 0.5 else 0.0)

    trainer = make_trainer(steps=8, own_loss=broken)
    for step in range(4):
        trainer.advance(step, photos[0])
    good = [tensor.detach().clone() for _, tensor in learned(trainer)]
    with pytest.raises(GeoEvsError, match=f"gradient of {guilty} is not finite at step 4;"):
        trainer.advance(4, photos[0])
    for (name, tensor), kept in zip(learned(trainer), good, strict=True):
        assert torch.equal(tensor, kept), name


def learned(trainer):
    graph = trainer.graph
    return [*graph.background.gaussians.named_parameters(), ("colours", graph.sky.colours)]


def test_strategies_act_in_fixed_shares_of_a_training():
    strategy = make_strategy("gradient", 9, 30_000)
    assert isinstance(strategy, GradientStrategy)
    assert strategy.schedule == Schedule(start=1200, stop=16_500, every=240)
    assert (strategy.reset_every, strategy.cap) == (3000, 9)
    assert isinstance(make_strategy("mcmc", 9, 10), MCMCStrategy)
    with pytest.raises(GeoEvsError, match="no densification 'mcm'; did you mean 'mcmc'"):
        make_strategy("mcm", 9, 10)


def test_free_gaussians_are_all_kept(make_trainer, photos):
    trainer = make_trainer()
    run(trainer, photos, SizeChoice(STEPS, price=-1.0))
    assert len(trainer.graph) == 300


def test_dear_gaussians_are_deleted_to_the_last_round(make_trainer, photos):
    trainer = make_trainer()
    run(trainer, photos, SizeChoice(STEPS, price=1.0))
    count = 300
    for _ in range(size.ROUNDS):
        count -= int(size.DELETED * count)
    assert len(trainer.graph) == count


def test_held_out_views_teach_only_after_the_choice(make_trainer, photos, monkeypatch):
    trainer, choice = make_trainer(), SizeChoice(STEPS)
    seen = []
    advance = trainer.advance
    monkeypatch.setattr(
        trainer, "advance", lambda step, photo: seen.append(photo) or advance(step, photo)
    )
    run(trainer, photos, choice)
    (held,) = choice.held
    assert held is photos[-1]
    first = next(step for step, photo in enumerate(seen) if photo is held)
    assert round(size.START * STEPS) < first < STEPS


@pytest.mark.parametrize("cameras", range(1, 10))
def test_held_out_views_are_of_all_cameras(cameras):
    places = held_out(HELD_OUT * cameras, cameras)
    assert {place % cameras for place in places} == set(range(cameras))
    assert all(HELD_OUT * n <= place < HELD_OUT * (n + 1) for n, place in enumerate(places))


def test_a_deletion_that_nothing_judged_is_undone(make_trainer, photos, monkeypatch):
    deleted = []

    def delete(*arguments):
        real(*arguments)
        deleted.append(time.monotonic())

    real = size.delete
    monkeypatch.setattr(size, "delete", delete)
    # Time is up right after the first deletion.
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + 1e6 * len(deleted))
    monkeypatch.setattr(training, "time", clock)
    trainer = make_trainer()
    steps, _ = run(trainer, photos, SizeChoice(STEPS), until=time.monotonic() + 1e5)
    assert steps == round(size.START * STEPS) + 1
    assert len(trainer.graph) == 300


def test_what_shows_least_goes_first(make_trainer, photos):
    trainer = make_trainer()
    gaussians = trainer.graph.background.gaussians
    with torch.no_grad():
        gaussians.logit_opacities[:90] = -4.0
    kept = gaussians.means[90:].detach().clone()
    size.delete(trainer.graph, trainer.optimisers["background"], photos)
    assert len(gaussians) == 210
    # A few others are outside all views.
    assert (gaussians.means[:, None] == kept).all(-1).any(0).float().mean() > 0.9


def test_psnr_is_the_mean_over_views(photos, make_trainer):
    graph = make_trainer().graph
    expected = [
        -10
        * math.log10(
            (graph.draw(p.camera, 0).picture.rgb.clamp(0, 1) - p.image).square().mean().item()
        )
        for p in photos[:2]
    ]
    assert psnr(graph, photos[:2]) == pytest.approx(np.mean(expected), abs=1e-4)
