"""Ways to spoil files, for tests that want one sentence of whatever reads them."""

import contextlib
import json
import math
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError

EXAMPLES = settings.get_profile(settings.get_current_profile_name()).max_examples
SHARE = settings(
    max_examples=max(EXAMPLES // 3, 1),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)

VALUES = st.sampled_from(
    [
        *(None, True, False, 0, -1, 1, 99, 2**70, 10**400, 0.5, -0.5, 1e300, -1e-300),
        *(math.nan, math.inf, -math.inf, 5e6, "", "x", "1", "../../x", "/etc/passwd", "a" * 300),
        *("two\nlines", "\0", "\ud800", "front", [], {}, [[]], [1, 2], {"a": 1}, [[[]]] * 5),
    ]
)


@contextlib.contextmanager
def changed(original: Path) -> Iterator[Path]:
    """A copy of a folder or file, in a folder of its own that is removed afterwards."""
    with tempfile.TemporaryDirectory() as root:
        path = Path(root) / "given" / original.name
        path.parent.mkdir()
        (shutil.copytree if original.is_dir() else shutil.copy)(original, path)
        yield path


def refused(use) -> bool:
    """Whether `use` ends in one line of a GeoEvsError; anything else that it raises is a fault."""
    sentence = ""
    try:
        use()
    except GeoEvsError as error:
        sentence = str(error)
    assert "\n" not in sentence
    assert len(sentence) < 1500
    return bool(sentence)


def places(value, place=()):
    """Every place in a JSON value, as the keys that lead there."""
    yield place
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(item, (*place, key))


def edit_json(path: Path, data) -> None:
    """Replace, remove or repeat something in a JSON file."""
    root = {"root": json.loads(path.read_text(encoding="utf-8"))}
    place = data.draw(st.sampled_from(list(places(root))[1:]), "place")
    *above, key = place
    parent = root
    for step in above:
        parent = parent[step]
    change = data.draw(st.sampled_from(["replace", "replace", "replace", "remove", "repeat"]))
    if change == "replace" or len(place) == 1:
        parent[key] = data.draw(VALUES, "value")
    elif change == "remove":
        del parent[key]
    elif isinstance(parent, list):
        parent.insert(key, parent[key])
    path.write_text(json.dumps(root["root"]), encoding="utf-8")


def edit_bytes(path: Path, data) -> None:
    """Cut a file off, or change one byte of it."""
    raw = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(raw) - 1), "byte")
    raw[place:] = raw[place + 1 :] and bytes([data.draw(st.integers(0, 255))]) + raw[place + 1 :]
    if data.draw(st.booleans(), "cut"):
        del raw[place:]
    path.write_bytes(raw)


def edit_array(array: np.ndarray, data) -> np.ndarray:
    """Another type, shape, length or range of an array; or one bad value in it."""
    change = data.draw(st.sampled_from(["value", "value", "type", "shape", "length", "none"]))
    if change == "value" and array.size:
        value = data.draw(st.sampled_from([math.nan, math.inf, -1, 1e300, 99, 255, 1e7, 0]))
        with np.errstate(all="ignore"):
            array = array.copy() if array.dtype.kind == "f" else array.astype(float)
            array.flat[data.draw(st.integers(0, array.size - 1), "cell")] = value
    if change == "type":
        kind = data.draw(st.sampled_from(["f8", "i8", "U5", "?", "c8", "M8[s]", "f2"]))
        with np.errstate(all="ignore"):
            array = array.astype("i8").astype(kind) if kind == "M8[s]" else array.astype(kind)
    if change == "shape":
        array = data.draw(st.sampled_from([array.ravel(), array[None], array[..., None]]))
    if change == "length":
        array = array[: data.draw(st.integers(0, 2))]
    return array if change != "none" else np.zeros(0)


def edit_column(values: np.ndarray, data) -> np.ndarray:
    """Cells of a table's column, of which one or all are something else."""
    value = data.draw(st.sampled_from([None, math.nan, math.inf, "x", "False", -1, 0, 1e300, True]))
    cells = values.astype(object)
    cells[: 1 if data.draw(st.booleans(), "one") else len(cells)] = value
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        return cells.astype(values.dtype if isinstance(value, float) else type(value))
    return cells
