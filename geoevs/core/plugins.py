"""Finding data sources and methods by name, with no list to edit.

Those of the project are folders. Those of packages elsewhere are entry points of the installed
packages, whose value is the package that holds the file.
"""

import importlib
import keyword
import os
import re
import select
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

import yaml

from geoevs.core.errors import GeoEvsError, did_you_mean, reason_of
from geoevs.core.text import clean

ENTRY_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
"""What an entry point may be called: as a folder of the project may, with hyphens."""

IMPORT_SECONDS = 60.0
"""How long importing one plugin may take; none of the suite's takes one second."""


def find_plugins(file: str, group: str, *packages: str, optional: bool = False) -> dict[str, str]:
    """Map plugin name to module for every folder and entry point that holds `file`.py.

    A folder's plugin has its name, with hyphens for underscores; an entry point's has that of the
    entry point. No plugin is imported.

    Args:
        file: without its ending, such as `adapter`.
        group: of entry points, such as `geoevs.methods`.
        packages: whose folders are plugins.
        optional: whether an entry point may lack the file.

    Raises:
        GeoEvsError: two plugins have the same name, of which one would never be found; or an entry
            point has no name that a config can have, or none of these files.
    """
    modules: dict[str, str] = {}
    for package in packages:
        for root in importlib.import_module(package).__path__:
            for path in sorted(Path(root).glob(f"*/{file}.py")):
                folder = path.parent.name
                name = folder.replace("_", "-")
                if name in modules:
                    first = modules[name].rpartition(".")[0].replace(".", "/")
                    raise GeoEvsError(
                        f"{path.parent} has the name '{name}', as {first} has; rename one folder"
                    )
                modules[name] = f"{package}.{folder}.{file}"
    for name, package, owner in _installed(group, tuple(sys.path)):
        who = f"entry point '{clean(name, 60)}' of {group} in the package {clean(owner, 60)}"
        if not ENTRY_NAME.fullmatch(name):
            raise GeoEvsError(f"{who} has no lower-case letters and digits with hyphens; rename it")
        if name in modules:
            first = modules[name].rpartition(".")[0].replace(".", "/")
            raise GeoEvsError(
                f"{who} has the name of {first}; rename the entry point, or uninstall the package"
            )
        if module_path(f"{package}.{file}") is not None:
            modules[name] = f"{package}.{file}"
        elif not optional:
            raise GeoEvsError(
                f"{who} names {clean(package, 60)}, which has no {file}.py; name the package that "
                "holds it, or uninstall"
            )
    return modules


def new_module(name: str, what: str) -> str:
    """The name of the folder of a plugin that is to be called `name`.

    Args:
        name: with hyphens or underscores, such as `my-method`.
        what: it is to be called, such as `method`, for errors.

    Raises:
        GeoEvsError: it is no name that a folder, a module and a config can all have.
    """
    module = name.replace("-", "_")
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+|_[a-z0-9]+)*", name):
        raise GeoEvsError(
            f"'{name}' cannot name a {what}; use lower-case letters, digits and single hyphens, "
            f"such as my-{what.split()[0]}"
        )
    if keyword.iskeyword(module) or keyword.issoftkeyword(module):
        raise GeoEvsError(f"'{name}' is a word of Python's own; choose another name")
    if yaml.safe_load(name) != name:
        raise GeoEvsError(f"'{name}' is no text in YAML's eyes; choose another name")
    return module


def check_imports(modules: Iterable[str]) -> None:
    """Import plugins in a copy of this process, to see whether one of them would end this one.

    What they raise is not looked at, nor those that are here already.

    Raises:
        GeoEvsError: one ended the copy, or took more than IMPORT_SECONDS; the sentence names its
            file.
    """
    new = [module for module in dict.fromkeys(modules) if module not in sys.modules]
    if not new:
        return
    done, done_to = os.pipe()
    copy = os.fork()
    if copy == 0:
        try:
            _import_all(new, done_to)
        finally:
            os._exit(0)
    os.close(done_to)
    try:
        for module in new:
            in_time = select.select([done], [], [], IMPORT_SECONDS)[0]
            if in_time and os.read(done, 1):
                continue
            how = "ends" if in_time else f"occupies for more than {IMPORT_SECONDS:g} s"
            raise GeoEvsError(
                f"{module.replace('.', '/')}.py {how} the process that imports it; let it do "
                "nothing when it is imported"
            )
    finally:
        os.close(done)
        os.kill(copy, signal.SIGKILL)
        os.waitpid(copy, 0)


def _import_all(modules: Iterable[str], done: int) -> None:
    """Import modules without input or output; a byte goes to `done` after each."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nothing, stream)
    for module in modules:
        with suppress(BaseException):
            importlib.import_module(module)
        os.write(done, b".")


@cache
def _installed(group: str, path: tuple[str, ...]) -> list[tuple[str, str, str]]:
    """Name, value and distribution of a group's entry points; read once for each `sys.path`."""
    found = entry_points(group=group)
    return sorted(
        (point.name, point.value, point.dist.name if point.dist else "") for point in found
    )


def packages_of(*groups: str) -> list[str]:
    """Names of the installed packages that have entry points of these groups."""
    path = tuple(sys.path)
    return sorted({owner for group in groups for *_, owner in _installed(group, path) if owner})


def module_path(module: str) -> Path | None:
    """The file of a module, found without importing any package around it; None if none."""
    top, *parts = module.split(".")
    spec = find_spec(top)  # of a name without dots, this imports nothing
    for part in parts:
        if spec is None or spec.submodule_search_locations is None:
            return None
        spec = PathFinder.find_spec(f"{spec.name}.{part}", list(spec.submodule_search_locations))
    place = spec.origin if spec else None
    return Path(place) if place and place.endswith(".py") else None


@contextmanager
def one_sentence(path: str) -> Iterator[None]:
    """Turn whatever reading a plugin's file raises into one sentence that names the file.

    Raises:
        GeoEvsError: its code raised something, or ended the process.
    """
    try:
        yield
    except GeoEvsError:
        raise
    except (Exception, SystemExit) as error:
        raise GeoEvsError(f"{path} cannot be read ({reason_of(error)}); mend it") from error


def load_plugin(kind: str, name: str, plugins: dict[str, str], attribute: str) -> type:
    """Import the plugin called `name`, and take its class, which is called `attribute`.

    Raises:
        GeoEvsError: there is none of that name (the sentence names the nearest one), or it lacks
            the class.
    """
    if name not in plugins:
        raise GeoEvsError(f"there is no {kind} called '{name}'; {did_you_mean(name, plugins)}")
    module = importlib.import_module(plugins[name])
    if not hasattr(module, attribute):
        raise GeoEvsError(f"{module.__file__} has no class {attribute}; name its class so")
    return getattr(module, attribute)
