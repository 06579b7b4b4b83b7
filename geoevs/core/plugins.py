"""Finding data sources and methods by the name of their folder, with no list to edit."""

import importlib
import os
import select
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from geoevs.core.errors import GeoEvsError, did_you_mean, reason_of

IMPORT_SECONDS = 60.0
"""How long importing one plugin may take; none of the suite's takes one second."""


def find_plugins(file: str, *packages: str) -> dict[str, str]:
    """Map plugin name to module for every folder of `packages` that holds `file`.py.

    A plugin's name is its folder's, with hyphens for underscores. No plugin is imported.

    Raises:
        GeoEvsError: two folders have the same name, of which one would never be found.
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
    return modules


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
