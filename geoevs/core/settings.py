"""Options and settings, checked by their annotations before anything runs.

A method's options are its constructor's arguments, a training's settings a dataclass. Both say what
they take where they are declared, and nowhere else:

    samples: Annotated[int, Within(1, 400)] = 25
    sampler: Annotated[str, OneOf(SAMPLERS)] | None = None
"""

import contextlib
import dataclasses
import inspect
import types
import typing
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.text import clean

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from typing_extensions import TypeIs

Settings = TypeVar("Settings", bound="DataclassInstance")


class SettingError(GeoEvsError):
    """A mistake in one value; `key` says where, below what was checked."""

    def __init__(self, key: tuple[str | int, ...], sentence: str) -> None:
        super().__init__(sentence)
        self.key = key


@dataclass(frozen=True)
class AtLeast:
    """A number that is `low` or more."""

    low: float

    def mistake(self, value: float) -> str:
        """The advice for a number that is too small; empty for one that is allowed."""
        return "" if value >= self.low else f"make it {self.low:g} or more"


@dataclass(frozen=True)
class Above:
    """A number that is more than `low`."""

    low: float

    def mistake(self, value: float) -> str:
        """The advice for a number that is too small; empty for one that is allowed."""
        return "" if value > self.low else f"make it more than {self.low:g}"


@dataclass(frozen=True)
class AtMost:
    """A number that is `high` or less."""

    high: float

    def mistake(self, value: float) -> str:
        """The advice for a number that is too large; empty for one that is allowed."""
        return "" if value <= self.high else f"make it {self.high:,} or less"


@dataclass(frozen=True)
class Within:
    """A number from `low` to `high`, both included."""

    low: float
    high: float

    def mistake(self, value: float) -> str:
        """The advice for a number outside the range; empty for one that is allowed."""
        inside = self.low <= value <= self.high
        return "" if inside else f"choose from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class OneOf:
    """A text that is one of `words`."""

    words: Collection[str]

    def __post_init__(self) -> None:
        # Annotations are compared and hashed, which a dictionary's keys are not.
        object.__setattr__(self, "words", tuple(self.words))

    def mistake(self, value: str) -> str:
        """The nearest of the words, as advice; empty for one that is among them."""
        return "" if value in self.words else did_you_mean(str(value), map(str, self.words))


Count = Annotated[int, AtLeast(1), AtMost(10**9)]
"""A number of things, at least one; more than a billion is a slip of the keyboard."""

Share = Annotated[float, Within(0, 1)]
"""A part of a whole."""

Positive = Annotated[float, Above(0)]
"""A number above zero, such as a learning rate."""

LARGEST = 1e15
"""Of any number in a config: all whole numbers up to it are exact in floats as well."""

PLAIN = {
    bool: "true or false",
    int: "a whole number, such as 8",
    float: "a number, such as 0.5 or 1.0e-3",
    str: "text, in quotes if it looks like something else",
    Path: "a path, in quotes if it looks like something else",
}
"""What a value of each plain type looks like in YAML."""


def is_sane(value: float) -> bool:
    """Whether a number is finite and at most LARGEST; a whole one may have any number of digits."""
    return -LARGEST <= value <= LARGEST


def shown(value: Any) -> str:
    """A value as a config has it, short enough for a sentence.

    >>> shown(None), shown(True), shown("three"), shown([1, 2])
    ('null', 'true', "'three'", '[1, 2]')
    """
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, int) and not is_sane(value):
        return "a whole number of many digits"
    return clean(f"'{value}'" if isinstance(value, str) else repr(value), 60)


def check_options(
    who: str,
    factory: Callable[..., Any],
    options: Mapping[str, Any],
    positional: int = 0,
    elsewhere: Collection[str] = (),
) -> None:
    """Check that `options` are what `factory` takes, besides its first `positional` arguments.

    Args:
        who: has them, such as `method 'emernerf'`, for errors.
        factory: a class or function; an annotation in quotes whose names are unknown when it
            runs is taken at its word.
        options: by name.
        positional: how many of its arguments are no options.
        elsewhere: options that are set by something else, and so are neither offered nor missed.

    Raises:
        SettingError: an option that it does not take (the sentence names the nearest one), one of
            another type or value, or one that it needs is missing.
    """
    taken = [option for option in _parameters(factory)[positional:] if option.name not in elsewhere]
    _check_names(who, [option.name for option in taken], options)
    for option in taken:
        if option.name in options:
            _check_value(who, (option.name,), options[option.name], option.annotation)
        elif option.default is option.empty:
            raise SettingError((), f"{who} needs the option '{option.name}'; set it in its options")


