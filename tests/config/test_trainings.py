"""Trainings in the config: what an entrant takes, what a variant is, and mistakes in either."""

import copy
from pathlib import Path

import pytest
import yaml

from geoevs.config.checks import check_config, method_entries, training_settings
from geoevs.core.errors import GeoEvsError
from geoevs.methods.finding import make_method

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
        "over.yaml:1: there is no training 'v4' under 'training.variants'; did you mean 'v",
    ),
    "a trained method without a training": (
        "methods:\n  geo-evs.mine: {}",
        "over.yaml:2: method 'geo-evs.mine' is trained before it is fitted; name one under "
        "'training' (v1, v2, ",
    ),
    "a training for a method that has none": (
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
    "another method's training": (
        "methods: {freevs: {training: v3}}",
        "over.yaml:1: there is no training 'v3' under 'freevs'; one of: freevs",
    ),
    "a variant with the name of a training of its own": (
        "training:\n  variants: {freevs: {}}",
        "over.yaml:2: 'freevs' is FreeVS's own training; rename the variant",
    ),
    "no frames in a clip": (
        "freevs: {frames: 0}",
        "over.yaml:1: 'freevs.frames' is wrong: 0 is less",
    ),
    "an unknown key": (
        "training:\n  learning_rat: 1",
        "over.yaml:2: 'learning_rat' is not a known key; did you mean 'learning_rate'?",
    ),
    "an unknown key of a variant": (
        "training: {variants: {v1: {mask: none}}}",
        "over.yaml:1: 'mask' is not a known key; did you mean 'masks'?",
    ),
    "an unknown kind of masks": (
        "training: {variants: {v1: {masks: box}}}",
        "over.yaml:1: 'training.variants.v1.masks' is wrong: 'box' is not one of ['none', ",
    ),
    "an unknown sampler": (
        "training: {sampling: {sampler: ddpm}}",
        "over.yaml:1: 'training.sampling.sampler' is wrong: 'ddpm' is not one of ['ddim', ",
    ),
    "a probability above one": (
        "training: {probability: 1.5}",
        "over.yaml:1: 'training.probability' is wrong: 1.5 is greater than the maximum of 1 "
        "(it means: The paper's p: ",
    ),
    "no steps": ("training: {steps: 0}", "over.yaml:1: 'training.steps' is wrong: 0 is less"),
    "a variant that is a path": (
        "training: {variants: {../v1: {}}}",
        "over.yaml:1: '../v1' is not an allowed name; use lower case and hyphens",
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
        "training:\n"
        "  sampling: {steps: 8, guidance: 1.5}\n"
        "  variants: {mine: {masks: boxes, sampling: {guidance: 3.0}}}\n"
    )
    shared = {name: value for name, value in config["training"].items() if name != "variants"}
    mine = training_settings(config, "mine")
    sampling = shared["sampling"] | {"guidance": 3.0}
    assert mine == shared | {"masks": "boxes", "sampling": sampling}
    assert training_settings(config, "v3") == shared
    assert "variants" not in mine


def test_entrants_know_their_training_and_seed(check):
    config = check("methods: {geo-evs: {training: v3, seeds: [0, 2]}}\nseed: 5")
    found = [
        (entry.training, entry.seed)
        for entry in method_entries(config)
        if (entry.method, entry.variant) == ("geo-evs", "default")
    ]
    assert found == [("v3", 5), ("v3", 7)]


def test_the_papers_scale_is_the_papers(check):
    config = check((PROJECT / "workflow/scales/paper.yaml").read_text())
    settings = training_settings(config, "v3")
    sampling = settings["sampling"]
    assert config["resolution"] == [512, 512]
    assert config["geometry"]["model"] == "vggt-1b"
    assert settings["prediction"] == "epsilon"
    assert settings["learning_rate"] == 1e-4
    assert (settings["masks"], settings["probability"]) == ("reprojected", 0.4)
    assert settings["validity"] is False
    assert (sampling["steps"], sampling["guidance"]) == (30, 1.5)
    freevs = config["freevs"]
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
