"""A scene with its answers, and methods that misbehave, here and in isolated processes."""

import os
import textwrap
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest

import baselines
from geoevs import layout
from geoevs.core.files import read_json, write_json
from geoevs.methods.contract import Budget
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.protocol.condition_masks import RawReprojection, make_condition_masks
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.pictures import PICTURES, seal_pictures
from geoevs.protocol.records import write_records
from geoevs.protocol.reference import make_references
from geoevs.protocol.runs import fit_method, render_method
from geoevs.protocol.targets import Target, make_targets, write_targets
from geoevs.protocol.truth import write_truth
from geoevs.run import Answers
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.store import Scene

PROTOCOL = {
    "lateral": [-1.0, 1.0],
    "pose_sweep": {"angles": [10.0], "every": 2},
    "masked": {"yaw": [15.0, 20.0], "lateral": [-2.0, 2.0], "every": 2},
}

ANSWERS = (layout.SCENE, layout.TARGETS, layout.REFERENCES, layout.TRUTH, layout.MASKS)

TEMPLATE = """
import os, signal
from dataclasses import dataclass
import numpy as np
from geoevs.methods.contract import FitReport, MethodInfo, Rendering
from geoevs.core.errors import GeoEvsError

@dataclass
class Method:
    info = MethodInfo("Toy", "control")
    value: float = 0.5

    def fit(self, views, budget, rng):
        {fit}
        return FitReport(primitives=np.int64(3), parameters=2, note="toy")

    def render(self, camera, frame):
        rgb = np.full((camera.height, camera.width, 3), self.value)
        {render}
        return Rendering(rgb)

    def save(self, folder):
        (folder / "value").write_bytes(b"12345")

    @classmethod
    def load(cls, folder):
        {load}
        return cls()
"""


@pytest.fixture
def toy(tmp_path_factory, monkeypatch):
    """Makes a method from the lines that its fit, render and load run."""
    root = tmp_path_factory.mktemp("toys")
    monkeypatch.setattr(baselines, "__path__", [*baselines.__path__, str(root)])
    # Every Python process runs sitecustomize first, so that isolated ones find the toys too.
    (root / "sitecustomize.py").write_text(f"import baselines\nbaselines.__path__.append('{root}')")
    project = str(Path(baselines.__file__).parents[1])
    paths = [str(root), project, os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))

    def make(name: str, fit: str = "pass", render: str = "pass", load: str = "pass") -> str:
        (root / name).mkdir()
        lines = {"fit": fit, "render": render, "load": load}
        text = TEMPLATE.format(
            **{key: textwrap.indent(line, " " * 8).strip() for key, line in lines.items()}
        )
        (root / name / "adapter.py").write_text(text)
        return name

    return make


@pytest.fixture
def attempt(stage, tmp_path):
    """Fits and renders a method on one split's targets of frame 0; gives both outcomes.

    Oracles are told whose answers to copy.
    """

    def run(method: str, *splits: str, answers: Answers | None = None):
        targets = stage.keep(tmp_path / "targets.json", *(splits or ("extrapolation",)))
        entry, scene, log = MethodEntry(method), stage.store.folder, tmp_path / "fit.log"
        fit_method(entry, scene, targets, Budget(threads=1), tmp_path / "model", log)
        seen = (targets, stage.answers.path(layout.MASKS))
        folders = (tmp_path / "renders", tmp_path / "render.log")
        told = answers and {"run": str(answers.run), **answers.place}
        render_method(entry, tmp_path / "model", *seen, *folders, told)
        names = ("model/fit.json", "renders/render.json")
        return tuple(read_json(tmp_path / name) for name in names)

    return run


@dataclass(frozen=True)
class Stage:
    """A run of the tiny scene: its targets, references, truth and masks on disk."""

    answers: Answers
    targets: list[Target]

    protocol: ClassVar[dict] = PROTOCOL

    @property
    def store(self) -> Scene:
        return self.answers.scene

    def keep(self, path: Path, *splits: str) -> Path:
        """Write the targets of some splits, of frame 0 alone, so that steps are quick."""
        write_targets(path, [t for t in self.targets if t.split in splits and t.frame == 0])
        return path

    @staticmethod
    def seal(renders: Path, outcomes: dict[str, dict]) -> None:
        """Write the outcomes of a rendering whose pictures lie there, as `render_method` does."""
        found = (path.relative_to(renders).with_suffix("") for path in renders.rglob("*.png"))
        views = [SimpleNamespace(key=str(key)) for key in found]
        sealed = {PICTURES: seal_pictures(renders, views)}
        write_json(
            renders / "render.json", {name: {**of, **sealed} for name, of in outcomes.items()}
        )

    def linked(self, run: Path, *without: str) -> Answers:
        """The answers in a run of its own, all the same files but those of some patterns."""
        answers = Answers(run, **self.answers.place)
        for pattern in ANSWERS:
            if pattern not in without:
                answers.path(pattern).parent.mkdir(parents=True, exist_ok=True)
                answers.path(pattern).symlink_to(self.answers.path(pattern))
        return answers


@pytest.fixture(scope="session")
def stage(tmp_path_factory):
    answers = Answers(tmp_path_factory.mktemp("stage"), "d", "s")
    store = write_tiny_scene(answers.path(layout.SCENE))
    targets = make_targets(store, PROTOCOL, seed=0)
    write_targets(answers.path(layout.TARGETS), targets)
    reprojection = RawReprojection(store)
    references = make_references(store, targets, reprojection, seed=0)
    write_records(answers.path(layout.REFERENCES), references)
    write_records(answers.path(layout.MASKS), make_condition_masks(targets, reprojection))
    truth = answers.path(layout.TRUTH)
    write_truth(truth, TinySource(), SceneRef("tiny"), targets, lambda: None)
    return Stage(answers, targets)


@pytest.fixture
def tiny_source():
    return TinySource()


class TinySource:
    """The tiny scene as a source that knows the truth."""

    has_truth = True

    def truth(self, scene, views):
        assert scene == SceneRef("tiny")
        return (tiny_truth(camera) for camera, _ in views)
