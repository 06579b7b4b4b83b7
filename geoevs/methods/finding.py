"""Methods and their trainings by the names of their folders."""

import importlib
from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.core.plugins import find_plugins, load_plugin, one_sentence
from geoevs.core.settings import check_options
from geoevs.methods.contract import ORACLES, Adapter
from geoevs.methods.training import Training, check_training_class

FOLDERS = ("geoevs.generator", "baselines", "baselines.controls")
"""Packages whose folders are methods."""

METHOD_GROUP = "geoevs.methods"
"""Entry points by which installed packages offer methods."""


def methods_root() -> Path:
    """The folder that holds `baselines`, where new methods are written."""
    return Path(importlib.import_module("baselines").__path__[0]).parent


def find_methods() -> dict[str, str]:
    """Every method's name and module, those of installed packages among them."""
    return find_plugins("adapter", METHOD_GROUP, *FOLDERS)


def find_trainings() -> dict[str, str]:
    """The name of every method that trains beforehand, and the module of its training."""
    methods = find_methods()
    trainings = find_plugins("training", METHOD_GROUP, *FOLDERS, optional=True)
    return {name: module for name, module in trainings.items() if name in methods}


def check_free_name(name: str) -> None:
    """Check that a method may be called so.

    Raises:
        GeoEvsError: it is the name of a control, which would run in the method's place.
    """
    if name in ORACLES:
        raise GeoEvsError(
            f"'{name}' is the control that copies the answer, so no method can be called so; "
            "choose another name"
        )


def method_class(name: str) -> type[Adapter]:
    """The class of the method called `name`.

    Raises:
        GeoEvsError: there is none; the sentence names the nearest one.
    """
    check_free_name(name)
    return load_plugin("method", name, find_methods(), "Method")


def training_class(name: str) -> type[Training]:
    """The class of the training of the method called `name`.

    Raises:
        GeoEvsError: there is none (the sentence names the nearest one), or it lacks parts of the
            contract.
    """
    trainings = find_trainings()
    path = trainings.get(name, "").replace(".", "/") + ".py"
    with one_sentence(path):
        kind = load_plugin("method that trains", name, trainings, "Training")
        check_training_class(kind, path)
    return kind


def make_method(name: str, options: dict[str, Any]) -> Adapter:
    """Make the method called `name` with its options.

    Raises:
        GeoEvsError: no such method, or an option that it does not have or take.
    """
    method = method_class(name)
    check_options(f"method '{name}'", method, options)
    return method(**options)
