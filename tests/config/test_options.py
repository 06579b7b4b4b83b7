"""Values and types of options are checked when the config is read; sentences say what to write."""

import copy
from pathlib import Path

import pytest
import yaml
from snakemake.utils import update_config

from geoevs.config.checks import check_config
from geoevs.core.errors import GeoEvsError

PROJECT = Path(__file__).parents[2]
SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"

OPTIONS = {
    "emernerf": (
        (
            "iterations: '1e3'",
            "cannot have '1e3' for its option 'iterations'; write 1000 (YAML takes '1e3'",
        ),
        (
            "iterations: lots",
            "cannot have 'lots' for its option 'iterations'; write a whole",
        ),
        ("iterations: -1", "cannot have -1 for its option 'iterations'; make it 1 or more"),
        ("iterations: 2.5", "cannot have 2.5 for its option 'iterations'; write a whole"),
        ("rays: null", "cannot have null for its option 'rays'; write a whole"),
        (
            "learning_rate: .inf",
            "options.learning_rate' is wrong: inf is not a num",
        ),
        ("samples: [1, 2]", "cannot have [1, 2] for its option 'samples'; write a list of 3"),
        ("levels: 3", "cannot have 3 for its option 'levels'; make it 4 or more"),
    ),
    "three-dgs": (
        (
            "gaussians: '4000'",
            "cannot have '4000' for its option 'gaussians'; write 4000",
        ),
        ("gaussians: 5", "cannot have 5 for its option 'gaussians'; make it 100 or more"),
        ("densification: mcmcc", "for its option 'densification'; did you mean 'mcmc'? (one of: "),
        ("sfm_cache: 3", "cannot have 3 for its option 'sfm_cache'; write text"),
    ),
    "reproject-inpaint": (
        ("inpaint: no", "YAML reads no as false; write false, or 'no' in quotes if text"),
        ("inpaint: tela", "cannot have 'tela' for its option 'inpaint'; did you mean 'telea'?"),
        ("frames: every", "cannot have 'every' for its option 'frames'; one of: all, own"),
    ),
    "geo-evs": (
        ("sampler: nonsense", "for its option 'sampler'; one of: ddim, dpm-solver, euler"),
        ("steps: 0", "cannot have 0 for its option 'steps'; choose from 1 to 1000"),
        ("guidance: -1", "cannot have -1 for its option 'guidance'; make it 0 or more"),
        ("average: true", "cannot have true for its option 'average'; write a whole"),
    ),
    "freevs": (("sigma_max: 0", "cannot have 0 for its option 'sigma_max'; make it more"),),
    "external": (("folder: 5", "cannot have 5 for its option 'folder'; write text"),),
}
STREET = (
    ("frames: '8'", "cannot have '8' for its option 'frames'; write 8 ("),
    ("frames: 2.5", "cannot have 2.5 for its option 'frames'; write a whole"),
    ("frames: true", "cannot have true for its option 'frames'; write a whole"),
    ("frames: 61", "cannot have 61 for its option 'frames'; choose from 1 to 60"),
    ("samples: '9'", "cannot have '9' for its option 'samples'; write 9 ("),
    ("interval: '0.1'", "cannot have '0.1' for its option 'interval'; write 0.1 ("),
    ("interval: 0", "cannot have 0 for its option 'interval'; make it more than 0"),
    ("traffic_speed: -1", "cannot have -1 for its option 'traffic_speed'; choose from 0 to 40"),
    ("frames: 60, interval: 1.0", "street's options make 60 frames of 1.0 s each; streets last"),
)
SCENES = (
    ("junction-101@0-99", "scene 'junction-101' has no frame 8; its frames are 0 to 7"),
    ("junction-101@9-9", "scene 'junction-101' has no frame 9; its frames are 0 to 7"),
    ("roundabout-1", "street scene 'roundabout-1' is not of the form LAYOUT-SEED"),
)


def refusal(text: str, tmp_path: Path) -> str:
    """What the config's check says of the default config under an overlay."""
    overlay = tmp_path / "over.yaml"
    overlay.write_text(text)
    config = yaml.safe_load((PROJECT / "config.yaml").read_text())
    update_config(config, copy.deepcopy(yaml.safe_load(text)))
    with pytest.raises(GeoEvsError) as caught:
        check_config(config, SCHEMA, [PROJECT / "config.yaml", overlay])
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(str(overlay))


@pytest.mark.parametrize(
    ("method", "option", "sentence"), [(m, *case) for m, cases in OPTIONS.items() for case in cases]
)
def test_a_methods_option(tmp_path, method, option, sentence):
    text = f"methods:\n  {method}:\n    options:\n      {option}\n"
    said = refusal(text, tmp_path)
    assert said.startswith(":4: ")
    assert sentence in said


@pytest.mark.parametrize(("option", "sentence"), STREET)
def test_a_sources_option(tmp_path, option, sentence):
    said = refusal(f"datasets:\n  street:\n    options: {{{option}}}\n", tmp_path)
    assert said.startswith(":3: ")
    assert sentence in said


@pytest.mark.parametrize(("scene", "sentence"), SCENES)
def test_a_scene_that_no_source_has(tmp_path, scene, sentence):
    said = refusal(f"datasets:\n  street:\n    partitions:\n      test: [{scene}]\n", tmp_path)
    assert said.startswith(f":4: {sentence}")


def test_an_option_that_is_missing(tmp_path):
    said = refusal("methods:\n  external: {}\n", tmp_path)
    assert said.startswith(":2: method 'external' needs the option 'folder'")


def test_an_option_of_the_stability_suite(tmp_path):
    said = refusal("stability:\n  methods:\n    three-dgs: {densification: mcmcc}\n", tmp_path)
    assert said.startswith(":3: method 'three-dgs' cannot have 'mcmcc' for its option")