def _parameters(factory: Callable[..., Any]) -> list[inspect.Parameter]:
    """What a class or function takes, annotations in quotes read where their names are known."""
    try:
        signature = inspect.signature(factory, eval_str=True)
    except Exception:  # names for type checkers alone, or whatever else stands in quotes
        signature = inspect.signature(factory)
    return list(signature.parameters.values())


def make_settings(who: str, kind: type[Settings], values: Mapping[str, Any]) -> Settings:
    """A dataclass of settings from a section of the config; what that leaves out has its default.

    Args:
        who: has them, for errors.
        kind: a dataclass whose fields all have a type and a default; fields may be such dataclasses
            themselves.
        values: by name, sections within it as mappings.

    Raises:
        SettingError: a name that is no field, or a value of another type or beyond its bounds.
        GeoEvsError: the dataclass itself refuses the values together.
    """
    _check_section(who, (), values, kind)
    return _filled(kind(), values)


def check_fields(who: str, settings: Any) -> None:
    """Check what a dataclass was made with, for its `__post_init__`.

    Raises:
        SettingError: a field's value is of another type or beyond its bounds.
    """
    for field in filter(lambda field: field.init, dataclasses.fields(settings)):
        _check_value(who, (field.name,), getattr(settings, field.name), field.type)


def check_settings_class(kind: type[Any], where: str) -> None:
    """Check that a class can be a section of the config.

    Args:
        kind: the class.
        where: it stands, for errors.

    Raises:
        GeoEvsError: it is no dataclass, or a field has no type that can be checked or no default.
    """
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        raise GeoEvsError(f"{where} has no dataclass Settings; write one, its fields the settings")
    names = {field.name for field in dataclasses.fields(kind)}
    for name, value in vars(kind).items():
        plain = not name.startswith("_") and not callable(value) and not hasattr(value, "__get__")
        if plain and name not in names and name not in kind.__annotations__:
            raise GeoEvsError(f"{where}: the setting '{name}' has no type; write one, such as int")
    for field in dataclasses.fields(kind):
        if field.default is field.default_factory is dataclasses.MISSING:
            raise GeoEvsError(f"{where}: the setting '{field.name}' has no default; give it one")
        if not _can_be_checked(field.type):
            raise GeoEvsError(
                f"{where}: the setting '{field.name}' has no type that can be checked; write one "
                "such as int, without quotes"
            )
        if section := _section_class(field.type):
            check_settings_class(section, f"{where}: the section '{field.name}'")
    check_fields(f"{where}: the default", kind())


def _can_be_checked(annotation: Any) -> bool:
    """Whether `_mistake` can tell a wrong value of an annotation from a right one."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        return _can_be_checked(parts[0])
    if origin in (typing.Union, types.UnionType):
        return all(part is type(None) or _can_be_checked(part) for part in parts)
    kind = origin or annotation
    container = isinstance(kind, type) and issubclass(kind, Collection)
    return origin is Literal or kind in PLAIN or container or _is_section(kind)


def _section_class(annotation: Any) -> "type[DataclassInstance] | None":
    """The dataclass that a mapping is a section of, if the annotation has one."""
    union = typing.get_origin(annotation) in (typing.Union, types.UnionType)
    kinds = typing.get_args(annotation) if union else (annotation,)
    return next((kind for kind in kinds if _is_section(kind)), None)


def _check_section(
    who: str, key: tuple[str, ...], values: Mapping[str, Any], kind: "type[DataclassInstance]"
) -> None:
    types_of = {field.name: field.type for field in dataclasses.fields(kind) if field.init}
    _check_names(who, list(types_of), values, key)
    for name, value in values.items():
        _check_value(who, (*key, name), value, types_of[name])


def _check_names(
    who: str, names: Sequence[str], values: Mapping[str, Any], key: tuple[str, ...] = ()
) -> None:
    for name in values:
        if name not in names:
            hint = did_you_mean(str(name), names) if names else "it has none"
            raise SettingError(
                (*key, name), f"{who} has no option '{clean(str(name), 60)}'; {hint}"
            )


def _check_value(who: str, key: tuple[str, ...], value: Any, annotation: Any) -> None:
    section = _section_class(annotation)
    if section and isinstance(value, Mapping):
        _check_section(who, key, value, section)
        return
    if mistake := _mistake(value, annotation):
        raise SettingError(
            key, f"{who} cannot have {shown(value)} for its option '{'.'.join(key)}'; {mistake}"
        )


def _mistake(value: Any, annotation: Any) -> str:
    """What to write in place of a value that is none of a type's; nothing for one that is."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        bounds = [bound for bound in parts[1:] if hasattr(bound, "mistake")]
        reasons = (bound.mistake(value) for bound in bounds if value is not None)
        return _mistake(value, parts[0]) or next(filter(None, reasons), "")
    if origin is Literal:
        return "" if value in parts else did_you_mean(str(value), map(str, parts))
    if origin in (typing.Union, types.UnionType):
        each = [_mistake(value, part) for part in parts if part is not type(None)]
        nothing = "" if value is None and type(None) in parts else "no"
        return "" if not nothing or "" in each else " or ".join(dict.fromkeys(each))
    if annotation in PLAIN:
        return "" if _is_plain(value, annotation) else f"write {plain_advice(value, annotation)}"
    if _is_section(annotation):
        return (
            ""
            if isinstance(value, annotation)
            else "write its settings as NAME: VALUE, indented under it"
        )
    kind = origin or annotation
    if isinstance(kind, type) and issubclass(kind, Mapping):
        return _mapping_mistake(value, parts or (Any, Any))
    if isinstance(kind, type) and issubclass(kind, Collection):
        return _list_mistake(value, kind, parts or (Any, ...))
    return ""


