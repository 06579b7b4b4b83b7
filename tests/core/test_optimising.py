"""The training loop: resumable to the same bytes, averaged by hand, stopped by the first NaN."""

import csv
import math
import sys

import numpy as np
import pytest
import torch
from torch import nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import mixed_precision, seeded
from geoevs.core.optimising import Optimisation, fingerprint, finish, optimise, training_seconds
from geoevs.core.progress import training_bar
from geoevs.core.randomness import Rng

STEPS = 40  # saved every second one, shown every tenth


class Line(nn.Module):
    """y = slope x, which counts how often it is asked."""

    def __init__(self):
        super().__init__()
        self.slope = nn.Parameter(torch.tensor(1.0))
        self.register_buffer("asked", torch.tensor(0.0))


class LineTask:
    """Learn y = 3 x; `spoil` may change the loss of a step."""

    def __init__(self, identity="line", spoil=lambda loss, step: loss):
        self.model, self.identity, self.spoil = Line(), identity, spoil
        self.step = 0

    def losses(self, rng):
        x = torch.randn(4, generator=rng.torch)
        self.model.asked += 1
        error = (self.model.slope * x - 3 * x).square().mean()
        loss = self.spoil(error, int(self.model.asked) - 1)
        return {"loss": loss, "error": error}

    def batch(self, rng):
        return [f"x{value:.3f}" for value in torch.randn(4, generator=rng.torch)]

    def preview(self, model):
        return np.full((2, 3, 3), model.slope.item() / 4, np.float32)


class Killed(BaseException):
    """What nothing catches."""


def killer(moment):
    """A report that is killed at its call number `moment`."""
    calls = []

    def report(loss):
        calls.append(loss)
        if len(calls) == moment:
            raise Killed

    return report


def run(folder, task=None, seed=0, key="k", report=lambda loss: None, began=None, **settings):
    optimisation = Optimisation(STEPS, 0.1, **settings)
    return optimise(task or LineTask(), optimisation, seed, key, folder, report, began)


def contents(folder):
    """Losses and pictures, to the byte."""
    files = [folder / "losses.csv", *sorted((folder / "previews").iterdir())]
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def test_the_learning_rate_rises_linearly_and_falls_as_a_cosine():
    at = Optimisation(steps=100, learning_rate=2.0, warmup=0.05).learning_rate_at
    assert [at(step) for step in (0, 1, 3)] == pytest.approx([0.4, 0.8, 1.6])  # of five
    # 1 + cos(pi / 2) and 1 + cos(0.99 pi), by hand.
    assert at(50) == pytest.approx(1.0)
    assert at(99) == pytest.approx(1 - 0.99950656)
    assert Optimisation(steps=1, learning_rate=2.0).learning_rate_at(0) == 2.0


def test_the_first_weights_are_soon_forgotten():
    at = Optimisation(steps=1, learning_rate=1.0, average=0.9).average_at
    assert [at(step) for step in (0, 8, 79, 80, 10**6)] == [0.1, 0.5, 80 / 89, 0.9, 0.9]


def test_the_first_step_is_adams_by_hand(tmp_path):
    task = LineTask()
    optimise(task, Optimisation(1, 0.01, weight_decay=0.5), 0, "k", tmp_path)
    # Without momentum Adam steps by the learning rate, here upwards; weights decay beside it.
    assert task.model.slope.item() == pytest.approx(1.0 * (1 - 0.01 * 0.5) + 0.01, abs=1e-6)


def test_weights_are_averaged_by_hand(tmp_path):
    task, slopes = LineTask(), []
    averaged = run(tmp_path, task, report=lambda loss: slopes.append(task.model.slope.item()))
    mean = 1.0
    for step, slope in enumerate(slopes):
        decay = min(0.995, (1 + step) / (10 + step))
        mean = decay * mean + (1 - decay) * slope
    assert len(slopes) == STEPS
    assert float(averaged.slope) == pytest.approx(mean, abs=1e-5)
    assert float(averaged.asked) == STEPS  # a buffer is copied, not averaged
    assert not averaged.training
    assert not averaged.slope.requires_grad
    assert abs(slopes[-1] - 3) < 0.2


