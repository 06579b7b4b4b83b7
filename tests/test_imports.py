"""Imports go one way: no module imports one of a later layer, not even within a function."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("geoevs", "baselines")
LAYERS = (
    *("core", "layout", "scenes", "projection", "source_check", "methods", "geometry"),
    *("conditions", "diffusion"),
    *("generator baselines", "protocol run", "detection", "config", "results", "cli"),
)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names.split()}


def part_of(module: str) -> str:
    """`baselines`, or what lies right below `geoevs`."""
    return module.removeprefix("geoevs.").split(".")[0]


def imports(path: Path) -> Iterator[str]:
    """The project's modules, or names in them, that a file imports anywhere."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        yield from (name for name in names if name.split(".")[0] in PACKAGES)


def test_no_module_imports_a_later_layer():
    modules = {}
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        names = path.relative_to(ROOT).with_suffix("").parts
        modules[".".join(names).removesuffix(".__init__")] = path
    assert {part_of(module) for module in modules} - {"geoevs"} == set(LEVEL)
    wrong = [
        f"{module} imports {name}"
        for module, path in modules.items()
        for name in imports(path)
        if part_of(name) == "baselines" != part_of(module)
        or LEVEL.get(part_of(name), 0) > LEVEL.get(part_of(module), 0)  # 0: of the root itself
    ]
    assert not wrong
