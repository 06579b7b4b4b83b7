"""A detector of every setting, trained for a few steps and tested, on the tiny scene."""

import numpy as np
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json
from geoevs.detection.detectors import (
    BACKBONE,
    WEIGHTS,
    find,
    find_setting,
    fitting_of,
    train_backbone,
    train_setting,
)
from geoevs.detection.found import FOUND, detectors_of, found_by, outcomes_of, read_found
from geoevs.detection.outcomes import OUTCOME, Outcome
from geoevs.detection.setting_counts import count_setting
from geoevs.detection.settings import DetectionSettings
from geoevs.detection.task_rows import task_rows
from geoevs.results.detection_figure import detection_figure
from tests.detection.conftest import OFFSETS

SETTINGS = DetectionSettings.parse(
    {
        "detector": {"image": [32, 48], "grid": [6, 6], "channels": 16, "queries": 5, "decoder": 1},
        "training": {"steps": 2, "backbone_steps": 2, "learning_rate": 1e-3},
        "longer": 2.0,
    }
)


def places(run, setting, seed=0):
    return [run / name.format(setting=setting, seed=seed) for name in PATTERNS]


PATTERNS = (layout.DETECTION_BACKBONE, layout.DETECTOR, layout.PREDICTIONS)


def made(run, scene, setting, work, settings=SETTINGS):
    """A detector of a setting, and what it finds in the scene that it learned from."""
    backbone, detector, predictions = places(run, setting)
    if not backbone.exists():
        train_backbone([scene], settings, 0, work / "weights", work / "backbone", backbone)
    train_setting([scene], setting, settings, 0, backbone, work / setting, detector)
    find_setting([scene], setting, detector, predictions)
    return Outcome.read(predictions)


def test_every_setting_is_trained_and_tested(rig_run, rig_scene, tmp_path):
    outcomes = {
        setting: made(rig_run, rig_scene, setting, tmp_path)
        for setting in ("blind", "native", "augmented", "with-truth", "with-grey")
    }
    assert {name: outcome.reason for name, outcome in outcomes.items()} == dict.fromkeys(
        outcomes, ""
    )
    assert [outcome.views for outcome in outcomes.values()] == [3, 3, 3, 23, 23]
    assert all(
        outcome.frames == 2 and outcome.training_seconds > 0 for outcome in outcomes.values()
    )
    found = found_by(rig_run, list(outcomes), 0)
    for name in outcomes:
        rows = found[name]
        assert set(rows["scene"]) == {"d/tiny"}
        assert rows["score"].between(0, 1).all()
        counts = count_setting(name, 0, [rig_scene], rows)
        assert counts["truths"].max() == 1
    assert not found["native"].equals(found["with-truth"])
    # What a detector of recorded views says depends on the pictures.
    detector = places(rig_run, "native")[1]
    blind, native = (find(detector, rig_scene.frames(name)) for name in ("blind", "native"))
    assert not np.allclose(blind["score"], native["score"])
    rows = task_rows("truth", [rig_scene], OFFSETS, detectors_of(rig_run, [0]), find)
    assert rows["reason"].eq("").all()
    assert rows["value"].between(0, 1).all()
    picture = detection_figure(rig_scene, 0, found, SETTINGS.detector.range)
    assert picture.dtype == np.uint8
    assert picture.std() > 10


def test_settings_differ_in_nothing_but_what_they_say():
    native = fitting_of("native", SETTINGS)
    assert fitting_of("blind", SETTINGS) == fitting_of("with-truth", SETTINGS) == native
    assert fitting_of("longer", SETTINGS).steps == 2 * native.steps
    augmented = fitting_of("augmented", SETTINGS)
    assert augmented.flip
    assert augmented.jitter
    assert augmented.steps == native.steps


def test_what_fails_is_a_reason_and_the_others_go_on(rig_run, rig_scene, tmp_path):
    broken = made(rig_run, rig_scene, "with-nobody", tmp_path)
    assert "render.json is missing" in broken.reason
    backbone, detector, predictions = places(rig_run, "with-nobody")
    assert not (detector / WEIGHTS).exists()
    assert not (predictions / FOUND).exists()
    assert read_found(predictions).empty
    assert found_by(rig_run, ["with-nobody"], 0) == {}
    told = outcomes_of(rig_run, ["with-nobody"], [0])
    assert told["with-nobody", 0] == broken
    assert (backbone / BACKBONE).exists()


def test_a_loss_that_is_no_number_is_a_reason(rig_run, rig_scene, tmp_path):
    fitting = {"steps": 4, "backbone_steps": 1, "learning_rate": 1e9}
    wild = DetectionSettings.parse({"detector": vars(SETTINGS.detector), "training": fitting})
    backbone = places(rig_run, "native")[0]
    train_setting([rig_scene], "native", wild, 0, backbone, tmp_path / "w", tmp_path / "out")
    outcome = Outcome.read(tmp_path / "out")
    assert "at step" in outcome.reason
    find_setting([rig_scene], "native", tmp_path / "out", tmp_path / "found")
    assert Outcome.read(tmp_path / "found").reason == outcome.reason


def test_scenes_without_labels_fail_in_one_sentence(rig_scene, tmp_path):
    rig_scene.labels = rig_scene.labels.assign(reason="out of range")
    train_backbone([rig_scene], SETTINGS, 0, tmp_path, tmp_path / "w", tmp_path / "backbone")
    reason = Outcome.read(tmp_path / "backbone").reason
    assert reason.startswith("no label of 1 scenes to learn from counts (2 out of range); name")
    train_setting(
        [rig_scene], "native", SETTINGS, 0, tmp_path / "backbone", tmp_path / "w", tmp_path / "out"
    )
    assert Outcome.read(tmp_path / "out").reason == f"its backbone failed: {reason}"
    (tmp_path / "fine").mkdir()
    Outcome().write(tmp_path / "fine")
    find_setting([rig_scene], "native", tmp_path / "fine", tmp_path / "found")
    assert "no label of 1 scenes to test on counts" in Outcome.read(tmp_path / "found").reason


def test_weights_that_are_not_here_are_a_reason(rig_scene, tmp_path):
    pretrained = DetectionSettings.parse({"detector": {"backbone": "vggt-nano"}})
    train_backbone([rig_scene], pretrained, 0, tmp_path, tmp_path / "w", tmp_path / "backbone")
    reason = Outcome.read(tmp_path / "backbone").reason
    assert "the backbone 'vggt-nano' of detectors has no weights here" in reason


@pytest.mark.parametrize("change", [{"views": "many"}, {"views": -1}, {"frames": None}, {"x": 1}])
def test_outcomes_of_another_shape_are_refused(tmp_path, change):
    Outcome().write(tmp_path)
    write_json(tmp_path / OUTCOME, read_json(tmp_path / OUTCOME) | change)
    with pytest.raises(GeoEvsError, match=r"outcome.json .*delete its folder"):
        Outcome.read(tmp_path)
