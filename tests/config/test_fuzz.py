"""Configs that nobody would write: each is refused in one sentence with its file, or accepted.

`pytest --hypothesis-profile long` tries thousands, and new ones each time.
"""

import copy
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from snakemake.common.configfile import load_configfile
from snakemake.utils import update_config

from geoevs.config.checks import check_config
from geoevs.config.entrants import method_entries, stability_entries
from geoevs.config.files import read_nodes
from geoevs.config.partitions import partition_scenes
from geoevs.config.trainings import training_settings
from geoevs.core.errors import GeoEvsError

PROJECT = Path(__file__).parents[2]
SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"
BASE = PROJECT / "config.yaml"
TEXTS = [path.read_text() for path in (BASE, *sorted((PROJECT / "workflow/scales").iterdir()))]

few = settings(
    max_examples=settings().max_examples // 4,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


def keys_of(value: Any, key: tuple = ()) -> list[tuple]:
    """The keys of all sections, lists and values of a config."""
    parts = value.items() if isinstance(value, dict) else ()
    if isinstance(value, list):
        parts = enumerate(value)
    return [key, *(found for name, part in parts for found in keys_of(part, (*key, name)))]


DEFAULTS = load_configfile(BASE)
KEYS = [key for key in keys_of(DEFAULTS) if key]
NUMBERS = [0, -1, 0.5, 10**9, 10**30, -(10**400), 1e308, float("nan"), float("inf"), -0.0, 3.0]
WORDS = [
    *("", "a", "geo-evs", "street", "three-dgs", "junction-101", "..", "../x", "a@1-2", "a@9-2"),
    *("1..9", "a-1..999999999", "1e-3", "010", "no", "~/x", "$HOME", "a\nb", "\x00", "\ud800"),
    *("x" * 2000, "lidar", "vggt-1b", "geo-evs/v3", "freevs/default", "/", "a/b/c", "{x}", "%s"),
    *("é", "<<", "=", "!x", "*a", "&a", "2024-01-01", "default", "reference", "null", "'", '"'),
]
LEAVES = st.one_of(
    *(st.none(), st.booleans(), st.sampled_from(NUMBERS), st.sampled_from(WORDS)),
    *(st.integers(), st.floats()),
)
NAMES = st.sampled_from([*WORDS, *(part for key in KEYS for part in key if isinstance(part, str))])
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=6,
)


def try_config(text: str | bytes) -> str:
    """What is said of the default config under an overlay; nothing if it is accepted."""
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        overlay = Path(folder) / "over.yaml"
        overlay.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "replace"))
        said = ""
        try:
            read_nodes(overlay)
            config = copy.deepcopy(DEFAULTS)
            update_config(config, load_configfile(overlay))
            check_config(config, SCHEMA, [BASE, overlay])
        except GeoEvsError as mistake:
            said = str(mistake)
            assert said.startswith((str(overlay), str(BASE))), said
            assert len(said) < 2500, said
            assert said.isprintable(), said
        else:
            use(config)
    assert time.monotonic() - begun < 10
    return said


def use(config: Any) -> None:
    """What the rules do with an accepted config."""
    entries = method_entries(config) + stability_entries(config)
    for entry in entries:
        assert "/" not in entry.label
        if entry.training:
            json.dumps(training_settings(config, entry.training), allow_nan=False)
    for partition in ("test", "train", "clips", "geometry", "pretrain"):
        partition_scenes(config, partition, config["datasets"])
    json.dumps(config, allow_nan=False).encode()


@few
@given(key=st.sampled_from(KEYS), value=VALUES, flow=st.booleans())
def test_any_value_at_any_key(key, value, flow):
    change: Any = value
    for part in reversed(key):
        change = [change] if isinstance(part, int) else {part: change}
    try_config(yaml.safe_dump(change, default_flow_style=flow, allow_unicode=True))


@few
@given(key=st.sampled_from(KEYS), name=NAMES, value=VALUES)
def test_any_key_in_any_section(key, name, value):
    change: Any = {name: value}
    for part in reversed([part for part in key if isinstance(part, str)]):
        change = {part: change}
    try_config(json.dumps(change))


PIECES = st.sampled_from(
    [
        *("\t", "\n", " ", "  ", "- ", ": ", ":", "[", "]", "{", "}", ",", "#", "&a ", "*a"),
        *("<<: ", "{", "0", "-", "null", "true"),
        *("? ", "| ", "> ", "!!int ", "!x ", "%YAML 1.2\n", "---\n", "...\n", "'", '"', "\\", "@"),
        *("010", "0x", "1:30", ".nan", "1e-3", "no", "~", "=", "\ufeff", "\x00", "\u2028", "é"),
    ]
)


@few
@given(
    text=st.sampled_from(TEXTS),
    edits=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 30), PIECES), max_size=4),
)
def test_any_slip_of_the_keyboard(text, edits):
    for place, cut, piece in edits:
        at = int(place * len(text))
        text = text[:at] + piece + text[at + cut :]
    try_config(text)


@few
@given(st.binary(max_size=200) | st.text(max_size=200))
def test_any_bytes(data):
    try_config(data)
