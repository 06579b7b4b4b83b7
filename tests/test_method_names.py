"""The suite knows methods by what a config and a run's files say of them, so it names none."""

import ast
import re
from pathlib import Path

import pytest

from geoevs.methods.finding import find_methods
from geoevs.protocol.entries import FLOOR

ROOT = Path(__file__).parents[1]
CODE = [
    path
    for path in sorted((ROOT / "geoevs").rglob("*.*"))
    if ROOT / "geoevs/generator" not in path.parents
]
FOLDERS = ("workflow", "workflow/rules", "workflow/schemas")
WORKFLOW = [
    ROOT / "Snakefile",
    *(path for folder in FOLDERS for path in sorted((ROOT / folder).glob("*.*"))),
]


def texts(path: Path) -> list[str]:
    """What a file does, not what is said of it: Python's strings, else lines without comments."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        comment = r"(^|\s)//.*" if path.suffix == ".js" else r"(^|\s)#.*"
        return [re.sub(comment, "", line) for line in text.splitlines()]
    tree = ast.parse(text)
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    strings = [node.value for node in constants if id(node) not in said]
    return [value for value in strings if isinstance(value, str) and value != FLOOR]


def naming(paths: list[Path]) -> dict[str, set[str]]:
    """The files that name methods, and which: as the config does, or by the name of a folder."""
    methods = set(find_methods())
    words = {
        str(path.relative_to(ROOT)): set(re.findall("[a-z0-9_-]+", " ".join(texts(path))))
        for path in paths
    }
    named = {path: {word.replace("_", "-") for word in some} for path, some in words.items()}
    return {path: some & methods for path, some in named.items() if some & methods}


@pytest.mark.parametrize("suffix", [".py", ".js", ".jinja"])
def test_no_method_is_named_but_the_floor(suffix):
    files = [path for path in CODE if path.suffix == suffix]
    assert files
    assert naming(files) == {}


def test_the_workflow_names_no_method():
    assert {path.suffix for path in WORKFLOW} == {"", ".smk", ".yaml"}
    assert naming(WORKFLOW) == {}


def test_the_floor_is_named_once():
    pattern = re.compile(rf"[\"'`]{FLOOR}[\"'`]")
    files = [
        path.name for path in CODE if path.suffix == ".py" and pattern.search(path.read_text())
    ]
    assert files == ["entries.py"]
