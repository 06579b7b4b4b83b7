import copy
from pathlib import Path

import pytest
import yaml

from geoevs.config.checks import check_config
from geoevs.config.entrants import detection_entries
from geoevs.core.errors import GeoEvsError
from geoevs.detection.settings import DetectionSettings

ROOT = Path(__file__).parents[2]
SCHEMA = ROOT / "workflow/schemas/config.schema.yaml"
DEFAULT = yaml.safe_load((ROOT / "config.yaml").read_text())


def refused(change):
    """What a change of the default config is told."""
    config = copy.deepcopy(DEFAULT)
    change(config)
    with pytest.raises(GeoEvsError) as error:
        check_config(config, SCHEMA, [], config)
    return str(error.value)


def section(**changes):
    return lambda config: config["detection"].update(changes)


def test_the_default_config_is_allowed_and_says_what_the_settings_are():
    check_config(copy.deepcopy(DEFAULT), SCHEMA, [], {})
    settings = DetectionSettings.parse(DEFAULT["detection"])
    assert len(settings.views.shares) * len(settings.views.lateral) * 4 == 40
    names = {"mean-colour", "reproject-inpaint", "geo-evs", "truth"}
    assert {entry.name for entry in detection_entries(DEFAULT)} == names


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (section(view={}), "'detection' has no option 'view'; did you mean 'views'?"),
        (section(views={"share": [0.5]}), "no option 'share'; did you mean 'shares'?"),
        (section(views={"shares": [0.5, 1.5]}), "option 'views.shares'"),
        (section(views={"shares": [0.5, 0.5000001]}), "differ in their first six digits"),
        (section(offsets=[0.0, 1.0]), "shown anyway; remove the offset 0"),
        (section(offsets=[1.0, 1.0]), "has something twice; remove the repeats"),
        (section(seeds=0), "cannot have 0 for its option 'seeds'"),
        (section(classes={"vehicles": ["car"]}), "did you mean 'vehicle'?"),
        (
            section(classes={"vehicle": ["car", "bus"], "cyclist": ["bus"]}),
            "the label 'bus' is of the classes 'vehicle' and 'cyclist'; choose one",
        ),
        (section(methods={"geo-evz": {}}), "there is no 'geo-evz' under 'methods'; did you mean"),
        (section(methods={"reference": {}}), "'reference' has a picture only where LiDAR"),
        (
            section(methods={"three-dgs": {"iteration": 5}}),
            "method 'three-dgs' has no option 'iteration'; did you mean 'iterations'?",
        ),
        (section(training={"steps": 0}), "cannot have 0 for its option 'training.steps'"),
        (lambda config: config.pop("detection"), "the key 'detection' is missing"),
    ],
)
def test_wrong_sections_are_one_sentence(change, sentence):
    assert sentence in refused(change)


def test_scenes_serve_one_partition_only():
    def shared(config):
        config["datasets"]["street-detection"]["partitions"]["detection"].append("straight-2901")

    said = refused(shared)
    assert "'straight-2901' in partition 'detection" in said
    assert "a frame may serve one partition only" in said

    def with_training(config):
        config["datasets"]["street-detection"]["partitions"]["detection"].append("straight-301")

    assert "a frame may serve one partition only" in refused(with_training)


def test_scenes_to_learn_from_need_scenes_to_test_on():
    def untested(config):
        del config["datasets"]["street-detection"]["partitions"]["detection-test"]

    assert "under partitions.detection and none under partitions.detection-test" in refused(
        untested
    )
    neither = copy.deepcopy(DEFAULT)
    neither["datasets"]["street-detection"]["partitions"] = {}
    check_config(neither, SCHEMA, [], {})


def test_one_who_is_left_out_of_the_run_is_left_out_here():
    config = copy.deepcopy(DEFAULT)
    config["methods"]["truth"] = None
    check_config(config, SCHEMA, [], {})
    assert "truth" not in [entry.name for entry in detection_entries(config)]


def test_no_scene_of_detection_is_used_elsewhere():
    """Numbers of scenes that nothing else uses, not even with another layout."""
    numbers = {}
    for name, dataset in DEFAULT["datasets"].items():
        for scenes in dataset["partitions"].values():
            for text in scenes:
                first, _, last = text.partition("-")[2].partition("..")
                for number in range(int(first), int(last or first) + 1):
                    numbers.setdefault(number, set()).add(name)
    mine = [owners for owners in numbers.values() if "street-detection" in owners]
    assert len(mine) >= 15
    assert all(owners == {"street-detection"} for owners in mine)
