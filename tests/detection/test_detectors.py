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
    find_settings,
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


def places(run, setting):
    patterns = (layout.DETECTION_BACKBONE, layout.DETECTOR)
    return [run / pattern.format(setting=setting, seed=0) for pattern in patterns]


def made(run, scene, work, *settings):
    """Detectors of settings, and how they and their tests on what they learned from ended."""
    detectors = {}
    for setting in settings:
        backbone, detectors[setting] = places(run, setting)
        if not backbone.exists():
            train_backbone([scene], SETTINGS, 0, work / "weights", work / "backbone", backbone)
        where = (backbone, work / setting, detectors[setting])
        train_setting([scene], setting, SETTINGS, 0, *where)
    find_settings([scene], detectors, run / layout.PREDICTIONS.format(seed=0))
    return {name: outcome for (name, _), outcome in outcomes_of(run, settings, [0]).items()}


def test_every_setting_is_trained_and_tested(rig_run, rig_scene, tmp_path):
    settings = ("blind", "native", "augmented", "with-truth", "with-grey")
    outcomes = made(rig_run, rig_scene, tmp_path, *settings)
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
    outcomes = made(rig_run, rig_scene, tmp_path, "with-nobody", "native")
    assert "render.json is missing" in outcomes["with-nobody"].reason
    assert outcomes["native"].reason == ""
    backbone, detector = places(rig_run, "with-nobody")
    assert (backbone / BACKBONE).exists()
    assert not (detector / WEIGHTS).exists()
    predictions = rig_run / layout.PREDICTIONS.format(seed=0) / "with-nobody"
    assert not (predictions / FOUND).exists()
    assert read_found(predictions).empty
    assert list(found_by(rig_run, ["with-nobody", "native"], 0)) == ["native"]


def test_a_loss_that_is_no_number_is_a_reason(rig_run, rig_scene, tmp_path):
    fitting = {"steps": 4, "backbone_steps": 1, "learning_rate": 1e9}
    wild = DetectionSettings.parse({"detector": vars(SETTINGS.detector), "training": fitting})
    backbone = places(rig_run, "native")[0]
    train_setting([rig_scene], "native", wild, 0, backbone, tmp_path / "w", tmp_path / "out")
    outcome = Outcome.read(tmp_path / "out")
    assert "at step" in outcome.reason
    find_settings([rig_scene], {"native": tmp_path / "out"}, tmp_path / "found")
    assert Outcome.read(tmp_path / "found/native").reason == outcome.reason


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
    find_settings([rig_scene], {"native": tmp_path / "fine"}, tmp_path / "found")
    reason = Outcome.read(tmp_path / "found/native").reason
    assert "no label of 1 scenes to test on counts" in reason


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
