"""Values of a merged config: what no key may hold, and a schema's complaints in words."""

import unicodedata
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from jsonschema import ValidationError

from geoevs.config.places import Key
from geoevs.core.errors import did_you_mean
from geoevs.core.settings import LARGEST, SettingError, is_sane, plain_advice, shown
from geoevs.core.text import clean

LONGEST_TEXT = 1000
"""Characters of a text in the config; paths are shorter."""

PLAIN_TYPES = {"integer": int, "number": float, "string": str, "boolean": bool}
"""A schema's types whose values are no sections and no lists."""

OTHER_TYPES = {
    "array": "a list, such as [1, 2]",
    "object": "NAME: VALUE, indented under it, or {} for nothing",
    "null": "null",
}
"""What values of the others look like in YAML."""


def check_values(config: Mapping[str, Any]) -> None:
    """Check that numbers are finite and texts are one line, wherever they stand.

    A schema's bounds let NaN through, as every comparison with it is false.

    Raises:
        SettingError: one is not.
    """
    for key, value in _leaves(config, ()):
        dotted = clean(".".join(map(str, key)), 100)
        if isinstance(value, (int, float)) and not is_sane(value):
            raise SettingError(
                key,
                f"'{dotted}' is wrong: {shown(value)} is not a number that can be used; write a "
                f"finite one of {LARGEST:g} at most",
            )
        if not isinstance(value, str):
            continue
        if len(value) > LONGEST_TEXT:
            raise SettingError(
                key,
                f"'{dotted}' is wrong: its text has {len(value):,} characters; write "
                f"{LONGEST_TEXT:,} at most",
            )
        # C: control, format and surrogate characters, and those without a meaning.
        kinds = {unicodedata.category(letter) for letter in value}
        if kinds & {"Zl", "Zp"} or any(kind[0] == "C" for kind in kinds):
            raise SettingError(
                key,
                f"'{dotted}' is wrong: its text is not one line of letters; remove line breaks and "
                "what cannot be seen",
            )


def _leaves(value: Any, key: Key) -> Iterator[tuple[Key, Any]]:
    """Every value that is no section or list with its key, and every key as a text of its own."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield (*key, name), str(name)
            yield from _leaves(part, (*key, name))
    elif isinstance(value, (list, tuple)):
        for number, part in enumerate(value):
            yield from _leaves(part, (*key, number))
    else:
        yield key, value


def explain(mistake: ValidationError) -> tuple[Key, str]:
    """The key at fault in a schema's complaint, and a sentence on what is wrong with it."""
    key: Key = tuple(mistake.absolute_path)
    if mistake.validator == "additionalProperties":
        allowed = mistake.schema.get("properties", {})
        unknown = str(next(name for name in mistake.instance if name not in allowed))
        said = f"'{clean(unknown, 60)}' is not a known key; {did_you_mean(unknown, allowed)}"
        return (*key, unknown), said
    if mistake.validator == "required":
        missing = next(name for name in mistake.validator_value if name not in mistake.instance)
        where = f"under '{_dotted(key)}'" if key else "at the top level"
        return key, f"the key '{missing}' is missing {where}; add it"
    if "propertyNames" in mistake.absolute_schema_path:
        key = (*key, mistake.instance)
        return key, f"'{clean(mistake.instance, 60)}' is not an allowed name; {_rule(mistake)}"
    if mistake.validator == "pattern":
        return key, f"'{clean(mistake.instance, 60)}' is not an allowed name; {_rule(mistake)}"
    purpose = mistake.schema.get("description", "").removesuffix(".")
    meaning = f" (it means: {purpose})" if purpose else ""
    return key, f"'{_dotted(key)}' is wrong: {_complaint(mistake)}{meaning}"


def _rule(mistake: ValidationError) -> str:
    if mistake.validator == "maxLength":
        return f"use {mistake.validator_value} characters at most"
    return "use lower case and hyphens"


def _dotted(key: Key) -> str:
    return clean(".".join(map(str, key)), 100)


def _complaint(mistake: ValidationError) -> str:
    """What is wrong with a value, and what to write."""

    def advised(kind: str) -> str:
        plain = PLAIN_TYPES.get(kind)
        return plain_advice(mistake.instance, plain) if plain else OTHER_TYPES[kind]

    validator, wanted = str(mistake.validator), mistake.validator_value
    value = shown(mistake.instance)
    if validator == "type":
        kinds = [wanted] if isinstance(wanted, str) else wanted
        return f"{value} is of another type; write {' or '.join(map(advised, kinds))}"
    if validator == "enum":
        return f"there is no {value}; {did_you_mean(str(mistake.instance), map(str, wanted))}"
    advice = ADVICE.get(validator)
    return f"{value} {advice(wanted)}" if advice else clean(mistake.message)


ADVICE: dict[str, Callable[[Any], str]] = {
    "minimum": lambda bound: f"is too small; make it {bound:,} or more",
    "exclusiveMinimum": lambda bound: f"is too small; make it more than {bound:,}",
    "maximum": lambda bound: f"is too large; make it {bound:,} or less",
    "exclusiveMaximum": lambda bound: f"is too large; make it less than {bound:,}",
    "minItems": lambda count: f"is too short; write {count} or more",
    "maxItems": lambda count: f"is too long; write {count} at most",
    "minLength": lambda count: "is empty; write something",
    "maxLength": lambda count: f"is too long; use {count} characters at most",
    "uniqueItems": lambda _: "has something twice; remove the repeats",
    "maxProperties": lambda count: f"is too long; write {count:,} names at most",
}
"""The rest of the sentence for what a schema's keyword forbids, by the keyword's value."""
