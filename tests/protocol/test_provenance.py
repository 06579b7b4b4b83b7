"""Answers say what they were made with, which tells those of other settings and scenes."""

import json
import shutil

import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.hashes import outside_hash
from geoevs.core.stamps import check_stamp, settings_hash
from geoevs.methods.tiny import write_tiny_scene
from geoevs.protocol.provenance import (
    check_answers,
    made_with,
    references_stamp,
    scene_stamp,
    targets_stamp,
)
from geoevs.protocol.records import write_records
from geoevs.protocol.targets import make_targets, write_targets
from geoevs.run import Answers

SETTINGS = {
    "lateral": [1.0],
    "pose_sweep": {"angles": [5.0], "every": 1},
    "masked": {"yaw": [5.0], "lateral": [0.5], "every": 1},
}


def write_answers(answers: Answers, settings=SETTINGS, seed=0) -> None:
    targets = answers.path(layout.TARGETS)
    made = make_targets(answers.scene, settings, seed)
    write_targets(targets, made, targets_stamp(answers.scene, settings, seed))
    for pattern in (layout.REFERENCES, layout.MASKS):
        write_records(answers.path(pattern), {}, references_stamp(answers.scene, targets, seed))


@pytest.fixture
def answers(tmp_path):
    answers = Answers(tmp_path, "d", "s")
    write_tiny_scene(answers.path(layout.SCENE))
    write_answers(answers)
    return answers


def test_answers_of_one_config_belong_together(answers):
    check_answers(answers, 0, SETTINGS | {"reference_keep": [1.0]})
    check_answers(answers, 0)


@pytest.mark.parametrize(
    ("settings", "seed"),
    [(SETTINGS | {"lateral": [2.0]}, 0), (SETTINGS | {"masked": {}}, 0), (SETTINGS, 1)],
)
def test_targets_of_other_settings_are_refused(answers, settings, seed):
    with pytest.raises(GeoEvsError, match=r"targets/d/s\.json was made with other settings"):
        check_answers(answers, seed, settings)


def test_references_of_other_targets_are_refused(answers):
    targets = answers.path(layout.TARGETS)
    made = make_targets(answers.scene, SETTINGS, 0)[:-1]
    write_targets(targets, made, targets_stamp(answers.scene, SETTINGS, 0))
    with pytest.raises(GeoEvsError, match=r"references/d/s\.npz was made with other targets"):
        check_answers(answers, 0, SETTINGS)


def test_masks_of_another_run_are_refused(answers, tmp_path):
    other = Answers(tmp_path / "other", "d", "s")
    shutil.copytree(answers.path(layout.SCENE), other.path(layout.SCENE))
    write_answers(other, SETTINGS | {"lateral": [3.0]})
    shutil.copy(other.path(layout.MASKS), answers.path(layout.MASKS))
    with pytest.raises(GeoEvsError, match=r"masks/d/s\.npz was made with other targets"):
        check_answers(answers, 0, SETTINGS)


def test_answers_of_another_scene_are_refused(answers):
    path = answers.path(layout.SCENE) / "transforms.json"
    path.write_text(path.read_text().replace('"timestamp": 0.0', '"timestamp": 0.01'))
    with pytest.raises(GeoEvsError, match=r"targets/d/s\.json was made with other scene"):
        check_answers(Answers(answers.run, "d", "s"), 0, SETTINGS)


def test_files_without_a_stamp_are_refused(answers):
    path = answers.path(layout.TARGETS)
    listed = [
        {k: v for k, v in entry.items() if k != "made_with"}
        for entry in json.loads(path.read_text())
    ]
    path.write_text(json.dumps(listed))
    with pytest.raises(GeoEvsError, match=r"s\.json does not say what it was made with; delete it"):
        check_answers(answers, 0)
    write_targets(
        path, make_targets(answers.scene, SETTINGS, 0), targets_stamp(answers.scene, SETTINGS, 0)
    )
    write_records(answers.path(layout.REFERENCES), {})
    with pytest.raises(GeoEvsError, match=r"references/d/s\.npz was made with unknown seed"):
        check_answers(answers, 0)


def test_the_stamp_of_a_scene_knows_its_settings_and_data(tmp_path):
    stamp = scene_stamp("street", "junction-1", (48, 72), {"frames": 1, "samples": 4}, "none")
    again = scene_stamp("street", "junction-1", (48, 72), {"samples": 4, "frames": 1}, "none")
    assert stamp == again
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({"made_with": stamp}))
    check_stamp(path, made_with(path), again)
    with pytest.raises(GeoEvsError, match="was made with other data"):
        check_stamp(path, made_with(path), {**stamp, "data": "else"})


def test_the_order_of_settings_does_not_matter():
    assert settings_hash({"a": 1, "b": [1, 2]}) == settings_hash({"b": [1, 2], "a": 1})
    assert settings_hash([1, 2]) != settings_hash([2, 1])


def test_files_outside_are_told_apart_without_reading(tmp_path):
    (tmp_path / "data/deep").mkdir(parents=True)
    file = tmp_path / "data/deep/1.jpg"
    file.write_text("1")
    before = outside_hash([tmp_path / "data", tmp_path / "gone"])
    assert outside_hash([tmp_path / "gone", tmp_path / "data"]) == before
    file.write_text("22")
    changed = outside_hash([tmp_path / "data", tmp_path / "gone"])
    (tmp_path / "gone").touch()
    assert len({before, changed, outside_hash([tmp_path / "data", tmp_path / "gone"])}) == 3
