"""Finding data sources and methods by the name of their folder, with no list to edit."""

import importlib
from pathlib import Path

from geoevs.core.errors import GeoEvsError, did_you_mean


def find_plugins(file: str, *packages: str) -> dict[str, str]:
    """Map plugin name to module for every folder of `packages` that holds `file`.py.

    A plugin's name is its folder's, with hyphens for underscores. No plugin is imported.
    Where two packages hold the same name, the earlier one wins.
    """
    modules: dict[str, str] = {}
    for package in packages:
        for root in importlib.import_module(package).__path__:
            for path in sorted(Path(root).glob(f"*/{file}.py")):
                folder = path.parent.name
                modules.setdefault(folder.replace("_", "-"), f"{package}.{folder}.{file}")
    return modules


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
