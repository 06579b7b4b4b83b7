"""The judge knows methods by what a run's files say of them, so its code names none."""

import ast
import re
from pathlib import Path

import pytest

from geoevs.methods.finding import find_methods
from geoevs.protocol.entries import FLOOR

CORE = Path(__file__).parents[1] / "geoevs"
PACKAGES = ("core", "scenes", "projection", "methods", "geometry", "conditions", "diffusion")
JUDGE = ("protocol", "results")
FILES = [path for name in (*PACKAGES, *JUDGE) for path in sorted((CORE / name).rglob("*.*"))]


def texts(path: Path) -> set[str]:
    """What code, not what is said of it, has between quotes."""
    if path.suffix != ".py":
        return set(re.findall(r"[\"'`]([a-z0-9-]+)[\"'`]", path.read_text()))
    tree = ast.parse(path.read_bytes())
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return {node.value for node in constants if id(node) not in said and node.value != FLOOR}


@pytest.mark.parametrize("suffix", [".py", ".js", ".jinja"])
def test_no_method_is_named_but_the_floor(suffix):
    methods = set(find_methods())
    named = {path.name: texts(path) & methods for path in FILES if path.suffix == suffix}
    assert named
    assert {name: found for name, found in named.items() if found} == {}


def test_the_floor_is_named_once():
    pattern = re.compile(rf"[\"'`]{FLOOR}[\"'`]")
    naming = [
        path.name for path in FILES if path.suffix == ".py" and pattern.search(path.read_text())
    ]
    assert naming == ["entries.py"]
