"""A content hash of modules and all they import, so that a rule reruns when its code changes."""

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import geoevs
from geoevs.core.plugins import module_path

ROOT = Path(geoevs.__file__).parents[1]
PACKAGES = ("geoevs", "baselines")
DATA = (".yaml", ".jinja", ".css", ".js")
PATHS = "geoevs.layout"
"""The module of all paths, which does not count. A file that is made or read elsewhere than before
is made again by Snakemake itself, and a new path concerns no rule that is there."""


def code_hash(*modules: str) -> str:
    """Hash the code of `modules` and of the project's modules that they import, however deep.

    Of a package outside the project, what it imports from itself counts too. The data files beside
    a module (see DATA) count with it. Comments, formatting and PATHS do not; modules found by name
    at run time (plugins) must be named.

    Args:
        modules: such as `geoevs.core.files`; `MODULE:Class.method` counts the whole module, but
            what its functions import by themselves only for this one.
    """
    reached: set[str] = set()
    waiting: list[str] = []
    for name in modules:
        module, _, function = name.partition(":")
        if function:
            reached.add(module)
            waiting.extend(_imports(module, function))
        else:
            waiting.append(module)
    while waiting:
        module = waiting.pop()
        if module not in reached:
            reached.add(module)
            waiting.extend(_imports(module))
    digest = hashlib.sha256()
    for module in sorted(reached):
        digest.update(_code(module))
    folders = {_path(module).parent for module in reached}
    for data in sorted(path for folder in folders for path in folder.iterdir()):
        if data.suffix not in DATA:
            continue
        digest.update(f"{data.name}\n".encode() + data.read_bytes())
    return digest.hexdigest()[:16]


def _path(module: str) -> Path | None:
    if module.split(".")[0] not in PACKAGES:
        return module_path(module)
    base = ROOT / module.replace(".", "/")
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


def _nodes(tree: ast.AST, place: str, function: str) -> Iterator[ast.AST]:
    """All nodes, but for the bodies of functions other than `function`, if there is one."""
    for node in ast.iter_child_nodes(tree):
        named = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
        name = f"{place}.{node.name}".removeprefix(".") if named else place
        other = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and name != function
        if not (function and other):
            yield node
            yield from _nodes(node, name, function)


@cache
def _tree(module: str) -> ast.Module:
    """A module's code; of one that is not Python, as a method being written may be, its text."""
    source = _path(module).read_bytes()
    try:
        return ast.parse(source)
    except (SyntaxError, ValueError):  # its own job says so, and the others go on
        return ast.parse(repr(source))


@cache
def _code(module: str) -> bytes:
    return f"{module}\n{ast.dump(_tree(module))}\n".encode()


@cache
def _imports(module: str, function: str = "") -> tuple[str, ...]:
    """The project's modules that a module imports, in functions only in this one if it is named."""
    names: set[str] = set()
    for node in _nodes(_tree(module), "", function):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(filter(None, (_package(module, node.level), node.module)))
            names.add(base)
            names.update(f"{base}.{alias.name}" for alias in node.names)
    followed = {*PACKAGES, module.split(".")[0]}
    return tuple(
        name for name in names if name.split(".")[0] in followed and name != PATHS and _path(name)
    )


def _package(module: str, level: int) -> str:
    """What a relative import of some dots begins at; nothing for an absolute one."""
    if not level:
        return ""
    parts = module.split(".")
    up = level - (_path(module).name == "__init__.py")
    return ".".join(parts[: len(parts) - up])
