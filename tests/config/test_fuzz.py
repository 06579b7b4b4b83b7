"""Configs that nobody would write: each is refused in one sentence with its file, or accepted.

`pytest --hypothesis-profile long` tries thousands, and new ones each time.
"""

import copy
import json
import re
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
from geoevs.config.entrants import detection_entries, method_entries, stability_entries
from geoevs.config.files import read_nodes
from geoevs.config.partitions import partition_scenes
from geoevs.config.trainings import training_settings
from geoevs.core.errors import GeoEvsError
from geoevs.methods.finding import find_methods
from geoevs.protocol.stressors import STRESSORS
from geoevs.scenes.scene import find_sources
from tests.fuzzing import MISSING, count, number, sound_json, text, whole

PROJECT = Path(__file__).parents[2]
SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"
BASE = PROJECT / "config.yaml"
TEXTS = [path.read_text() for path in (BASE, *sorted((PROJECT / "workflow/scales").glob("*.yaml")))]

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


METHODS = {"reference", "truth", *find_methods()}
DATASETS = {name for text in TEXTS for name in yaml.safe_load(text).get("datasets", {})}
TRAININGS = {"default", "v1", "v2", "v2-unmatched", "v3"}
SHIFT, ANGLE, SHARE = number(-1000, 1000), number(0, 180), number(0, 1)
ABOVE_0 = 1e-300
OPTIMISATION = {
    **dict.fromkeys(("steps", "batch"), whole(1, 10**9)),
    "learning_rate": number(ABOVE_0, 1000),
}


def list_of(rule, least=0):
    """Whether a value is a list of different values that a rule allows."""

    def holds(value):
        if not (isinstance(value, list) and len(value) >= least and all(map(rule, value))):
            return False
        return len(set(map(str, value))) == len(value)

    return holds


def or_none(rule):
    return lambda value: value is None or rule(value)


def one_of(*words):
    return lambda value: text(value) and value in words


def named(names, rule):
    """Whether what has such a name is what a rule allows."""
    return lambda value, old, key: key in names and rule(value)


def section_of(*keys):
    return lambda value: isinstance(value, dict) and set(value) <= set(keys) and finite(value)


def finite(value):
    """Whether all numbers in a value are finite, and none has hundreds of digits."""
    if isinstance(value, (dict, list)):
        return all(map(finite, value.values() if isinstance(value, dict) else value))
    return number()(value) or not isinstance(value, (int, float)) or isinstance(value, bool)


def like(value, old):
    """Whether an option or a setting is of the same kind as before; a new one has any."""
    if old is MISSING or old is None or value is None:
        return finite(value)
    same = type(value) is type(old) or (type(old) is float and type(value) is int)
    return same and (
        isinstance(value, bool) or not isinstance(value, int | float) or number(0)(value)
    )


def scene(value):
    """Whether a value can name a scene: which there are, only the source's folder tells."""
    if isinstance(value, dict):
        known = value.keys() == {"list", "indices"}
        return known and text(value["list"]) and lines(value["indices"])
    name = r"[A-Za-z0-9_.-]+(@[0-9]+-[0-9]+|\.\.[0-9]+)?"
    return text(value) and re.fullmatch(name, value) is not None


def lines(value):
    ranged = text(value) and re.fullmatch(r"[0-9]+\.\.[0-9]+", value)
    return bool(ranged) or list_of(whole())(value)


def training(value):
    return text(value) and value.split("/")[-1] in TRAININGS


def each(place, rule, least=1):
    """A list of such values at a place, and each of them."""
    return {place: list_of(rule, least), (*place, "*"): rule}