# Before anything is saved; between savings; at one; at a picture; at the end.
@pytest.mark.parametrize("moment", [1, 7, 8, 20, STEPS])
def test_a_killed_training_goes_on_to_the_same_bytes(tmp_path, moment):
    whole = run(tmp_path / "whole")
    with pytest.raises(Killed):
        run(tmp_path / "killed", report=killer(moment))
    reported = []
    resumed = run(tmp_path / "killed", report=reported.append)
    # The last even step before the kill was saved.
    assert [math.isnan(loss) for loss in reported].count(True) == (moment - 1) // 2 * 2
    assert len(reported) == STEPS
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
    assert torch.equal(resumed.slope, whole.slope)
    assert sorted(contents(tmp_path / "whole")) == [
        "losses.csv",
        *(f"previews/0000{step}.png" for step in (10, 20, 30, 40)),
    ]


def test_a_training_killed_at_a_picture_draws_it_again(tmp_path):
    class Clumsy(LineTask):
        def preview(self, model):
            if int(model.asked) == 20:
                raise Killed
            return super().preview(model)

    run(tmp_path / "whole")
    with pytest.raises(Killed):
        run(tmp_path / "killed", Clumsy())
    run(tmp_path / "killed")
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")


def test_a_finished_training_is_not_repeated(tmp_path):
    first, reported = run(tmp_path), []
    again = run(tmp_path, report=reported.append)
    assert torch.equal(again.slope, first.slope)
    assert len(reported) == STEPS
    assert all(math.isnan(loss) for loss in reported)
    finish(tmp_path)
    run(tmp_path, report=reported.append)
    assert not any(math.isnan(loss) for loss in reported[STEPS:])


@pytest.mark.parametrize(
    "other", [{"seed": 1}, {"key": "other"}, {"task": LineTask("other")}, {"warmup": 0.2}]
)
def test_another_training_starts_over(tmp_path, other, monkeypatch):
    clock = iter(range(10**6))
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    first = run(tmp_path / "shared")
    (tmp_path / "shared/previews/000005.png").write_bytes(b"of a longer one")
    second = run(tmp_path / "shared", **other)
    if "task" in other:
        other = {"task": LineTask("other")}
    else:  # the task's identity decides no batch
        assert not torch.equal(second.slope, first.slope)
    alone = run(tmp_path / "alone", **other)
    assert torch.equal(second.slope, alone.slope)
    assert contents(tmp_path / "shared") == contents(tmp_path / "alone")
    assert training_seconds(tmp_path / "shared") == training_seconds(tmp_path / "alone")


def test_seconds_are_those_of_all_parts_that_were_kept(tmp_path, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])

    def tick(then=lambda loss: None):
        def report(loss):
            if not math.isnan(loss):
                clock[0] += 1
            then(loss)

        return report

    with pytest.raises(Killed):  # when six steps were saved
        run(tmp_path, report=tick(killer(7)), began=90.0)
    assert training_seconds(tmp_path) == 10 + 6
    clock[0] = 500.0
    run(tmp_path, report=tick(), began=480.0)
    assert training_seconds(tmp_path) == 10 + 20 + STEPS
    finish(tmp_path)
    with pytest.raises(GeoEvsError, match=r"state.pt is missing"):
        training_seconds(tmp_path)


def test_other_first_weights_are_another_training(tmp_path):
    run(tmp_path)
    task, reported = LineTask(), []
    task.model.slope.data += 0.5
    run(tmp_path, task, report=reported.append)
    assert not any(map(math.isnan, reported))


def spoiled(how, at):
    return LineTask(spoil=lambda loss, step: how(loss) if step == at else loss)


SPOILERS = {
    "the loss 'loss' is nan": lambda loss: loss * math.nan,
    "the loss 'loss' is inf": lambda loss: loss + math.inf,
    # Of zero, the root is finite and its slope is not.
    "the gradient's norm is nan": lambda loss: loss + (loss * 0).sqrt(),
}


