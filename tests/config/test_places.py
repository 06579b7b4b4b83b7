"""Whose mistake it is: the last origin that sets a key, and the line in it."""

import copy
from pathlib import Path

import pytest
import yaml
from snakemake.utils import update_config

from geoevs.config.checks import check_config
from geoevs.config.places import ConfigFile, locate, merge_order
from geoevs.core.errors import GeoEvsError

PROJECT = Path(__file__).parents[2]
SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"
BASE = PROJECT / "config.yaml"


@pytest.fixture
def said(tmp_path):
    """What is said of the default config under overlays, first.yaml and so on, and `--config`."""

    def run(*texts: str, arguments: dict | None = None) -> str:
        config = yaml.safe_load(BASE.read_text())
        files = [BASE]
        for name, text in zip(("first", "second"), texts, strict=False):
            files.append(tmp_path / f"{name}.yaml")
            files[-1].write_text(text)
            update_config(config, yaml.safe_load(text))
        update_config(config, copy.deepcopy(arguments or {}))
        with pytest.raises(GeoEvsError) as caught:
            check_config(config, SCHEMA, files, arguments)
        return str(caught.value).replace(f"{tmp_path}/", "")

    return run


@pytest.mark.parametrize(
    ("overlays", "place"),
    [
        (["# mine\nseed: -1\n"], "first.yaml:2: 'seed' is wrong"),
        (["seed: -1\n", "run: x\n"], "first.yaml:1: 'seed' is wrong"),
        (["seed: 2\n", "\n\nseed: -1\n"], "second.yaml:3: 'seed' is wrong"),
        (["protocol:\n  masked: {every: 0}\n"], "first.yaml:2: 'protocol.masked.every' is"),
        (["resolution: [128,\n  2]\n"], "first.yaml:2: 'resolution.1' is wrong"),
        (["protocol:\n  lateral:\n  - 1\n  - x\n"], "first.yaml:4: 'protocol.lateral.1' is"),
        (["tables: {resamples: 1.0e+12}\n"], "first.yaml:1: 'tables.resamples' is wrong"),
        (["budget:\n"], "first.yaml:1: 'budget' is wrong: null is of another type"),
        (["\nnew: 1\n"], "first.yaml:2: 'new' is not a known key"),
        (["methods:\n  mine: {}\n"], "first.yaml:2: there is no method 'mine'"),
        (["methods:\n  three-dgs: {option: {}}\n"], "first.yaml:2: 'option' is not a known key"),
        (["evaluate: [none]\n", "seed: 1\n"], "first.yaml:1: there is no data set 'none'"),
        (
            ["datasets:\n  new: {source: street, options: {}}\n"],
            "first.yaml:2: the key 'partitions' is missing under 'datasets.new'",
        ),
        (
            ["datasets:\n  street:\n    options: {frames: 0}\n", "run: x\n"],
            "first.yaml:3: data source 'street' cannot have 0",
        ),
    ],
)
def test_the_file_that_set_the_key_is_named(said, overlays, place):
    assert said(*overlays).startswith(place)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"seed": -1}, "--config: 'seed' is wrong: -1 is too small"),
        ({"run": 2024}, "--config: 'run' is wrong: 2024 is of another type; write text"),
        ({"nosuch": 1}, "--config: 'nosuch' is not a known key"),
        ({"protocol": {"lateral": ["1"]}}, "--config: 'protocol.lateral.0' is wrong: '1' is of"),
        ({"evaluate": ["none"]}, "--config: there is no data set 'none'"),
        ({"seed": float("nan")}, "--config: 'seed' is wrong: nan is not a number"),
    ],
)
def test_what_the_command_line_set_is_named_so(said, arguments, sentence):
    assert said("seed: 1\n", arguments=arguments).startswith(sentence)
    assert said("seed: -1\n", arguments={"run": "x"}).startswith("first.yaml:1: ")


def test_values_within_config_arguments_are_text(said):
    assert "so write a file" in said(arguments={"protocol": {"lateral": ["1"]}})
    assert "so write a file" not in said(arguments={"seed": "x"})


def test_a_merged_key_is_found_where_its_section_stands(tmp_path):
    path = tmp_path / "over.yaml"
    path.write_text("a: &a\n  x: 1\n  y: 2\nb:\n  <<: [{z: 3}, *a]\n  y: 4\n")
    origins = [ConfigFile.read(path)]
    lines = {"x": 2, "y": 6, "z": 5}
    found = {name: locate(("b", name), origins) for name in lines}
    assert found == {name: f"{path}:{line}" for name, line in lines.items()}


@pytest.mark.parametrize(
    ("own", "given", "order"),
    [
        (["config.yaml"], [], ["config.yaml"]),
        (["config.yaml"], ["{}/config.yaml", "{}/x.yaml"], ["config.yaml", "x.yaml"]),
        (["config.yaml"], ["{}/x.yaml"], ["config.yaml", "x.yaml"]),
        (["config.yaml"], ["{}/x.yaml", "{}/config.yaml"], ["x.yaml", "config.yaml"]),
        (["config.yaml"], ["{}/x.yaml", "/y", "{}/x.yaml"], ["config.yaml", "/y", "x.yaml"]),
        ([], ["{}/x.yaml"], ["x.yaml"]),
    ],
)
def test_the_order_is_that_of_merging(tmp_path, monkeypatch, own, given, order):
    monkeypatch.chdir(tmp_path)
    assert merge_order(own, [Path(path.format(tmp_path)) for path in given]) == [
        Path(path) for path in order
    ]
