"""Trainings in the config: what an entrant takes, what a variant is, and mistakes in either."""

import copy
from dataclasses import asdict
from pathlib import Path

import pytest
import yaml

from geoevs.config.checks import check_config
from geoevs.config.entrants import method_entries
from geoevs.config.trainings import training_settings
from geoevs.core.errors import GeoEvsError
from geoevs.methods.finding import find_trainings, make_method, training_class

PROJECT = Path(__file__).parents[2]
SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"


def merge(base, over):
    """As Snakemake puts configs together: deeply, the later one winning."""
    merged = copy.deepcopy(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = merge(merged[key], value) if both else copy.deepcopy(value)
    return merged


@pytest.fixture
def check(tmp_path):
    """Checks the default config under an overlay; gives what they make together."""

    def run(overlay=""):
        path = tmp_path / "over.yaml"
        path.write_text(overlay)
        base = PROJECT / "config.yaml"
        config = merge(yaml.safe_load(base.read_text()), yaml.safe_load(overlay) or {})
        check_config(config, SCHEMA, [base, path])
        return config

    return run


MISTAKES = {
    "an unknown training": (
        "methods: {geo-evs: {training: v4}}",
        "over.yaml:1: there is no training 'v4' under 'trainings.geo-evs.variants'; did you mean "
        "'v",
    ),
    "a method that takes weights without a training": (
        "methods:\n  geo-evs-support.mine: {}",
        "over.yaml:2: method 'geo-evs-support.mine' is trained before it is fitted; name one under "
        "'training' (",
    ),
    "a training of its own for a method that has none": (
        "methods: {geo-evs-support: {training: v3}}",
        "over.yaml:1: method 'geo-evs-support' has no training of its own; name another method's "
        "as METHOD/VARIANT (",
    ),
    "a training for a method that is not trained": (
        "methods: {reproject: {training: v3}}",
        "over.yaml:1: method 'reproject' is not trained; remove 'training'",
    ),
    "a training for a control": (
        "methods: {truth: {training: v3}}",
        "over.yaml:1: method 'truth' is not trained; remove 'training'",
    ),
    "an option that a trained method has not": (
        "methods: {geo-evs: {options: {stepps: 3}}}",
        "over.yaml:1: method 'geo-evs' has no option 'stepps'; did you mean 'steps'?",
    ),
    "weights besides a training": (
        "methods: {geo-evs: {options: {weights: mine}}}",
        "over.yaml:1: the weights of 'geo-evs' are those of its training; remove the option",
    ),
    "a variant that another method has": (
        "methods: {freevs: {training: v3}}",
        "over.yaml:1: there is no training 'v3' under 'trainings.freevs.variants'; one of: default",
    ),
    "a training with too many parts": (
        "methods: {geo-evs: {training: a/b/c}}",
        "over.yaml:1: the training 'a/b/c' is not of the form VARIANT or METHOD/VARIANT; name one",
    ),
    "a training without a variant": (
        "methods: {geo-evs: {training: geo-evs/}}",
        "over.yaml:1: the training 'geo-evs/' is not of the form VARIANT or METHOD/VARIANT; name",
    ),
    "a variant with the name of the section": (
        "trainings:\n  geo-evs:\n    variants: {default: {}}",
        "over.yaml:3: 'default' is the training by the section itself; rename the variant",
    ),
    "a training of no method": (
        "trainings:\n  geo-evz: {}",
        "over.yaml:2: there is no method that trains called 'geo-evz'; did you mean 'geo-evs'?",
    ),
    "no frames in a clip": (
        "trainings:\n  freevs:\n    frames: 0",
        "over.yaml:3: the training of 'freevs' cannot have 0 for its option 'frames'; make it 1 or",
    ),
    "an unknown key": (
        "trainings:\n  geo-evs:\n    learning_rat: 1",
        "over.yaml:3: the training of 'geo-evs' has no option 'learning_rat'; did you mean "
        "'learning_rate'?",
    ),
    "an unknown key of a variant": (
        "trainings: {geo-evs: {variants: {v1: {mask: none}}}}",
        "over.yaml:1: the training of 'geo-evs' has no option 'mask'; did you mean 'masks'?",
    ),
    "an unknown kind of masks": (
        "trainings: {geo-evs: {variants: {v1: {masks: box}}}}",
        "over.yaml:1: the training of 'geo-evs' cannot have 'box' for its option 'masks'; did you "
        "mean 'boxes'? (one of: boxes, boxes-unmatched, none, reprojected)",
    ),
    "an unknown sampler": (
        "trainings:\n  geo-evs:\n    sampling:\n      sampler: ddpm",
        "over.yaml:4: the training of 'geo-evs' cannot have 'ddpm' for its option "
        "'sampling.sampler'; did you mean 'd",
    ),
    "a probability above one": (
        "trainings: {geo-evs: {probability: 1.5}}",
        "over.yaml:1: the training of 'geo-evs' cannot have 1.5 for its option 'probability'; "
        "choose from 0 to 1",
    ),
    "no steps": (
        "trainings: {geo-evs: {steps: 0}}",
        "over.yaml:1: the training of 'geo-evs' cannot have 0 for its option 'steps'; make it 1",
    ),
    "a number that YAML takes for text": (
        "trainings: {geo-evs: {learning_rate: 1e-3}}",
        "over.yaml:1: the training of 'geo-evs' cannot have '1e-3' for its option "
        "'learning_rate'; write 0.001 (YAML takes '1e-3' for text)",
    ),
    "no number": (
        "trainings: {geo-evs: {learning_rate: .nan}}",
        "over.yaml:1: 'trainings.geo-evs.learning_rate' is wrong: nan is not a number",
    ),
    "a variant that is a path": (
        "trainings: {geo-evs: {variants: {../v1: {}}}}",
        "over.yaml:1: '../v1' is not an allowed name; use lower case and hyphens",
    ),
    "the section of version 0.1": (
        "training: {steps: 10}",
        "over.yaml:1: the section 'training' is 'trainings.geo-evs' now; move its keys under",
    ),
    "the other section of version 0.1": (
        "freevs: {steps: 10}",
        "over.yaml:1: the section 'freevs' is 'trainings.freevs' now; move its keys under",
    ),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_is_one_sentence_with_its_line(check, tmp_path, kind):
    overlay, sentence = MISTAKES[kind]
    with pytest.raises(GeoEvsError) as caught:
        check(overlay)
    assert str(caught.value).startswith(f"{tmp_path}/{sentence}")
    assert "\n" not in str(caught.value)


def test_a_trained_method_needs_training_scenes(check):
    config = yaml.safe_load((PROJECT / "config.yaml").read_text())
    none = {name: {"partitions": {"train": []}} for name in config["datasets"]}
    with pytest.raises(GeoEvsError, match=r"method 'geo-evs' is trained, but no data set has sce"):
        check(yaml.safe_dump({"datasets": none}))
    untrained = dict.fromkeys(m for m in config["methods"] if m.startswith("geo-evs"))
    check(yaml.safe_dump({"datasets": none, "methods": untrained}))


def test_freevs_needs_clips(check):
    nothing = "datasets: {street-clips: {partitions: {clips: []}}}"
    with pytest.raises(
        GeoEvsError, match=r"method 'freevs' is trained, but no .* partitions.clips"
    ):
        check(nothing)
    check(f"{nothing}\nmethods: {{freevs: null}}")


def test_a_frame_may_train_both_in_pairs_and_in_clips(check):
    both = "datasets: {street-clips: {partitions: {clips: [straight-501], train: [straight-501]}}}"
    check(both)
    tested = both.replace("train:", "test:")
    with pytest.raises(GeoEvsError, match=r"a frame may serve one partition only, so remove one$"):
        check(tested)


def test_a_variant_is_what_differs_from_the_section(check):
    config = check(
        "trainings:\n"
        "  geo-evs:\n"
        "    sampling: {steps: 8, guidance: 1.5}\n"
        "    variants: {mine: {masks: boxes, sampling: {guidance: 3.0}}}\n"
    )
    section = config["trainings"]["geo-evs"]
    shared = {name: value for name, value in section.items() if name != "variants"}
    mine = training_settings(config, "geo-evs/mine")
    sampling = shared["sampling"] | {"guidance": 3.0}
    assert mine == shared | {"masks": "boxes", "sampling": sampling}
    assert training_settings(config, "geo-evs/v3") == shared
    assert training_settings(config, "geo-evs/default") == shared
    assert "variants" not in mine


def test_a_section_may_be_left_out(check):
    config = yaml.safe_load((PROJECT / "config.yaml").read_text())
    del config["trainings"]["freevs"]
    check_config(config, SCHEMA, [])
    assert training_settings(config, "freevs/default") == {}


@pytest.mark.parametrize("method", find_trainings())
def test_the_config_spells_out_the_defaults(method):
    settings = asdict(training_class(method).Settings())
    section = yaml.safe_load((PROJECT / "config.yaml").read_text())["trainings"][method]
    section.pop("variants", None)
    assert section == settings


def test_entrants_know_their_training_and_seed(check):
    config = check("methods: {geo-evs: {training: v3, seeds: [0, 2]}}\nseed: 5")
    entries = method_entries(config)
    trainings = {(entry.name, entry.seed): entry.training for entry in entries}
    assert trainings["geo-evs", 5] == trainings["geo-evs", 7] == "geo-evs/v3"
    assert trainings["geo-evs-support", 5] == "geo-evs/v3"
    assert trainings["freevs", 5] == "freevs/default"
    assert trainings["reproject", 5] == ""


def test_the_papers_scale_is_the_papers(check):
    config = check((PROJECT / "workflow/scales/paper.yaml").read_text())
    settings = training_settings(config, "geo-evs/v3")
    sampling = settings["sampling"]
    assert config["resolution"] == [512, 512]
    assert config["geometry"]["model"] == "vggt-1b"
    assert settings["prediction"] == "epsilon"
    assert settings["learning_rate"] == 1e-4
    assert (settings["masks"], settings["probability"]) == ("reprojected", 0.4)
    assert settings["validity"] is False
    assert (sampling["steps"], sampling["guidance"]) == (30, 1.5)
    freevs = training_settings(config, "freevs/default")
    assert (freevs["learning_rate"], freevs["drop"], freevs["simulated"]) == (5e-5, 0.2, 0.5)
    assert freevs["noise"] == {"mean": 0.7, "std": 1.6}
    assert freevs["sampling"] == {
        **{"steps": 25, "guidance": 2.0},
        **{"sigma_max": 700.0, "average": 1},
    }
    (emernerf,) = (e for e in method_entries(config) if e.name == "emernerf")
    made = make_method(emernerf.method, emernerf.options)
    assert (made.iterations, made.rays, made.learning_rate) == (25000, 8192, 0.01)
    assert (made.levels, made.log2_entries, made.width) == (10, 20, 64)
    assert made.samples == (128, 64, 64)
