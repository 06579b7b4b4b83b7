"""Ways to spoil files, for tests that want one sentence of whatever reads them.

What a change makes is `sound` or not by what a plain reader finds in the file: another value of the
same kind is, and may be used; NaN, another type, what is out of range, cut, missing or doubled is
not, and must be refused.
"""

import contextlib
import json
import math
import re
import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError

EXAMPLES = settings.get_profile(settings.get_current_profile_name()).max_examples
SHARE = settings(
    max_examples=max(EXAMPLES // 3, 1),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)

COUNTS: defaultdict[str, Counter[str]] = defaultdict(Counter)
"""Of each kind of input, how many were sound or broken, and used or refused."""

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


def refused(use: Callable[[], object]) -> bool:
    """Whether `use` ends in one line of a GeoEvsError; anything else that it raises is a fault."""
    sentence = ""
    try:
        use()
    except GeoEvsError as error:
        sentence = str(error)
    assert "\n" not in sentence
    assert len(sentence) < 1500
    return bool(sentence)


def judged(kind: str, sound: bool, use: Callable[[], object], argued: bool = False) -> bool:
    """Whether `use` refuses an input; one that is not sound must be, unless docs/trust.md says why.

    Args:
        kind: of the input, as the table of counts names it.
        sound: whether the input may be used.
        use: what reads it.
        argued: whether an input that is not sound may be used all the same.
    """
    no = refused(use)
    count(kind, sound, no)
    assert sound or no or argued, "what is broken was used"
    return no


def count(kind: str, sound: bool, no: bool) -> None:
    """Count one input."""
    COUNTS[kind][f"{'sound' if sound else 'broken'}, {'refused' if no else 'used'}"] += 1


def number(low: float = -math.inf, high: float = math.inf) -> Callable[[Any], bool]:
    """Whether a value is a finite number in a range, and no truth value."""

    def holds(value: Any, old: Any = None) -> bool:
        if type(value) not in (int, float) or value != value:
            return False
        return low <= value <= high and abs(value) < 1e308

    return holds


def whole(low: int = 0, high: int = 2**63 - 1) -> Callable[[Any], bool]:
    """Whether a value is a whole number in a range."""
    return lambda value, old=None: type(value) is int and low <= value <= high


def near(far: float) -> "Rule":
    """Whether a number differs by so much at most from the one that stood there."""
    return lambda value, old: number()(value) and abs(value - old) <= far


def text(value: Any) -> bool:
    """Whether a value is text, without halves of letters."""
    return isinstance(value, str) and value == value.encode("utf-8", "replace").decode()


def name(value: Any) -> bool:
    """Whether a value is a part of a path."""
    return text(value) and re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.+~=-]{0,99}", value) is not None


MISSING = object()
"""Stands for what was removed."""

Rule = Callable[..., bool]
Rules = Mapping[tuple, Rule]
"""What may stand at a place: keys, of which "*" is any one and a last ... is all below. A rule is
given the value; what stood there, where it takes two; and its key, where it takes three. One whose
place ends with "?" holds for what is missing too. Elsewhere, nothing but what stood there may."""


def anything(value: Any) -> bool:
    """Whatever stands there, nobody reads it."""
    return True


def places(value: Any, place: tuple = ()) -> Iterator[tuple]:
    """Every place in a JSON value, as the keys that lead there."""
    yield place
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(item, (*place, key))


def differences(old: Any, new: Any, place: tuple = ()) -> Iterator[tuple[tuple, Any, Any]]:
    """The places at which two JSON values differ, and what both have there."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            yield from differences(old.get(key, MISSING), new.get(key, MISSING), (*place, key))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for key, (one, other) in enumerate(zip(old, new, strict=True)):
            yield from differences(one, other, (*place, key))
    elif type(old) is not type(new) or old != new:
        yield place, old, new


def sound_json(old: Any, new: Any, rules: Rules) -> bool:
    """Whether all that differs may stand where it does."""
    return all(_may_stand(*difference, rules) for difference in differences(old, new))


def _may_stand(place: tuple, old: Any, value: Any, rules: Rules) -> bool:
    for pattern, rule in rules.items():
        optional = bool(pattern) and pattern[-1] == "?"
        keys = pattern[:-1] if optional else pattern
        rest = bool(keys) and keys[-1] is ...
        keys = keys[:-1] if rest else keys
        fits = len(keys) <= len(place) if rest else len(keys) == len(place)
        if fits and all(key in ("*", part) for key, part in zip(keys, place, strict=False)):
            if value is MISSING:
                return optional
            given = (value, old, place[-1] if place else None)
            return bool(rule(*given[: rule.__code__.co_argcount]))
    return False


class Doubled(dict):
    """A JSON object that has one of its keys twice."""

    def items(self) -> Any:
        """All pairs, the first of them again at the end."""
        pairs = list(super().items())
        return [*pairs, *pairs[:1]]


def edit_json(path: Path, data: st.DataObject, rules: Rules) -> bool:
    """Replace, remove or repeat something in a JSON file; whether it is still sound."""
    old = json.loads(path.read_text(encoding="utf-8"))
    root = {"root": json.loads(path.read_text(encoding="utf-8"))}
    place = data.draw(st.sampled_from(list(places(root))[1:]), "place")
    *above, key = place
    parent: Any = root
    for step in above:
        parent = parent[step]
    change = data.draw(st.sampled_from(["replace", "replace", "replace", "remove", "repeat"]))
    doubled = False
    if change == "replace" or (len(place) == 1 and change == "remove"):
        parent[key] = data.draw(VALUES, "value")
    elif change == "remove":
        del parent[key]
    elif isinstance(parent, list):
        parent.insert(key, parent[key])
    elif isinstance(parent[key], dict) and parent[key]:
        parent[key], doubled = Doubled(parent[key]), True
    path.write_text(json.dumps(root["root"]), encoding="utf-8")
    return not doubled and sound_json(old, root["root"], rules)


def edit_json_bytes(path: Path, data: st.DataObject, rules: Rules) -> bool:
    """Cut a JSON file off, or change one byte of it; whether it is still sound."""
    old = json.loads(path.read_text(encoding="utf-8"))
    edit_bytes(path, data)
    try:
        new = json.loads(path.read_bytes().decode(), object_pairs_hook=_pairs)
    except (ValueError, RecursionError):
        return False
    return sound_json(old, new, rules)


def _pairs(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        raise ValueError
    return dict(pairs)


def edit_bytes(path: Path, data: st.DataObject) -> bool:
    """Cut a file off, or change one byte of it; whether it is still the same."""
    old = path.read_bytes()
    raw = bytearray(old)
    place = data.draw(st.integers(0, len(raw) - 1), "byte")
    raw[place] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans(), "cut"):
        del raw[place:]
    path.write_bytes(raw)
    return bytes(raw) == old


def edit_png(path: Path, data: st.DataObject) -> bool:
    """Cut a PNG off, or change one byte of it; whether all before its end mark is left."""
    before = path.read_bytes()[:-12]
    edit_bytes(path, data)
    return path.read_bytes().startswith(before)


def edit_array(array: np.ndarray, data: st.DataObject) -> np.ndarray:
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


def edit_column(values: np.ndarray, data: st.DataObject) -> np.ndarray:
    """Cells of a table's column, of which one or all are something else."""
    value = data.draw(st.sampled_from([None, math.nan, math.inf, "x", "False", -1, 0, 1e300, True]))
    cells = values.astype(object)
    cells[: 1 if data.draw(st.booleans(), "one") else len(cells)] = value
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        return cells.astype(values.dtype if isinstance(value, float) else type(value))
    return cells


def read_plainly(path: Path) -> pd.DataFrame:
    """The cells of a Parquet file as they stand; its notes for pandas are not looked at."""
    return pd.DataFrame(pq.read_table(path).to_pydict(), dtype=object)


def sound_columns(table: pd.DataFrame, rules: Mapping[str, Rule]) -> bool:
    """Whether a table has all columns, and in all of their cells what may stand there."""
    return all(
        column in table and all(rule(plain(cell)) for cell in table[column])
        for column, rule in rules.items()
    )


def plain(cell: Any) -> Any:
    """A cell as Python's own value."""
    return cell.item() if isinstance(cell, np.generic) else cell
