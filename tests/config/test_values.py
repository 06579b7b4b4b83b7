"""What no value of a config may be, and what the sentences say to write."""

import copy
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from snakemake.utils import update_config

from geoevs.config.checks import check_config
from geoevs.config.partitions import expand_scenes
from geoevs.config.values import check_values
from geoevs.core.errors import GeoEvsError
from geoevs.core.names import expanded
from geoevs.core.randomness import Rng
from geoevs.core.settings import SettingError, plain_advice
from geoevs.methods.contract import Budget
from geoevs.methods.finding import make_method
from geoevs.scenes.scene import load_source

PROJECT = Path(__file__).parents[2]
SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"
BASE = yaml.safe_load((PROJECT / "config.yaml").read_text())


def refusal(key: str, value: object) -> str:
    """What is said of the default config with one value, at a dotted key, changed."""
    change: object = value
    for part in reversed(key.split("/")):
        change = {part: change}
    config = yaml.safe_load((PROJECT / "config.yaml").read_text())
    update_config(config, change)
    begun = time.monotonic()
    with pytest.raises(GeoEvsError) as caught:
        check_config(config, SCHEMA, [])
    assert time.monotonic() - begun < 8
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000
    return str(caught.value)


def numbers(value: object, key: tuple = ()) -> list[tuple]:
    """The keys of all numbers in a config."""
    parts = {}
    if isinstance(value, (dict, list)):
        parts = value if isinstance(value, dict) else dict(enumerate(value))
    found = [found for name, part in parts.items() for found in numbers(part, (*key, name))]
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return [*found, key] if number else found


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 10**30, -(10**400)])
def test_no_number_of_the_config_may_be_endless(value):
    keys = numbers(BASE)
    assert len(keys) > 100
    for key in keys:
        config = copy.deepcopy(BASE)
        section = config
        for part in key[:-1]:
            section = section[part]
        section[key[-1]] = value
        with pytest.raises(SettingError, match=r"is not a number that can be used; write a finite"):
            check_values(config)


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("seed", 2**32, "make it 4,294,967,295 or less"),
        ("seed", 3.0, "3.0 is of another type; write a whole number"),
        ("seed", True, "true is of another type; write a whole number"),
        ("resolution", [10**9, 192], "make it 8,192 or less"),
        ("tables/confidence", float("nan"), "nan is not a number that can be used"),
        ("tables/resamples", 10**12, "make it 1,000,000 or less"),
        ("datasets/street/options/frames", 10**9, "choose from 1 to 60"),
        ("methods/three-dgs/options", {"gaussians": 10**12}, "make it 100,000,000 or less"),
        ("methods/emernerf/options", {"levels": 10**6}, "make it 32 or less"),
        ("methods/emernerf/options", {"iterations": 10**12}, "make it 1,000,000,000 or less"),
        ("methods/geo-evs/seeds", [2**31], "make it 2,147,483,647 or less"),
        ("pretrain/prior/steps", 10**10, "make it 1,000,000,000 or less"),
        ("trainings/geo-evs/steps", 10**10, "make it 1,000,000,000 or less"),
        ("protocol/lateral", [1e6], "make it 1,000 or less"),
        ("protocol/pose_sweep/angles", [400], "make it 180 or less"),
        ("protocol/pose_sweep/every", 10**9, "make it 1,000,000 or less"),
        ("stability/seeds", 10**6, "make it 1,000 or less"),
        ("seed", "010", "write 10 (YAML takes '010' for text)"),
        ("protocol/lateral", ["1e-3"], "write 0.001 (YAML takes '1e-3' for text)"),
        ("budget/fit_seconds", "1e3", "write 1000.0 (YAML takes '1e3' for text) or null"),
        ("trainings/geo-evs", None, "null is of another type; write NAME: VALUE, indented under"),
        ("methods/geo-evs/options", None, "null is of another type; write NAME: VALUE"),
        ("evaluate", "street", "'street' is of another type; write a list, such as"),
        ("run", 5, "5 is of another type; write text, in quotes"),
        ("weights", "", "'weights' is wrong: '' is empty; write something"),
        ("weights", "a{b}", "'a{b}' has braces, which Snakemake takes for wildcards"),
        ("run", "a\n", "its text is not one line of letters; remove line breaks"),
        ("run", "a\U000cf4f5", "remove line breaks and what cannot be seen"),
        ("weights", "a\u202eb", "remove line breaks and what cannot be seen"),
        ("run", "x" * 5000, "its text has 5,000 characters; write 1,000 at most"),
        ("run", "x" * 100, "is too long; use 60 characters at most"),
        ("weights", "a\ud800", "its text is not one line of letters"),
        ("geometry/weights", "a\0b", "its text is not one line of letters"),
        ("methods/mean-colour.a\n", {}, "its text is not one line of letters"),
        ("datasets/new\n", {}, "its text is not one line of letters"),
        ("methods/mean-colour.-x", {}, "'mean-colour.-x' is not an allowed name"),
        ("methods/mean-colour.a b", {}, "'mean-colour.a b' is not an allowed name"),
        ("methods/mean-colour.$(x)", {}, "is not an allowed name"),
        ("methods", dict.fromkeys(BASE["methods"]), "there is no method to run; give one of them"),
        ("datasets/street/partitions/test", ["roundabout-1"], "not of the form LAYOUT-SEED"),
        ("datasets/street/partitions/test", ["a-" + "1" * 200], "use 100 characters at most"),
        ("methods/external", {}, "method 'external' needs the option 'folder'"),
        ("methods/freevs/training", "geo-evs/v3", "'freevs' cannot read the weights of 'geo-evs'"),
        ("methods/geo-evs/training", "freevs/default", "name a training of 'geo-evs'"),
        ("methods/geo-evs-support/training", "freevs/default", "name a training of 'geo-evs'"),
    ],
)
def test_a_value_is_refused_with_what_to_write(key, value, sentence):
    assert sentence in refusal(key, value)


