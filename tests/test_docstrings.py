"""Public functions, classes and methods say more than their names."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]


def public(node: ast.AST, name: str) -> Iterator[tuple[str, ast.AST]]:
    """What a module or class defines for others, methods under their class's name."""
    for child in ast.iter_child_nodes(node):
        is_class = isinstance(child, ast.ClassDef)
        if (is_class or isinstance(child, ast.FunctionDef)) and not child.name.startswith("_"):
            yield f"{name}.{child.name}", child
            if is_class:
                yield from public(child, f"{name}.{child.name}")


def test_all_that_is_public_has_a_docstring_of_five_words_or_more():
    paths = [path for folder in ("geoevs", "baselines") for path in (ROOT / folder).rglob("*.py")]
    files = {str(path.relative_to(ROOT)): path for path in paths}
    short = [
        name
        for file, path in sorted(files.items())
        for name, node in public(ast.parse(path.read_bytes()), file)
        if len((ast.get_docstring(node) or "").split()) < 5
    ]
    assert not short
