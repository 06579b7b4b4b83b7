"""A scene with its evidence, and methods that misbehave, here and in isolated processes."""

import os
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import baselines
from geoevs.protocol.reference import make_references, write_references
from geoevs.protocol.scoring import Evidence
from geoevs.protocol.targets import Target, make_targets, write_targets
from geoevs.protocol.truth import write_truth
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.store import Scene
from geoevs.scenes.tiny import tiny_truth, write_tiny_scene

PROTOCOL = {"lateral": [-1.0, 1.0], "pose_sweep": {"angles": [10.0], "every": 2}}

TEMPLATE = """
import os, signal
from dataclasses import dataclass
import numpy as np
from geoevs.adapter import FitReport, MethodInfo, Rendering
from geoevs.errors import GeoEvsError

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


@dataclass(frozen=True)
class Stage:
    """The tiny scene with targets, references and truth on disk."""

    folder: Path
    store: Scene
    targets: list[Target]

    @property
    def evidence(self) -> Evidence:
        names = ("scene", "targets.json", "references.npz", "truth")
        return Evidence(*(self.folder / name for name in names))

    def keep(self, path: Path, *splits: str) -> Path:
        """Write the targets of some splits, of frame 0 alone, so that steps are quick."""
        write_targets(path, [t for t in self.targets if t.split in splits and t.frame == 0])
        return path


@pytest.fixture(scope="session")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stage")
    store = write_tiny_scene(folder / "scene")
    targets = make_targets(store, PROTOCOL)
    write_targets(folder / "targets.json", targets)
    references = make_references(store, targets, np.random.default_rng(0))
    write_references(folder / "references.npz", references)
    write_truth(folder / "truth", TinySource(), SceneRef("tiny"), targets, lambda: None)
    return Stage(folder, store, targets)


class TinySource:
    """The tiny scene as a source that knows the truth."""

    has_truth = True

    def truth(self, scene, views):
        assert scene == SceneRef("tiny")
        return (tiny_truth(camera) for camera, _ in views)