RULES = {
    ("run",): lambda value: text(value) and re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,59}", value),
    ("seed",): whole(0, 2**32 - 1),
    **each(("resolution",), whole(16, 8192), 2),
    ("renders",): one_of("keep", "drop"),
    ("cluster", "gpu"): whole(0, 64),
    **each(("evaluate",), one_of(*DATASETS)),
    ("datasets", "*", "source"): one_of(*find_sources()),
    ("datasets", "*", "partitions", "*", "*", "list"): text,
    ("datasets", "*", "partitions", "*", "*", "indices"): lines,
    ("datasets", "*", "partitions", "*", "?"): list_of(scene),
    ("datasets", "*", "partitions", "*", "*"): scene,
    ("datasets", "*", "options", "*", "?"): like,
    ("datasets", "*"): section_of("source", "options", "partitions"),
    ("weights",): lambda value: text(value) and 0 < len(value) <= 1000 and value.isprintable(),
    ("geometry", "model"): one_of("lidar", "vggt-nano", "vggt-1b", "depth-anything-3"),
    ("geometry", "weights"): or_none(text),
    ("geometry", "supervision"): one_of("dense", "lidar"),
    ("geometry", "finetune"): or_none(section_of(*OPTIMISATION)),
    **{("geometry", "finetune", key): rule for key, rule in OPTIMISATION.items()},
    **{("pretrain", "*", key): rule for key, rule in OPTIMISATION.items()},
    **each(("conditions", "masks", "yaw"), SHARE),
    **each(("conditions", "masks", "lateral"), SHIFT),
    ("trainings", "geo-evs", ..., "?"): like,
    ("trainings", "freevs", ..., "?"): like,
    **each(("protocol", "lateral"), SHIFT),
    **each(("protocol", "pose_sweep", "angles"), ANGLE, 0),
    **each(("protocol", "masked", "yaw"), ANGLE),
    **each(("protocol", "masked", "lateral"), SHIFT),
    ("protocol", "every", "*"): whole(1, 10**6),
    **{("protocol", part, "every"): whole(1, 10**6) for part in ("pose_sweep", "masked")},
    **each(("protocol", "reference_keep"), number(ABOVE_0, 1)),
    ("budget", "fit_seconds"): or_none(number(ABOVE_0, 10**9)),
    ("budget", "limits", "*"): or_none(number(ABOVE_0, 10**15)),
    ("methods", "*", "options", "*", "?"): like,
    ("methods", "*", "options", "?"): finite,
    ("methods", "*", "training", "?"): training,
    ("methods", "*", "seeds", "?"): list_of(whole(0, 2**31 - 1), 1),
    ("methods", "*", "?"): lambda value, old, key: (
        key.split(".")[0] in METHODS and or_none(section_of("options", "training", "seeds"))(value)
    ),
    ("stability", "datasets"): list_of(lambda value: text(value) and value in DEFAULTS["datasets"]),
    ("stability", "datasets", "*"): lambda value: text(value) and value in DEFAULTS["datasets"],
    ("stability", "seeds"): whole(1, 1000),
    **each(("stability", "lateral"), SHIFT),
    ("stability", "levels", "*", "*"): number(0, 10**6),
    ("stability", "levels", "*"): named(STRESSORS, list_of(number(0, 10**6))),
    ("stability", "methods", "*"): named(
        DEFAULTS["methods"].keys() - {"reference", "truth"},
        lambda value: value is None or (isinstance(value, dict) and finite(value)),
    ),
    ("stability", "methods", "*", "*", ..., "?"): like,
    **each(("detection", "views", "shares"), number(0.001, 0.999)),
    **each(("detection", "views", "lateral"), SHIFT),
    **each(("detection", "offsets"), lambda value: SHIFT(value) and value != 0, 0),
    ("detection", "seeds"): whole(1, 100),
    ("detection", "longer"): number(1, 100),
    **{("detection", part, ..., "?"): like for part in ("classes", "detector", "training")},
    ("detection", "methods", "*"): named(
        DEFAULTS["methods"].keys() - {"reference"},
        lambda value: value is None or (isinstance(value, dict) and finite(value)),
    ),
    ("detection", "methods", "*", "*", ..., "?"): like,
    ("tables", "ablation"): lambda value: text(value) and value in METHODS,
    **each(("tables", "pose_bins"), number(-(10**6), 10**6), 2),
    **each(("tables", "support_bins"), number(-(10**6), 10**6), 2),
    ("tables", "resamples"): whole(100, 10**6),
    ("tables", "confidence"): number(ABOVE_0, 1 - 1e-16),
}  # fmt: skip
"""What may stand in a config, by its place; written down by hand, and not by its schema."""


def is_sound(text: str | bytes, before: str) -> bool:
    """Whether an overlay, as a plain reader reads it, makes a config that can be.

    Args:
        text: the overlay.
        before: what it was made from, which is sound.
    """
    try:
        merged = []
        for overlay in (before, text):
            config = copy.deepcopy(DEFAULTS)
            if overlay:
                update_config(config, yaml.safe_load(overlay))
            merged.append(config)
        return sound_json(*merged, RULES)
    except Exception:  # the plain reader raises anything
        return False


def try_config(text: str | bytes, before: str = "") -> str:
    """What is said of the default config under an overlay; nothing if it is accepted."""
    begun = time.process_time()  # however busy the machine is
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
    assert time.process_time() - begun < 10
    sound = is_sound(text, before)
    count("configs", sound, bool(said))
    assert sound or said, "what is broken was used"
    return said


def use(config: Any) -> None:
    """What the rules do with an accepted config."""
    entries = method_entries(config) + stability_entries(config) + detection_entries(config)
    for entry in entries:
        assert "/" not in entry.label
        if entry.training:
            json.dumps(training_settings(config, entry.training), allow_nan=False)
    partitions = ("test", "train", "clips", "geometry", "pretrain", "detection", "detection-test")
    for partition in partitions:
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
    before = text
    for place, cut, piece in edits:
        at = int(place * len(text))
        text = text[:at] + piece + text[at + cut :]
    try_config(text, before)


@few
@given(st.binary(max_size=200) | st.text(max_size=200))
def test_any_bytes(data):
    try_config(data)
