"""The files that a run's config comes from: their syntax, and where in them a mistake stands."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import yaml
from jsonschema import ValidationError

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.settings import SettingError

Key = tuple[str | int, ...]

TEXT_KEYS = ("tag:yaml.org,2002:str", "tag:yaml.org,2002:merge")
"""What YAML takes keys for: text, or `<<`."""


def check_syntax(path: str | Path) -> None:
    """Check that a config file, where there is one, is YAML; Snakemake would not say what is not.

    Raises:
        GeoEvsError: it is not; the sentence names the line.
    """
    path = Path(path)
    if not path.exists():
        return
    try:
        yaml.compose(path.read_text(encoding="utf-8"))
    except yaml.MarkedYAMLError as mistake:
        line = mistake.problem_mark.line + 1
        raise GeoEvsError(
            f"{path}:{line}: this is not YAML ({mistake.problem}); check brackets, quotes and "
            "indentation above it"
        ) from None
    except (ValueError, yaml.YAMLError) as error:  # of its characters
        reason = " ".join(str(error).split())
        raise GeoEvsError(f"{path} is not plain UTF-8 text ({reason}); save it as such") from None


def check_repeats(path: str | Path) -> None:
    """Check that no key of a config file stands twice; YAML would take the last without a word.

    Raises:
        GeoEvsError: one does (the sentence names both lines), or is no text, such as `on`.
    """
    nodes = [yaml.compose(Path(path).read_text(encoding="utf-8"))]
    while nodes:
        node = nodes.pop()
        if isinstance(node, yaml.SequenceNode):
            nodes.extend(node.value)
        elif isinstance(node, yaml.MappingNode):
            lines: dict[str, int] = {}
            for name, value in node.value:
                line = name.start_mark.line + 1
                if name.tag not in TEXT_KEYS:
                    raise GeoEvsError(
                        f"{path}:{line}: YAML does not read the key '{name.value}' as text; write "
                        "it in quotes"
                    )
                if name.value in lines:
                    raise GeoEvsError(
                        f"{path}:{line}: '{name.value}' stands in line {lines[name.value]} already;"
                        " remove one"
                    )
                lines[name.value] = line
                nodes.append(value)


def explain(mistake: ValidationError) -> tuple[Key, str]:
    """The key at fault in a schema's complaint, and a sentence on what is wrong with it."""
    key: Key = tuple(mistake.absolute_path)
    if mistake.validator == "additionalProperties":
        allowed = mistake.schema.get("properties", {})
        unknown = str(next(name for name in mistake.instance if name not in allowed))
        return (*key, unknown), f"'{unknown}' is not a known key; {did_you_mean(unknown, allowed)}"
    if mistake.validator == "required":
        missing = next(name for name in mistake.validator_value if name not in mistake.instance)
        where = f"under '{_dotted(key)}'" if key else "at the top level"
        return key, f"the key '{missing}' is missing {where}; add it"
    if mistake.validator == "pattern":
        if "propertyNames" in mistake.absolute_schema_path:
            key = (*key, mistake.instance)
        return key, f"'{mistake.instance}' is not an allowed name; use lower case and hyphens"
    purpose = mistake.schema.get("description", "").removesuffix(".")
    meaning = f" (it means: {purpose})" if purpose else ""
    return key, f"'{_dotted(key)}' is wrong: {mistake.message}{meaning}"


def _dotted(key: Key) -> str:
    return ".".join(map(str, key))


def locate(key: Key, files: Sequence[Path]) -> str:
    """`FILE:LINE` of a key in the last file that sets it, else that file's name alone."""
    for path in reversed(files):
        node = yaml.compose(Path(path).read_text(encoding="utf-8"))
        line = None
        for part in key:
            if isinstance(node, yaml.MappingNode):
                pairs = {name.value: (name, value) for name, value in node.value}
                if str(part) not in pairs:
                    break
                name, node = pairs[str(part)]
                line = name.start_mark.line + 1
            elif isinstance(node, yaml.SequenceNode) and part < len(node.value):
                node = node.value[part]
            else:
                break
        else:
            if line is not None:
                return f"{path}:{line}"
    return str(files[0]) if files else "config"


@contextmanager
def located(key: Key, files: Sequence[Path]) -> Iterator[None]:
    """Put the place of `key` before the sentence of a mistake found in the block.

    A mistake in a setting stands below that key (see SettingError).
    """
    try:
        yield
    except GeoEvsError as mistake:
        inner = mistake.key if isinstance(mistake, SettingError) else ()
        raise GeoEvsError(f"{_nearest((*key, *inner), files)}: {mistake}") from mistake


def _nearest(key: Key, files: Sequence[Path]) -> str:
    """The place of a key, or of the section that it is missing from."""
    for length in range(len(key), 0, -1):
        place = locate(key[:length], files)
        if ":" in place:
            return place
    return locate(key, files)
