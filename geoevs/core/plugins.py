"""Finding data sources and methods by the name of their folder, with no list to edit."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from geoevs.core.errors import GeoEvsError, did_you_mean, reason_of


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
