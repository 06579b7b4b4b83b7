"""`geoevs train geo-evs`, `train-autoencoder` and `train-prior`."""

import json
import sys
import time
from dataclasses import asdict

import pytest
import torch

from geoevs.cli import main as cli
from geoevs.conditions.artifact_masks import mask_arrays
from geoevs.conditions.pairs import pair_arrays
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json
from geoevs.core.mapped import write_mapped
from geoevs.core.networks import read_network
from geoevs.core.randomness import Rng
from geoevs.diffusion import pretraining
from geoevs.diffusion.prior import load_prior
from geoevs.diffusion.sampling import Sampling
from geoevs.generator.geo_evs.model import Generator
from geoevs.generator.geo_evs.training import Settings
from geoevs.methods.contract import Budget
from geoevs.methods.finding import make_method
from geoevs.methods.tiny import write_tiny_scene
from geoevs.methods.trained import trained_seconds

SETTINGS = asdict(
    Settings(
        prior="nano",
        prediction=None,
        schedule=None,
        steps=3,
        batch=2,
        learning_rate=1e-3,
        drop=0.1,
        encoder="trained",
        validity=True,
        filled=True,
        weighting="uniform",
        timesteps="uniform",
        masks="reprojected",
        probability=0.4,
        sampling=Sampling(steps=2, guidance=1.5),
    )
)


@pytest.fixture
def geoevs(monkeypatch, capsys):
    """Runs a command; gives exit code and standard error."""

    def run(*arguments):
        monkeypatch.setattr(cli, "_log", None)
        monkeypatch.setattr(sys, "argv", ["geoevs", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = end.code or 0
        return code, capsys.readouterr().err

    return run


@pytest.fixture
def train(geoevs, pairs, library, weights, tmp_path):
    write_mapped(tmp_path / "pairs.npz", pair_arrays(pairs))
    write_mapped(tmp_path / "library.npz", mask_arrays(library))

    def run(*arguments, **changed):
        settings = json.dumps(SETTINGS | changed)
        files = ["--files", tmp_path / "pairs.npz", "--combined", tmp_path / "library.npz"]
        folders = ["--weights", weights, "--work", tmp_path / "work", "--out", tmp_path / "out"]
        made_with = ["--settings", settings, "--geometry", "lidar"]
        return geoevs("train", "geo-evs", *files, *folders, *made_with, *arguments)

    return run


def test_training_writes_all_that_renders_need(train, tmp_path):
    geometry = tmp_path / "vggt.safetensors"
    geometry.write_bytes(b"weights")
    assert train("--geometry-weights", geometry) == (0, "")
    out = tmp_path / "out"
    assert sorted(path.name for path in out.iterdir()) == [
        "autoencoder.safetensors",
        "denoiser.safetensors",
        "geometry.safetensors",
        "seconds.json",
        "settings.json",
    ]
    assert read_json(out / "settings.json") == {
        "geometry": "lidar",
        "timesteps": SETTINGS["timesteps"],
        "sampling": {"steps": 2, "guidance": 1.5, "sampler": "ddim", "average": 1},
    }
    assert read_json(out / "seconds.json")["geometry"] == 0.0  # nothing says how long it took
    assert (out / "geometry.safetensors").read_bytes() == b"weights"
    assert Generator.load(out).autoencoder.factor == 2
    # Finished, it leaves nothing that changed code could take up.
    assert sorted(path.name for path in (tmp_path / "work").iterdir()) == ["losses.csv", "previews"]


def test_training_seconds_are_those_of_all_networks(train, tmp_path):
    geometry = tmp_path / "vggt.safetensors"
    geometry.write_bytes(b"weights")
    write_json(tmp_path / "vggt.seconds.json", {"training": 46.0})
    start = time.monotonic()
    assert train("--geometry-weights", geometry)[0] == 0
    seconds = read_json(tmp_path / "out/seconds.json")
    assert seconds["geometry"] == 46.0
    assert 0 < seconds["training"] < time.monotonic() - start
    assert trained_seconds(tmp_path / "out") == sum(seconds.values())


def test_the_same_seed_trains_the_same_bytes(train, tmp_path):
    files = []
    for seed in (0, 0, 1):
        assert train("--seed", seed)[0] == 0
        files.append((tmp_path / "out/denoiser.safetensors").read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_mistakes_are_one_sentence_before_anything_is_trained(train, tmp_path, weights):
    code, error = train(stepps=3)
    assert code == 1
    sentence = "the training of 'geo-evs' has no option 'stepps'; did you mean 'steps'?"
    assert error.startswith(f"error: {sentence}")
    code, error = train(masks="box")
    assert code == 1
    assert "cannot have 'box' for its option 'masks'; did you mean 'boxes'?" in error
    missing = tmp_path / "none"
    sentence = f"error: {missing} is missing; make or copy it there\n"
    assert train("--geometry-weights", missing) == (1, sentence)
    assert not (tmp_path / "work").exists()
    assert not (tmp_path / "out").exists()


def test_a_failed_training_is_written_down_for_the_methods_that_take_it(train, tmp_path, weights):
    (weights / "prior.safetensors").unlink()
    code, error = train()
    assert code == 0
    assert error.startswith(f"error: {weights / 'prior.safetensors'} is missing; make it again")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["failure.json"]
    with pytest.raises(GeoEvsError, match=r"^its training failed: .*prior.safetensors is missing"):
        make_method("geo-evs", {"weights": str(tmp_path / "out")}).fit(None, Budget(), Rng(0))


def test_a_diverged_training_keeps_its_last_good_weights(train, tmp_path):
    code, error = train(learning_rate=1e14)
    assert code == 0
    assert " is nan at step " in error or " is inf at step " in error
    assert "whose batch is scene-" in error
    assert f"the last good weights are in {tmp_path / 'work/state.pt'}" in error
    assert error.count("\n") == 1
    assert f"error: {read_json(tmp_path / 'out/failure.json')['reason']}\n" == error
    assert (tmp_path / "work/state.pt").exists()


def test_autoencoder_and_prior_are_what_a_training_starts_from(
    geoevs, networks, monkeypatch, tmp_path
):
    monkeypatch.setattr(pretraining, "nano_autoencoder", lambda: networks.network(48))
    monkeypatch.setattr(pretraining, "nano_unet", networks.unet)
    scene = write_tiny_scene(tmp_path / "scene").folder
    shared = ["--scenes", scene, "--steps", 2, "--batch", 2, "--learning-rate", 1e-3]
    autoencoder, prior = (tmp_path / f"{name}.safetensors" for name in ("autoencoder", "prior"))
    arguments = [*shared, "--work", tmp_path / "a", "--out", autoencoder, "--crop", 16]
    assert geoevs("train-autoencoder", *arguments) == (0, "")
    arguments = [*shared, "--work", tmp_path / "p", "--out", prior, "--autoencoder", autoencoder]
    assert geoevs("train-prior", *arguments) == (0, "")
    for file in (autoencoder, prior):
        assert {value.dtype for value in read_network(file)[1].values()} == {torch.float16}
    assert load_prior("nano", tmp_path).autoencoder.factor == 4
    for work in ("a", "p"):
        assert not (tmp_path / work / "state.pt").exists()
        assert (tmp_path / work / "losses.csv").read_text().count("\n") == 3
