import json
import subprocess
import sys
import types

import numpy as np
import pytest

from geoevs.conditions.artifact_masks import read_artifact_masks
from geoevs.conditions.pairs import read_pairs
from geoevs.core.files import read_json
from geoevs.geometry.lift import lidar_depths


class Lidar:
    depths = staticmethod(lidar_depths)


@pytest.fixture
def geoevs(geoevs, monkeypatch):
    """Runs the command in this process, with a depth model; gives exit code and standard error."""
    asked = []
    models = types.ModuleType("depth_models")
    models.make_depth_model = lambda *arguments: asked.append(arguments) or Lidar()
    monkeypatch.setitem(sys.modules, "geoevs.geometry.depth_models", models)

    def run(*arguments: object):
        code, _, err = geoevs(*arguments)
        return code, err

    run.asked = asked
    return run


def test_from_a_scene_to_its_pairs_and_library(geoevs, stage, tmp_path):
    scene = ("--scene", stage.scene.folder)
    maps, prepared, library = (tmp_path / f"{n}.npz" for n in ("maps", "prepared", "library"))
    assert geoevs("point-maps", *scene, "--model", "lidar", "--out", maps) == (0, "")
    assert geoevs.asked == [("lidar", None)]
    poses = json.dumps({"yaw": [0.5], "lateral": [-1, 1]})
    inputs = ("--point-maps", maps, "--mask-poses", poses)
    assert geoevs("prepare", "geo-evs", *scene, *inputs, "--out", prepared) == (0, "")
    assert geoevs("combine", "geo-evs", prepared, prepared, "--out", library) == (0, "")
    assert len(read_pairs([prepared])) == 6
    # Two frames, two sides, two shifts; the part was given twice.
    assert len(read_artifact_masks(library)) == 2 * 8
    assert np.unique(read_artifact_masks(library).scene).tolist() == ["tiny"]


def test_a_library_of_nothing_is_one_sentence(geoevs, tmp_path):
    code, errors = geoevs("combine", "geo-evs", "--out", tmp_path / "library.npz")
    assert code == 0
    sentence = "holds no masks; name training scenes under partitions.train of a data set"
    assert errors == f"error: combining: the mask library {sentence}\n"
    failure = read_json(tmp_path / "library.npz")  # which trainings are told in its place
    assert failure["failure"] == f"the mask library {sentence} (while combining)"


def test_help_needs_no_torch():
    code = "import sys, geoevs.cli.trainings, geoevs.conditions.injection; print(*sys.modules)"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = shown.stdout.split()
    assert "geoevs.conditions.injection" in modules
    assert "torch" not in modules
