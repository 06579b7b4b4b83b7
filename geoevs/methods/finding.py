"""Methods by the names of their folders."""

from geoevs.core.plugins import find_plugins, load_plugin
from geoevs.core.settings import check_options
from geoevs.methods.contract import Adapter


def find_methods() -> dict[str, str]:
    """Every method's name and module."""
    return find_plugins("adapter", "geoevs.generator", "baselines", "baselines.controls")


def method_class(name: str) -> type[Adapter]:
    """The class of the method called `name`.

    Raises:
        GeoEvsError: there is none; the sentence names the nearest one.
    """
    return load_plugin("method", name, find_methods(), "Method")


def make_method(name: str, options: dict) -> Adapter:
    """Make the method called `name` with its options.

    Raises:
        GeoEvsError: no such method, or an option that it does not have.
    """
    method = method_class(name)
    check_options(f"method '{name}'", method, options)
    return method(**options)
