"""Reading a run's config files as YAML nodes: their syntax, their size, and what YAML misreads.

Snakemake reads the same files by itself, and says of a mistake neither the file nor the line. So
they are read here first: by the profile before Snakemake's own files (`check_command_line`), and by
the Snakefile.
"""

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import yaml

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.files import check_file
from geoevs.core.text import clean

MOST_BYTES = 300_000
"""Of a config file: 4,000 names of Waymo's segments, which are read in half a second. Bombs of that
size take 2 s, and Snakemake reads the file twice again."""

DEEPEST = 30
"""Sections and lists within one another; the default config has five."""

MOST_VALUES = 50_000
"""Of a config file, where an alias counts as all that it stands for. They cost more time than
bytes, so no more is read."""

KIND = "tag:yaml.org,2002:"
"""Before the name of what YAML takes a value for, such as `int`."""

MERGE = f"{KIND}merge"
"""What YAML takes the key `<<` for."""

DECIMAL = re.compile(r"[-+]?(0|[1-9][0-9_]*)")
"""Whole numbers that everybody reads alike; YAML 1.1 has others."""


def check_command_line(arguments: Sequence[str] | None = None) -> None:
    """End the process with one sentence if a file behind `--configfile` cannot be read.

    Args:
        arguments: of the process; None takes those of this one.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--configfile", "--configfiles", nargs="+", default=[])
    parser.add_argument("--config", "-C", nargs="*")
    try:
        files = parser.parse_known_args(arguments)[0].configfile
    except argparse.ArgumentError:
        return  # Snakemake says so itself
    try:
        for file in files:
            read_nodes(file)
    except GeoEvsError as mistake:
        sys.exit(str(mistake))


def read_nodes(path: str | Path) -> yaml.MappingNode:
    """The sections of a config file, after checking that nothing in it is misread.

    Raises:
        GeoEvsError: there is no such file; it is no UTF-8, no YAML, too large, too deep, empty or a
            list; a key stands twice or is no text; an anchor stands within itself; a tag; a value
            that YAML 1.1 takes for another than it looks like, such as `010`. The sentence names
            the line.
    """
    path = Path(path)
    text = _read_text(path)
    try:
        _check_events(path, yaml.parse(text))
        root = yaml.compose(text)
    except yaml.MarkedYAMLError as mistake:
        raise _not_yaml(path, text, mistake) from None
    except yaml.reader.ReaderError as mistake:
        line = text.count("\n", 0, mistake.position) + 1
        raise GeoEvsError(
            f"{path}:{line}: the character U+{mistake.character:04X} cannot stand in YAML; remove "
            "it, or save the file as plain text"
        ) from None
    except (ValueError, OverflowError) as error:  # such as an escape beyond Unicode
        raise GeoEvsError(f"{path} is not YAML ({clean(str(error))}); mend it") from None
    if root is None:
        raise GeoEvsError(f"{path} holds no settings; write some as NAME: VALUE, or leave it out")
    if not isinstance(root, yaml.MappingNode):
        raise GeoEvsError(
            f"{path}:{_line(root)}: a config holds settings as NAME: VALUE, and this is "
            f"{'a list' if isinstance(root, yaml.SequenceNode) else 'a single value'}; write it "
            "under a name"
        )
    _Checker(path).measure(root)
    return root


def _read_text(path: Path) -> str:
    """The text of a regular file of a sane size; JSON, which may have tabs, without them."""
    if not path.exists():
        near = sorted(file.name for file in path.parent.glob("*.yaml"))[:20]
        hint = did_you_mean(path.name, near) if near else "there is no config in its folder"
        raise GeoEvsError(f"there is no config file {path}; {hint}; targets stand behind `--`")
    check_file(path)
    try:
        if path.stat().st_size > MOST_BYTES:
            raise GeoEvsError(
                f"{path} has {path.stat().st_size:,} bytes; a config has {MOST_BYTES:,} at most, "
                "so name scenes as ranges, such as curve-1..40"
            )
        text = path.read_bytes().decode()
    except OSError as error:
        raise GeoEvsError(f"{path} cannot be read ({error.strerror}); make it readable") from None
    except UnicodeDecodeError:
        raise GeoEvsError(f"{path} is not UTF-8 text; save it as UTF-8") from None
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return text
    return text.replace("\t", " ")


def _not_yaml(path: Path, text: str, mistake: yaml.MarkedYAMLError) -> GeoEvsError:
    mark = mistake.problem_mark or mistake.context_mark
    line = mark.line + 1 if mark else 1
    found = text.split("\n")[line - 1 : line]
    advice = "check brackets, quotes and indentation above it"
    if any("\t" in part for part in found):
        advice = "indent with spaces in place of tabs"
    problem = clean(mistake.problem or mistake.context or "unreadable", 100)
    return GeoEvsError(f"{path}:{line}: this is not YAML ({problem}); {advice}")


def _check_events(path: Path, events: Iterator[yaml.Event]) -> None:
    """Look for depth, tags and values as YAML is read, so that what is too much is not read on."""
    depth = values = 0
    for event in events:
        values += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        where = f"{path}:{event.start_mark.line + 1}"
        if depth > DEEPEST:
            raise GeoEvsError(
                f"{where}: sections and lists lie {depth} deep here; {DEEPEST} are allowed, so "
                "close some before"
            )
        if values > MOST_VALUES:
            raise GeoEvsError(
                f"{where}: a config has {MOST_VALUES:,} values at most, and here are more; name "
                "scenes as ranges, such as curve-1..40"
            )
        if getattr(event, "tag", None) is not None:
            raise GeoEvsError(
                f"{where}: tags such as '{clean(event.tag, 40)}' are not allowed; write the value "
                "without, text in quotes"
            )


def _line(node: yaml.Node) -> int:
    return node.start_mark.line + 1


class _Checker:
    """Visits every node of a file once, however many aliases stand for it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._measured: dict[yaml.Node, tuple[int, int]] = {}
        self._open: set[yaml.Node] = set()

    def _refuse(self, node: yaml.Node, sentence: str) -> GeoEvsError:
        return GeoEvsError(f"{self._path}:{_line(node)}: {sentence}")

    def measure(self, node: yaml.Node) -> tuple[int, int]:
        """How many values a node stands for, and how deep they lie; all are checked."""
        if node in self._measured:
            return self._measured[node]
        if node in self._open:
            raise self._refuse(node, "this anchor stands within itself; write out what is meant")
        self._open.add(node)
        sizes = [self.measure(child) for child in self._children(node)]
        values = 1 + sum(size for size, _ in sizes)
        depth = 1 + max((depth for _, depth in sizes), default=0)
        if values > MOST_VALUES or depth > 2 * DEEPEST:
            raise self._refuse(
                node,
                f"aliases make this {values:,} values, {depth} deep; {MOST_VALUES:,} and "
                f"{2 * DEEPEST} are allowed, so use fewer",
            )
        self._open.remove(node)
        self._measured[node] = values, depth
        return values, depth

    def _children(self, node: yaml.Node) -> list[yaml.Node]:
        if isinstance(node, yaml.ScalarNode):
            if sentence := misread(node):
                raise self._refuse(node, sentence)
            return []
        if isinstance(node, yaml.SequenceNode):
            return list(node.value)
        lines: dict[str, int] = {}
        for name, value in node.value:
            self._check_key(name, value, lines)
            lines[name.value] = _line(name)
        return [value for _, value in node.value]

    def _check_key(self, name: yaml.Node, value: yaml.Node, lines: dict[str, int]) -> None:
        if not isinstance(name, yaml.ScalarNode):
            raise self._refuse(name, "a list or section cannot be a key; write text before the ':'")
        shown = clean(name.value, 60)
        if name.tag not in (f"{KIND}str", MERGE):
            raise self._refuse(
                name, f"YAML does not read the key '{shown}' as text; write it in quotes"
            )
        if name.value in lines:
            raise self._refuse(
                name, f"'{shown}' stands in line {lines[name.value]} already; remove one"
            )
        if name.value == "__use_yte__":
            raise self._refuse(name, "a config holds values, no code; remove '__use_yte__'")
        if name.tag == MERGE:
            merged = value.value if isinstance(value, yaml.SequenceNode) else [value]
            if not all(isinstance(each, yaml.MappingNode) for each in merged):
                raise self._refuse(name, "'<<' takes a section, or a list of some; name one by *")


