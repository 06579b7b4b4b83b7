"""Training: to the same bytes after a kill, stopped by NaN, and what it refuses; then detection."""

import re
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.core.images import read_image
from geoevs.core.parquet import write_parquet
from geoevs.core.randomness import Rng
from geoevs.detection.bevformer import training
from geoevs.detection.bevformer.backbone import load_backbone, new_backbone, save_backbone
from geoevs.detection.bevformer.detecting import detect
from geoevs.detection.bevformer.features import cache_features, read_features
from geoevs.detection.bevformer.network import load_bevformer, save_bevformer
from geoevs.detection.bevformer.settings import Fitting
from geoevs.detection.bevformer.training import DetectorTask, train, train_backbone
from geoevs.detection.rows import PREDICTION_TYPES, read_predictions

FITTING = Fitting(steps=4, learning_rate=1e-3, backbone_steps=3)


@pytest.fixture(scope="module")
def frames(make_frame):
    """Two scenes of three and two frames."""
    numbers = [("a", 0), ("a", 1), ("a", 2), ("b", 0), ("b", 1)]
    return [make_frame(scene=scene, frame=n, x=2.0 * n) for scene, n in numbers]


@pytest.fixture(scope="module")
def backbone(detector, tmp_path_factory):
    path = tmp_path_factory.mktemp("backbone") / "backbone.safetensors"
    made = new_backbone(detector, 0)
    with torch.no_grad():
        made.network.stem.bias.fill_(-0.0)  # averaged, it is 0: the same backbone
    save_backbone(path, made)
    return path


@pytest.fixture(scope="module")
def cached(frames, detector, backbone, tmp_path_factory):
    folder, found = tmp_path_factory.mktemp("features"), []
    for frame in frames:
        path = folder / f"{frame.scene}-{frame.frame}.npz"
        cache_features(frame, load_backbone(backbone), detector.image, path)
        found.append(read_features(path))
    return found


@contextmanager
def killed_at(step):
    done = 0

    def report(loss):
        nonlocal done
        done += 1
        if done == step:
            raise KeyboardInterrupt

    yield report


def test_a_killed_training_goes_on_to_the_same_bytes(
    cached, backbone, detector, tmp_path, monkeypatch
):
    whole, resumed = tmp_path / "whole.safetensors", tmp_path / "resumed.safetensors"
    train(cached, backbone, detector, FITTING, 0, tmp_path / "work", whole)
    with monkeypatch.context() as patch:
        patch.setattr(training, "training_bar", lambda title, steps: killed_at(3))
        with pytest.raises(KeyboardInterrupt):
            train(cached, backbone, detector, FITTING, 0, tmp_path / "killed", resumed)
    assert (tmp_path / "killed/state.pt").exists()
    assert not resumed.exists()
    assert train(cached, backbone, detector, FITTING, 0, tmp_path / "killed", resumed) > 0
    assert whole.read_bytes() == resumed.read_bytes()
    for name in ("losses.csv", "previews/000004.png"):
        assert (tmp_path / "work" / name).read_bytes() == (tmp_path / "killed" / name).read_bytes()
    assert not (tmp_path / "killed/state.pt").exists()
    head, *rows = (tmp_path / "work/losses.csv").read_text().splitlines()
    assert head == "step,loss,classes,boxes,heat"
    assert len(rows) == 4
    # Two rows of views three times enlarged, and the map: 24 m ahead, 24 m across.
    assert read_image(tmp_path / "work/previews/000004.png").shape == (96, 3 * 72 + 96, 3)
    other = tmp_path / "other.safetensors"
    train(cached, backbone, detector, FITTING, 1, tmp_path / "other", other)
    assert other.read_bytes() != whole.read_bytes()
    found = detect(whole, cached)
    assert len(found) == 5 * min(6 * 4, detector.predictions)


def test_a_loss_that_is_no_number_stops_it(frames, backbone, detector, tmp_path):
    broken = [replace(frame, images=frame.images * np.nan) for frame in frames]
    out = tmp_path / "detector.safetensors"
    with pytest.raises(GeoEvsError, match=r"is nan at step 0, whose batch is [ab]/\d; lower the"):
        train(broken, backbone, detector, FITTING, 0, tmp_path / "work", out)
    assert not out.exists()


def test_only_a_backbone_that_learns_changes(frames, backbone, detector, tmp_path):
    out = tmp_path / "detector.safetensors"
    for end_to_end in (False, True):
        fitting = replace(FITTING, steps=2, end_to_end=end_to_end, flip=True, jitter=True)
        train(frames, backbone, detector, fitting, 0, tmp_path / "work", out)
        same = load_bevformer(out).backbone.identity == load_backbone(backbone).identity
        assert same != end_to_end


