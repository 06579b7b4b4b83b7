"""Options and settings are checked by their annotations: types, bounds, words, sections."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.settings import (
    Above,
    AtLeast,
    Count,
    OneOf,
    Positive,
    SettingError,
    Share,
    Within,
    check_fields,
    check_options,
    check_settings_class,
    make_settings,
)


@dataclass(frozen=True)
class Inner:
    steps: Count = 2
    scale: Annotated[float, AtLeast(0)] = 1.0


@dataclass(frozen=True)
class Outer:
    kind: Annotated[str, OneOf(("red", "green"))] = "red"
    share: Share = 0.5
    rate: Positive = 1.0e-3
    flag: bool = True
    inner: Inner = Inner(steps=5)
    sizes: tuple[Count, Count] = (1, 2)
    angles: list[float] = field(default_factory=lambda: [1.0])
    names: dict[str, int] = field(default_factory=dict)
    cap: Annotated[int, Within(1, 9)] | None = None
    where: Path | None = None
    mode: Literal["fast", "fine"] = "fast"
    anything: Any = None


GOOD = {
    "kind": ["red", "green"],
    "share": [0, 1, 0.25],
    "rate": [1, 1e-9],
    "flag": [True, False],
    "inner": [{}, {"steps": 1}],
    "sizes": [[3, 4], (3, 4)],
    "angles": [[], [1, 2.5]],
    "names": [{}, {"a": 1}],
    "cap": [None, 1, 9],
    "where": [None, "~/there", Path("x")],
    "mode": ["fine"],
    "anything": [object(), None, 3],
}
BAD = {
    "kind": [
        ("blue", "one of: green, red"),
        ("gren", "did you mean 'green'?"),
        (None, "write text"),
    ],
    "share": [
        (1.5, "choose from 0 to 1"),
        (-0.1, "choose from 0 to 1"),
        (math.nan, "write a finite number"),
    ],
    "rate": [
        (10**400, "a finite number of 1e+15"),
        (0, "make it more than 0"),
        ("1e-3", "write 0.001 ("),
        (math.inf, "a finite"),
    ],
    "flag": [(1, "write true or false"), ("yes", "write true or false")],
    "inner": [(3, "write its settings as NAME: VALUE")],
    "sizes": [
        ([1], "write a list of 2"),
        ([0, 1], "of each in the list: make it 1"),
        ("12", "a list"),
    ],
    "angles": [(1.0, "write a list"), ([1, "2"], "of each in the list: write 2.0 (")],
    "names": [([], "NAME: VALUE"), ({"a": 0.5}, "write a whole number")],
    "cap": [
        (0, "choose from 1 to 9"),
        (10, "from 1 to 9"),
        (2.5, "whole"),
        (True, "whole"),
        ("4", ""),
    ],
    "where": [(5, "write a path")],
    "mode": [("fest", "did you mean 'fast'?")],
}


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, vs in GOOD.items() for v in vs])
def test_what_a_type_allows_is_taken(name, value):
    make_settings("it", Outer, {name: value})


@pytest.mark.parametrize(
    ("name", "value", "advice"), [(n, *b) for n, bs in BAD.items() for b in bs]
)
def test_what_a_type_does_not_allow_is_one_sentence(name, value, advice):
    with pytest.raises(SettingError) as caught:
        make_settings("it", Outer, {name: value})
    sentence = str(caught.value)
    assert sentence.startswith("it cannot have ")
    assert f"for its option '{name}'; " in sentence
    assert advice in sentence
    assert "\n" not in sentence
    assert caught.value.key == (name,)


def test_sections_within_sections_keep_their_other_values():
    made = make_settings("it", Outer, {"inner": {"scale": 3.0}})
    assert made.inner == Inner(steps=5, scale=3.0)
    with pytest.raises(SettingError, match=r"'inner.steps'; make it 1 or more") as caught:
        make_settings("it", Outer, {"inner": {"steps": 0}})
    assert caught.value.key == ("inner", "steps")
    with pytest.raises(SettingError, match=r"no option 'stepps'; did you mean 'steps'\?") as caught:
        make_settings("it", Outer, {"inner": {"stepps": 1}})
    assert caught.value.key == ("inner", "stepps")


def test_options_are_those_of_a_constructor():
    class Method:
        def __init__(self, height: int, size: Annotated[int, Above(3)] = 4, *, folder: str) -> None:
            self.height, self.size, self.folder = height, size, folder

    check_options("it", Method, {"folder": "here"}, positional=1)
    with pytest.raises(SettingError, match=r"^it needs the option 'folder'"):
        check_options("it", Method, {}, positional=1)
    with pytest.raises(SettingError, match=r"^it has no option 'height'; one of: folder, size$"):
        check_options("it", Method, {"height": 3, "folder": "here"}, positional=1)
    with pytest.raises(SettingError, match=r"cannot have 3 for its option 'size'; make it more"):
        check_options("it", Method, {"size": 3, "folder": "here"}, positional=1)
    with pytest.raises(SettingError, match=r"^it has no option 'size'; it has none$"):
        check_options("it", lambda: None, {"size": 3})


def test_an_annotation_in_quotes_is_taken_at_its_word():
    def make(size: "NoSuchType" = 3) -> None: ...  # noqa: F821

    check_options("it", make, {"size": object()})


def test_what_was_made_by_hand_is_checked_too():
    @dataclass
    class Method:
        rays: Count = 3
        _model: "NoSuchType" = field(init=False)  # noqa: F821

        def __post_init__(self) -> None:
            check_fields("it", self)

    Method(4)
    with pytest.raises(SettingError, match=r"^it cannot have 0 for its option 'rays'; make it 1"):
        Method(0)


def test_an_annotation_in_quotes_is_read_where_its_names_are_known():
    def make(size: "Count" = 3) -> None: ...

    with pytest.raises(SettingError, match=r"^it cannot have 0 for its option 'size'; make it 1"):
        check_options("it", make, {"size": 0})


@dataclass
class Plain:
    some: list = field(default_factory=list)
    named: dict = field(default_factory=dict)
    maybe: Inner | None = None


def test_plain_containers_and_sections_that_may_be_missing():
    check_settings_class(Plain, "here")
    assert make_settings("it", Plain, {"maybe": {"steps": 7}}).maybe == Inner(steps=7)
    assert make_settings("it", Plain, {"maybe": None}).maybe is None
    for values in ({"some": 3}, {"named": [1]}, {"maybe": {"steps": 0}}, {"maybe": 3}):
        with pytest.raises(SettingError):
            make_settings("it", Plain, values)
    with pytest.raises(SettingError, match="of each name: write text"):
        make_settings("it", Outer, {"names": {3: 3}})


def test_a_section_of_the_config_has_types_and_defaults():
    @dataclass
    class NoDefault:
        steps: int

    @dataclass
    class Quoted:
        steps: "int" = 3

    @dataclass
    class Untyped:
        steps: Any = 3

    @dataclass
    class Bare:
        steps = 3

    @dataclass
    class Wrong:
        steps: Count = 0

    @dataclass
    class Odd:
        steps: complex = 1j

    @dataclass
    class Nested:
        inner: Quoted = field(default_factory=Quoted)

    for kind, sentence in (
        (Bare, r"^here: the setting 'steps' has no type; write one, such as int$"),
        (Wrong, r"^here: the default cannot have 0 for its option 'steps'; make it 1 or more$"),
        (Odd, r"^here: the setting 'steps' has no type that can be checked; "),
        (Nested, r"^here: the section 'inner': the setting 'steps' has no type that can be chec"),
        (NoDefault, r"^here: the setting 'steps' has no default; give it one$"),
        (Quoted, r"^here: the setting 'steps' has no type that can be checked; "),
        (Untyped, r"^here: the setting 'steps' has no type that can be checked; "),
        (dict, r"^here has no dataclass Settings; "),
    ):
        with pytest.raises(GeoEvsError, match=sentence):
            check_settings_class(kind, "here")