def _is_section(annotation: Any) -> "TypeIs[type[DataclassInstance]]":
    return isinstance(annotation, type) and dataclasses.is_dataclass(annotation)


def _is_plain(value: Any, kind: type) -> bool:
    if kind is Path:
        return isinstance(value, (str, Path))
    if kind in (int, float):
        number = isinstance(value, (int, kind)) and not isinstance(value, bool)
        return number and is_sane(value)
    return isinstance(value, kind)


def plain_advice(value: Any, kind: type) -> str:
    """What to write for a value of a plain type, in place of one that is not.

    >>> plain_advice("1e-3", float)
    "0.001 (YAML takes '1e-3' for text)"
    """
    if kind in (int, float) and isinstance(value, (int, float)) and not is_sane(value):
        return f"a finite number of {LARGEST:g} at most"
    if kind in (int, float) and isinstance(value, str):
        with contextlib.suppress(ValueError, OverflowError):
            number = float(value)
            if is_sane(number) and (kind is float or number == int(number)):
                plain = yaml_number(number) if kind is float else str(int(number))
                return f"{plain} (YAML takes {shown(value)} for text)"
    return PLAIN[kind]


def yaml_number(value: float) -> str:
    """A number as YAML 1.1 reads it: with a dot, and a sign in the exponent.

    >>> yaml_number(1e-7), yaml_number(0.001), yaml_number(1e20)
    ('1.0e-07', '0.001', '1.0e+20')
    """
    text = repr(value)
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa}.0{e}{exponent}" if e and "." not in mantissa else text


def _list_mistake(value: Any, origin: type, parts: tuple[Any, ...]) -> str:
    if isinstance(value, (str, Mapping)) or not isinstance(value, Collection):
        return "write a list, such as [1, 2]"
    fixed = origin is tuple and parts[-1:] != (...,)
    if fixed and len(value) != len(parts):
        return f"write a list of {len(parts)}"
    kinds = parts if fixed else parts[:1] * len(value)
    reasons = (_mistake(item, kind) for item, kind in zip(value, kinds, strict=True))
    reason = next(filter(None, reasons), "")
    return f"of each in the list: {reason}" if reason else ""


def _mapping_mistake(value: Any, parts: tuple[Any, ...]) -> str:
    if not isinstance(value, Mapping):
        return "write it as NAME: VALUE, indented under it"
    wrong_key = next(filter(None, (_mistake(key, parts[0]) for key in value)), "")
    if wrong_key:
        return f"of each name: {wrong_key}"
    return next(filter(None, (_mistake(item, parts[1]) for item in value.values())), "")


def _filled(settings: Settings, values: Mapping[str, Any]) -> Settings:
    """Settings with some values in place of their own, sections within them likewise."""
    types_of = {field.name: field.type for field in dataclasses.fields(settings)}
    changes = {}
    for name, value in values.items():
        section, now = _section_class(types_of[name]), getattr(settings, name)
        if section and isinstance(value, Mapping):
            changes[name] = _filled(section() if now is None else now, value)
        else:
            changes[name] = value
    return dataclasses.replace(settings, **changes)