def test_the_weights_of_a_training_are_no_option_to_offer():
    said = refusal("methods/geo-evs/options", {"weihgts": "there"})
    assert "has no option 'weihgts'" in said
    assert "weights" not in said.replace("weihgts", "")


@pytest.mark.parametrize(
    "scenes",
    [
        ["junction-1..1000000000"],
        ["junction-1..9999", "curve-1..9999"],
        ["1..99999999999999999999999999999999999999999999999999999999999999999999999999999"],
    ],
)
def test_ranges_are_counted_before_they_are_written_out(scenes):
    begun = time.monotonic()
    with pytest.raises(GeoEvsError, match=r"a partition has 10,000 at most|is not of the form"):
        expand_scenes(scenes)
    assert time.monotonic() - begun < 0.5


def test_many_scenes_are_compared_within_seconds():
    partitions = {
        "train": ["curve-3000..9000"],
        "test": ["straight-3000..9000", "curve-9000..9010"],
    }
    said = refusal("datasets/street/partitions", partitions | {"clips": ["curve-8000..9999"]})
    assert "has scene 'curve-9000' in partition 'test' and 'curve-9000' in 'train'" in said
    frames = {"train": [f"a@{2 * n}-{2 * n}" for n in range(2000)], "test": ["a@77-78"]}
    new = {"source": "pandaset", "options": {"folder": "x"}, "partitions": frames}
    said = refusal("datasets/new", new)
    assert "'a@78-78' in partition 'train'" in said or "'a@77-78' in partition 'test'" in said


def test_scenes_of_all_data_sets_are_counted():
    many = {name: [f"{name}-1..9999"] for name in ("train", "clips", "geometry")}
    one = {"source": "pandaset", "options": {"folder": "x"}, "partitions": many}
    said = refusal("datasets", {"a": one, "b": one})
    assert "up to data set 'b' there are more than 50,000 scenes; name fewer" in said


def test_a_path_as_written_comes_before_one_with_names_in_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HERE", "there")
    monkeypatch.setenv("EMPTY", "")
    monkeypatch.setenv("HOME", "/home/somebody")
    assert expanded("a$HERE b") == Path("athere b")
    assert expanded("~/x") == Path("/home/somebody/x")
    assert expanded("${HERE}/x") == Path("there/x")
    assert expanded("$EMPTY") == Path("$EMPTY")
    assert expanded("$UNKNOWN/x") == Path("$UNKNOWN/x")
    for name in ("a$HERE b", "~"):
        Path(name).mkdir()
        assert expanded(name) == Path(name)
    Path("a$HERE b/x").mkdir()
    source = load_source("pandaset", 16, 16, {"folder": "a$HERE b"})
    assert source.folder == Path("a$HERE b")
    views = SimpleNamespace(scene_name="x")
    external = make_method("external", {"folder": "a$HERE b"})
    external.fit(views, Budget(), Rng(0, "x"))
    assert expanded("n" * 5000 + "\0") == Path("n" * 5000 + "\0")


@pytest.mark.parametrize(
    ("value", "kind", "advice"),
    [
        ("1e-3", float, "0.001 (YAML takes '1e-3' for text)"),
        ("1e-9", float, "1.0e-09 (YAML"),
        ("2.5", int, "a whole number"),
        ("lots", float, "a number, such as"),
        ("nan", float, "a number, such as"),
        ("1e999", int, "a whole number"),
        (10**400, float, "a finite number"),
        (float("nan"), int, "a finite number"),
    ],
)
def test_advice_is_what_yaml_reads(value, kind, advice):
    said = plain_advice(value, kind)
    assert said.startswith(advice)
    if isinstance(value, str) and "YAML" in said:
        assert isinstance(yaml.safe_load(said.partition(" ")[0]), kind)