@pytest.mark.parametrize("at", [0, 7])
@pytest.mark.parametrize("what", SPOILERS)
def test_a_nan_names_step_and_batch_and_keeps_the_last_good_weights(tmp_path, what, at):
    good = LineTask()
    slopes = [good.model.slope.item()]
    run(tmp_path / "good", good, report=lambda loss: slopes.append(good.model.slope.item()))
    task = spoiled(SPOILERS[what], at)
    folder = tmp_path / "bad"
    with pytest.raises(GeoEvsError) as caught:
        run(folder, task)
    names = ", ".join(task.batch(Rng(0, "k", str(at))))
    assert str(caught.value) == (
        f"{what} at step {at}, whose batch is {names}; lower the learning rate or mend those "
        f"samples (the last good weights are in {folder / 'state.pt'})"
    )
    state = torch.load(folder / "state.pt", weights_only=True)
    assert state["step"] == at
    assert float(state["model"]["slope"]) == slopes[at]
    with open(folder / "losses.csv", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == (["step", "loss", "error"] if at else ["step"])
    assert [row[0] for row in rows[1:]] == [str(step) for step in range(at)]
    # It stops there again; once mended it goes on as if nothing had been.
    with pytest.raises(GeoEvsError, match=f"at step {at}, "):
        run(folder, spoiled(SPOILERS[what], int(state["model"]["asked"])))
    run(folder)
    assert (folder / "losses.csv").read_bytes() == (tmp_path / "good/losses.csv").read_bytes()


def test_losses_are_logged(tmp_path):
    reported = []
    run(tmp_path, report=reported.append)
    rows = np.loadtxt(tmp_path / "losses.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows[:, 0], np.arange(STEPS))
    np.testing.assert_allclose(rows[:, 1], reported, rtol=1e-5)


def test_a_damaged_state_is_one_sentence(tmp_path):
    run(tmp_path)
    state = tmp_path / "state.pt"
    state.write_bytes(state.read_bytes()[:-100])
    with pytest.raises(GeoEvsError, match=f"^{state} is not whole .*; delete it and make it again"):
        run(tmp_path)


def test_fingerprints_tell_values_types_shapes_and_order_apart():
    zeros = np.zeros((2, 3), np.float32)
    parts = [
        (zeros, 1),
        (1, zeros),
        (zeros + 1, 1),
        (zeros.T, 1),
        (zeros.astype(np.int32), 1),
        (zeros, 2),
        ({"a": 1},),
        ({"a": 2},),
    ]
    assert len({fingerprint(*part) for part in parts}) == len(parts)
    flipped = np.arange(6.0)[::-1]
    assert fingerprint(flipped) == fingerprint(torch.tensor(flipped.copy()))


def test_first_weights_are_a_function_of_seed_and_key():
    def weights(seed, *key):
        with seeded(seed, *key):
            return torch.randn(4)

    before = torch.get_rng_state()
    first = weights(0, "a")
    assert torch.equal(first, weights(0, "a"))
    assert not torch.equal(first, weights(1, "a"))
    assert not torch.equal(first, weights(0, "b"))
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize(("found", "dtype"), [(True, torch.bfloat16), (False, torch.float32)])
def test_half_precision_is_used_where_it_is_fast(monkeypatch, found, dtype):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": found})
    with mixed_precision(torch.device("cpu")):
        assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == dtype


def test_the_estimate_counts_only_what_is_left(monkeypatch, capsys):
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False, raising=False)
    with training_bar("net", 35) as report:
        for _ in range(10):  # done before it was killed, read in a second each
            clock[0] += 1
            report(math.nan)
        for _ in range(25):
            clock[0] += 12
            report(0.5)
    # Fifteen steps of twelve seconds were left after ten.
    assert capsys.readouterr().err == "net: 35 steps, about 3.0 minutes left\n"
