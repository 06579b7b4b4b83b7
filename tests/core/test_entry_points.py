"""A data source and a method of an installed package, outside the project."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from geoevs.core import code_hash as hashing
from geoevs.core.code_hash import code_hash
from geoevs.core.errors import GeoEvsError
from geoevs.core.plugins import module_path
from geoevs.methods.finding import find_methods, find_trainings
from geoevs.results.manifest import make_manifest
from geoevs.scenes.scene import find_sources
from geoevs.scenes.store import Scene
from geoevs.source_check.template import SOURCE

PROJECT = Path(__file__).parents[2]
ADAPTER = """
from .paint import one_colour
from geoevs.methods.contract import FitReport, MethodInfo, Rendering

class Method:
    info = MethodInfo("theirs", "control")

    def fit(self, views, budget, rng):
        return FitReport()

    def render(self, camera, frame):
        return Rendering(one_colour(camera))

    def save(self, folder):
        pass

    @classmethod
    def load(cls, folder):
        return cls()
"""
PAINT = """
import numpy as np

def one_colour(camera):
    return np.full((camera.height, camera.width, 3), 0.5, np.float32)
"""
POINTS = {
    "geoevs.methods": "their-method = their_package.method",
    "geoevs.sources": "their-data = their_package.data",
}


def install(site: Path, points: dict[str, str]) -> None:
    """What `pip install --target` leaves of a package with these entry points."""
    files = {
        "their_package/__init__.py": "raise RuntimeError('imported') \n",
        "their_package/method/__init__.py": "",
        "their_package/method/adapter.py": ADAPTER,
        "their_package/method/paint.py": PAINT,
        "their_package/data/__init__.py": "",
        "their_package/data/source.py": SOURCE.format(name="their-data"),
        "their_package-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: their-package\n"
        "Version: 1.0\n",
        "their_package-1.0.dist-info/entry_points.txt": "".join(
            f"[{group}]\n{point}\n" for group, point in points.items()
        ),
    }
    for name, text in files.items():
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_text(text)


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder of installed packages, which this process sees too."""
    folder = tmp_path / "site"
    install(folder, POINTS)
    monkeypatch.syspath_prepend(folder)
    yield folder
    for part in (hashing._tree, hashing._code, hashing._imports):
        part.cache_clear()


def run(site: Path, *arguments: object) -> str:
    """What the command prints, in a process of its own."""
    command = [sys.executable, "-m", "geoevs.cli.main", *map(str, arguments)]
    path = os.pathsep.join([str(site), str(PROJECT), os.environ.get("PYTHONPATH", "")])
    process = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def test_they_are_found_without_being_imported(site):
    assert find_methods()["their-method"] == "their_package.method.adapter"
    assert find_sources()["their-data"] == "their_package.data.source"
    assert "their-method" not in find_trainings()
    assert module_path("their_package.data.source") == site / "their_package/data/source.py"
    assert "their_package" not in sys.modules


def test_a_manifest_names_their_package(site):
    assert make_manifest({"seed": 0}, [])["versions"]["their-package"] == "1.0"


def test_they_run(site, tmp_path):
    (site / "their_package/__init__.py").write_text("")
    said = run(site, "check-adapter", "their-method")
    assert "✓ fit" in said
    assert "✗" not in said
    given = ("--source", "their-data", "--name", "drive@0-1", "--height", 48, "--width", 72)
    out = ("--out", tmp_path / "scene", "--depths", tmp_path / "depths")
    run(site, "scene", *given, "--options", "{}", *out)
    scene = Scene(tmp_path / "scene")
    assert (scene.info.source, scene.frames) == ("their-data", (0, 1))


def test_their_code_counts_as_deep_as_it_imports_itself(site):
    def fresh():
        for part in (hashing._tree, hashing._code, hashing._imports):
            part.cache_clear()
        importlib.invalidate_caches()
        return code_hash("their_package.method.adapter")

    before = fresh()
    paint = site / "their_package/method/paint.py"
    paint.write_text(PAINT + "\n# a remark\n")
    assert fresh() == before
    paint.write_text(PAINT.replace("0.5", "0.6"))
    assert fresh() != before
    paint.write_text(PAINT)
    (site / "their_package/data/source.py").write_text("")
    assert fresh() == before
    # It imports the contract of the project, whose modules count as well.
    assert "geoevs.methods.contract" in hashing._imports("their_package.method.adapter")
    assert "their_package.method.paint" in hashing._imports("their_package.method.adapter")


@pytest.mark.parametrize(
    ("point", "sentence"),
    [
        (
            "reproject = their_package.method",
            "^entry point 'reproject' of geoevs.methods in the package their-package has the name "
            "of baselines/controls/reproject; rename the entry point, or uninstall the package$",
        ),
        ("Their_Method = their_package.method", "^entry point 'Their_Method' .*; rename it$"),
        ("theirs = their_package.data", "names their_package.data, which has no adapter.py; name"),
        ("theirs = not_there.method", "names not_there.method, which has no adapter.py; name the"),
    ],
)  # fmt: skip
def test_an_entry_point_that_cannot_be_is_one_sentence(tmp_path, monkeypatch, point, sentence):
    folder = tmp_path / "site"
    install(folder, {"geoevs.methods": point})
    monkeypatch.syspath_prepend(folder)
    with pytest.raises(GeoEvsError, match=sentence):
        find_methods()
