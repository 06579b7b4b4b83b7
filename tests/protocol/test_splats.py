"""Gaussians of a run's saved entrants as files, whatever the method, and what is refused."""

import json
import shutil

import pytest

import baselines
from geoevs import layout
from geoevs.core.files import write_json
from geoevs.methods.tiny import FRAMES, write_tiny_scene

MOVER = """
from dataclasses import dataclass
import numpy as np
from geoevs.methods.contract import MethodInfo
from geoevs.scenes.splats import Splats

@dataclass
class Method:
    info = MethodInfo("Mover", "reconstruction")
    step: float
    sky: bool

    def splats(self, frame, far=False):
        rest = np.ones((1, 4)), np.zeros((1, 3)), np.zeros(1), np.zeros((1, 1, 3))
        sky = self.splats(frame, True) if self.sky and not far else None
        if self.step < 0:
            return self.step
        place = np.array([[1000.0 if far else self.step * frame, 0.0, 0.0]])
        return Splats(*(np.float32(part) for part in (place, *rest)), sky)

    @classmethod
    def load(cls, folder):
        step, sky = (folder / "step").read_text().split()
        return cls(float(step), sky == "sky")
"""

FINE = {"status": "ok", "stage": "", "reason": "", "log": ""}
FINE |= {"threads": 1, "peak_memory": 1, "gpu_memory": 0}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("splats") / "scene").folder


@pytest.fixture
def run(scene, tmp_path, monkeypatch):
    """A run with entrants of a method that is made of Gaussians, and others."""
    methods = tmp_path / "methods"
    (methods / "mover").mkdir(parents=True)
    (methods / "mover/adapter.py").write_text(MOVER)
    monkeypatch.setattr(baselines, "__path__", [*baselines.__path__, str(methods)])
    run = tmp_path / "run"
    shutil.copytree(scene, run / layout.SCENE.format(dataset="d", scene="s@0-1"))
    saved = {"mover": "0.5 sky", "mover.still.seed1": "0 none", "mover.damaged": "x none"}
    saved["mover.odd"] = "-1 none"
    for label in (*saved, "gone.one", "mean-colour", "truth", "mover.failed", "mover.front"):
        folder = run / layout.MODEL.format(dataset="d", scene="s@0-1", label=label)
        sources = "front-side" if label == "mover.front" else "all-cameras"
        outcome = dict(FINE)
        if label == "mover.failed":
            outcome |= {"status": "failed", "stage": "fit", "reason": "no points"}
        write_json(folder / "fit.json", {sources: outcome})
        (folder / sources / "model").mkdir(parents=True)
        (folder / sources / "model/step").write_text(saved.get(label, ""))
    return run


def export(geoevs, run, scene, label):
    return geoevs("export-splats", run, scene, label, "--out", run.parent / "out")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_each_frame_is_a_pair_of_files_and_the_sky_another(geoevs, run):
    code, text, errors = export(geoevs, run, "d/s@0-1", "mover")
    out = run.parent / "out"
    assert (code, errors) == (0, "")
    pairs = [f"{frame:06d}.{end}" for frame in FRAMES for end in ("ply", "spz")]
    assert names(out) == [*pairs, "about.json", "sky.ply", "sky.spz"]
    wrote, world, sky = text.splitlines()
    assert wrote == f"wrote {out}: mover, 2 frames, each as .ply and .spz"
    assert world == "metres in the world of the scene store, z up, which is that of its source"
    assert "a shell of 1 far Gaussians, sky.ply" in sky
    head = (out / "000001.ply").read_bytes().split(b"element vertex 1\n")[0].decode()
    comments = [line.removeprefix("comment ") for line in head.splitlines()[2:]]
    first = "mover of d/s@0-1, made by geoevs export-splats; frame 1, 0.1 s"
    assert comments == [first, world, sky, "licence of the scene: CC0-1.0"]
    about = json.loads((out / "about.json").read_text())
    assert about["gaussians"] == {"000000": 1, "000001": 1, "sky": 1}
    assert (about["world"], about["sky"], about["origin"]) == (world, sky, [0, 0, 0])


def test_where_nothing_moves_one_pair_is_enough_and_an_origin_is_said(geoevs, run):
    path = run / "scenes/d/s@0-1/scene.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "origin": [500.0, -7, 0]}))
    code, text, errors = export(geoevs, run, "s@0-1", "mover.still.seed1")
    assert (code, errors) == (0, "")
    assert names(run.parent / "out") == ["about.json", "all-frames.ply", "all-frames.spz"]
    wrote, world, sky = text.splitlines()
    assert "all frames in one, since nothing moves" in wrote
    assert world.endswith("z up; add 500, -7, 0 for its source's own")
    assert (
        sky == "mover.still.seed1 has no sky apart: what it shows of one is among these Gaussians"
    )


@pytest.mark.parametrize(
    ("name", "label", "sentence"),
    [
        ("s@0-2", "mover", "'s@0-2' is no scene with models in RUN; did you mean 's@0-1'? (one of"),
        ("s@0-1", "movr", "there is no model of 'movr' on d/s@0-1; did you mean 'mover'? (one of"),
        ("s@0-1", "truth", "there is no model of 'truth' on d/s@0-1; one of: gone.one, "),
        ("s@0-1", "mean-colour", "'mean-colour' is not made of Gaussians, so it has none to export;"
         " of this scene, mover, mover.damaged, mover.failed, mover.front, mover.odd, mover.s"),
        ("s@0-1", "gone.one", "MODELS/gone.one cannot be opened without its method: there is no "
         "method called 'gone'; one of"),
        ("s@0-1", "mover.failed", "MODELS/mover.failed has no model to open (no points); choose "
         "another entrant of gone.one, mean-colour"),
        ("s@0-1", "mover.front", "MODELS/mover.front has no model to open (it has no fit to "
         "all-cameras); choose"),
        ("s@0-1", "mover.damaged", "MODELS/mover.damaged/all-cameras/model cannot be opened by its "
         "method (ValueError: could not convert string to float: 'x'); fit it again"),
        ("s@0-1", "mover.odd", "the model of 'mover.odd' gives no Gaussians of frame 0 (splats "
         "returned a float; return Splats); fit it again"),
    ],
)  # fmt: skip
def test_what_cannot_be_exported_is_one_sentence(geoevs, run, name, label, sentence):
    code, text, errors = export(geoevs, run, name, label)
    assert (code, text) == (1, "")
    sentence = sentence.replace("MODELS", f"{run}/models/d/s@0-1").replace("RUN", str(run))
    assert errors.startswith(f"error: {sentence}")
    assert errors.count("\n") == 1
    assert not (run.parent / "out").exists()


def test_a_run_without_models_and_a_scene_of_two_data_sets_are_one_sentence(geoevs, run):
    (run / "models/e/s@0-1").mkdir(parents=True)
    _, _, errors = export(geoevs, run, "s@0-1", "mover")
    choices = "did you mean 's@0-1'? (one of: d/s@0-1, e/s@0-1, s@0-1)"
    assert errors == f"error: 's@0-1' stands for several scenes in {run}; {choices}\n"
    shutil.rmtree(run / "models")
    _, _, errors = export(geoevs, run, "s@0-1", "mover")
    advice = "make the run's fits again, or copy that folder with it"
    assert errors == f"error: {run}/models holds no models; {advice}\n"
    _, _, errors = export(geoevs, run / "no", "s@0-1", "mover")
    assert errors == f"error: {run}/no is no run's folder; name a run, or give its path\n"