def test_the_small_backbone_learns_with_a_detector(frames, detector, tmp_path):
    paths = [tmp_path / f"{n}.safetensors" for n in range(2)]
    for path in paths:
        train_backbone(frames, detector, FITTING, 0, tmp_path / path.stem, path, tmp_path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert load_backbone(paths[0]).identity != new_backbone(detector, 0).identity
    assert len((tmp_path / "0/losses.csv").read_text().splitlines()) == 1 + FITTING.backbone_steps


def test_a_pretrained_backbone_is_only_written(detector, tmp_path):
    path, pretrained = tmp_path / "b.safetensors", replace(detector, backbone="autoencoder")
    with pytest.raises(GeoEvsError, match="no weights here"):
        train_backbone([], pretrained, FITTING, 0, tmp_path, path, tmp_path)
    assert not path.exists()


def test_losses_of_features_are_those_of_pictures(frames, cached, make_model, backbone):
    model = make_model()
    model.backbone = load_backbone(backbone)
    losses = [
        DetectorTask(model, some, FITTING).losses(Rng(0, "step")) for some in (frames, cached)
    ]
    for name, value in losses[0].items():
        assert losses[1][name].item() == pytest.approx(value.item(), rel=0.01)


def test_earlier_frames_are_drawn_from_one_more_than_are_looked_at(frames, make_model):
    for history, longest in ((0, 0), (1, 1), (2, 2)):
        task = DetectorTask(make_model(history=history), frames, FITTING)
        drawn = set()
        for n in range(20):
            earlier, now = task._queue(2, Rng(0, str(n)))
            assert now is frames[2]
            drawn.add(tuple(frame.frame for frame in earlier))
        wanted = {0: {()}, 1: {(0,), (1,)}, 2: {(0, 1)}}[longest]
        assert drawn == wanted
        assert task._queue(3, Rng(0, "first"))[0] == []  # another scene's


def test_frames_are_mirrored_together_and_jittered_apart(frames, make_model):
    task = DetectorTask(make_model(), frames, replace(FITTING, flip=True, jitter=True))
    sides = set()
    for n in range(10):
        (earlier,), now = task._queue(1, Rng(0, str(n)))
        assert earlier.frame == 0
        mirrored = [one.boxes[0, 1] < 0 for one in (earlier, now)]
        assert mirrored[0] == mirrored[1]
        sides.add(mirrored[0])
        plain = frames[1].images[:, :, ::-1] if mirrored[1] else frames[1].images
        change = now.images - plain
        assert len({round(float(view.mean()), 4) for view in change}) == 5
        assert (now.images >= 0).all()
        assert (now.images <= 1).all()
    assert sides == {True, False}


@pytest.mark.parametrize("name", ["flip", "jitter", "end_to_end"])
def test_what_needs_pictures_refuses_features(cached, make_model, name):
    with pytest.raises(GeoEvsError, match="a/0 has features and no pictures, which flip, jitter"):
        DetectorTask(make_model(), cached, replace(FITTING, **{name: True}))


def test_frames_that_nothing_can_be_learned_from_are_refused(frames, make_model, detector):
    empty = [replace(one, boxes=np.zeros((0, 7)), classes=np.zeros(0, int)) for one in frames]
    with pytest.raises(GeoEvsError, match="none of the 5 frames has a box to learn from"):
        DetectorTask(make_model(), empty, FITTING)
    other = [replace(one, classes=np.array([0, 2])) for one in frames]
    with pytest.raises(GeoEvsError, match="a/0 has a box of a class that is none of 2"):
        DetectorTask(make_model(), other, FITTING)
    with pytest.raises(GeoEvsError, match="not ordered in time"):
        DetectorTask(make_model(), frames[::-1], FITTING)
    far = [replace(one, boxes=one.boxes + 100) for one in frames]
    assert DetectorTask(make_model(), far, FITTING).losses(Rng(0, "far"))["boxes"].item() == 0


def test_a_backbone_of_another_kind_is_refused(frames, backbone, detector, tmp_path):
    other = replace(detector, backbone="autoencoder")
    with pytest.raises(GeoEvsError, match="is the backbone 'cnn', and the detector's is 'autoenc"):
        train(frames, backbone, other, FITTING, 0, tmp_path, tmp_path / "d.safetensors")


@pytest.fixture
def weights(make_model, tmp_path):
    def write(**values):
        path = tmp_path / "detector.safetensors"
        save_bevformer(path, make_model(**values))
        return path

    return write


def test_rows_are_predictions(frames, weights, tmp_path):
    rows = detect(weights(predictions=7), frames)
    assert rows.dtypes.astype(str).to_dict() == PREDICTION_TYPES
    assert len(rows) == 5 * 7
    write_parquet(tmp_path / "predictions.parquet", rows)
    pd.testing.assert_frame_equal(read_predictions(tmp_path / "predictions.parquet"), rows)
    low, high = np.array((-4.0, -12.0, -0.4)), np.array((20.0, 12.0, 2.6))
    centres = rows[["x", "y", "z"]].to_numpy()
    assert ((centres >= low) & (centres <= high)).all()
    for _, frame in rows.groupby(["scene", "frame"]):
        assert frame["score"].is_monotonic_decreasing


def test_a_scene_begins_without_a_past(frames, weights):
    path = weights()
    together, first = detect(path, frames), detect(path, frames[3:])
    again = together[together["scene"] == "b"].reset_index(drop=True)
    pd.testing.assert_frame_equal(again, first)
    later = detect(path, frames[4:])  # the second frame of b, as if it were the first
    second = again[again["frame"] == 1].reset_index(drop=True)
    assert not np.allclose(later["score"], second["score"])


def test_without_history_every_frame_is_by_itself(frames, weights):
    path = weights(history=0)
    together = detect(path, frames)
    for frame in frames:
        mine = (together["scene"] == frame.scene) & (together["frame"] == frame.frame)
        pd.testing.assert_frame_equal(together[mine].reset_index(drop=True), detect(path, [frame]))


def test_detection_refuses_what_it_cannot_use(frames, cached, weights, tmp_path):
    with pytest.raises(GeoEvsError, match=re.escape("b/0 has features") + "|another backbone"):
        detect(weights(), cached)
    with pytest.raises(GeoEvsError, match="not ordered in time"):
        detect(weights(), frames[::-1])
    with pytest.raises(GeoEvsError, match="is missing"):
        detect(tmp_path / "none.safetensors", frames)