def misread(node: yaml.ScalarNode) -> str:
    """What to write in place of a value that YAML 1.1 takes for another than it looks like.

    Nothing for one that everybody reads alike, or that stands in quotes.
    """
    if node.style is not None or not node.tag.startswith(KIND):
        return ""
    text, kind = clean(node.value, 60), node.tag.removeprefix(KIND)
    if kind in ("str", "null") or (kind == "int" and DECIMAL.fullmatch(node.value)):
        return _too_long(node) if kind == "int" else ""
    if kind == "bool" and node.value.lower() in ("true", "false"):
        return ""
    if kind == "float" and ":" not in node.value:
        return ""
    if kind not in READERS:
        what = "a date" if kind == "timestamp" else "a sign of its own"
        return f"YAML takes {text} for {what}; write '{text}' in quotes"
    try:
        meant = READERS[kind](yaml.constructor.SafeConstructor(), node)
    except (ValueError, KeyError, IndexError):
        return f"YAML cannot read {text}; write '{text}' in quotes"
    plain = yaml.safe_dump(meant).split("\n")[0]
    return f"YAML reads {text} as {plain}; write {plain}, or '{text}' in quotes if text is meant"


READERS: dict[str, Callable[[yaml.constructor.SafeConstructor, yaml.ScalarNode], object]] = {
    "bool": yaml.constructor.SafeConstructor.construct_yaml_bool,
    "int": yaml.constructor.SafeConstructor.construct_yaml_int,
    "float": yaml.constructor.SafeConstructor.construct_yaml_float,
}
"""How YAML reads those kinds."""

MOST_DIGITS = 100
"""Of a whole number; Python itself gives up at some thousand."""


def _too_long(node: yaml.ScalarNode) -> str:
    digits = len(node.value)
    too_long = f"this number has {digits} digits; {MOST_DIGITS} are read, so write a smaller one"
    return too_long if digits > MOST_DIGITS else ""
