"""A scene with its evidence, and methods that misbehave, here and in isolated processes."""

import os
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest

import baselines
from geoevs.core.files import read_json
from geoevs.methods.contract import Budget
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.protocol.condition_masks import RawReprojection, make_condition_masks
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.records import write_records
from geoevs.protocol.reference import make_references
from geoevs.protocol.runs import fit_method, render_method
from geoevs.protocol.scoring import Evidence
from geoevs.protocol.targets import Target, make_targets, write_targets
from geoevs.protocol.truth import write_truth
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.store import Scene

PROTOCOL = {
    "lateral": [-1.0, 1.0],
    "pose_sweep": {"angles": [10.0], "every": 2},
    "masked": {"yaw": [15.0, 20.0], "lateral": [-2.0, 2.0], "every": 2},
}

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
    """Fits and renders a method on one split's targets of frame 0; gives both outcomes."""

    def run(method: str, *splits: str, evidence=None):
        targets = stage.keep(tmp_path / "targets.json", *(splits or ("extrapolation",)))
        entry, scene, log = MethodEntry(method), stage.folder / "scene", tmp_path / "fit.log"
        fit_method(entry, scene, targets, Budget(threads=1), tmp_path / "model", log)
        seen = (targets, stage.evidence.masks, evidence or {})
        folders = (tmp_path / "renders", tmp_path / "render.log")
        render_method(entry, tmp_path / "model", *seen, *folders)
        names = ("model/fit.json", "renders/render.json")
        return tuple(read_json(tmp_path / name) for name in names)

    return run


@dataclass(frozen=True)
class Stage:
    """The tiny scene with targets, references, truth and masks on disk."""

    folder: Path
    store: Scene
    targets: list[Target]

    protocol: ClassVar[dict] = PROTOCOL

    @property
    def evidence(self) -> Evidence:
        names = ("scene", "targets.json", "references.npz", "truth", "masks.npz")
        return Evidence(*(self.folder / name for name in names))

    def keep(self, path: Path, *splits: str) -> Path:
        """Write the targets of some splits, of frame 0 alone, so that steps are quick."""
        write_targets(path, [t for t in self.targets if t.split in splits and t.frame == 0])
        return path


@pytest.fixture(scope="session")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stage")
    store = write_tiny_scene(folder / "scene")
    targets = make_targets(store, PROTOCOL, seed=0)
    write_targets(folder / "targets.json", targets)
    reprojection = RawReprojection(store)
    write_records(folder / "references.npz", make_references(store, targets, reprojection, seed=0))
    write_records(folder / "masks.npz", make_condition_masks(targets, reprojection))
    write_truth(folder / "truth", TinySource(), SceneRef("tiny"), targets, lambda: None)
    return Stage(folder, store, targets)


@pytest.fixture
def tiny_source():
    return TinySource()


class TinySource:
    """The tiny scene as a source that knows the truth."""

    has_truth = True

    def truth(self, scene, views):
        assert scene == SceneRef("tiny")
        return (tiny_truth(camera) for camera, _ in views)
