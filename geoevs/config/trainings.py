"""A config's trainings: one section a method that trains, and variants of it."""

from collections.abc import Container, Mapping, Sequence
from typing import Any

from geoevs.config.places import Origin, locate, located
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.settings import make_settings
from geoevs.methods.contract import DEFAULT
from geoevs.methods.finding import find_trainings, training_class


def training_of(method: str, text: str, trainers: Container[str] | None = None) -> str:
    """The training that `training: TEXT` under a method means, as METHOD/VARIANT.

    `VARIANT` alone is the method's own. Without any text it is the method's own section as it
    stands, and nothing for a method that is none of `trainers`, those that train (None: look).

    >>> training_of("geo-evs-support", "geo-evs/v3")
    'geo-evs/v3'
    """
    if not text:
        trainers = find_trainings() if trainers is None else trainers
        return f"{method}/{DEFAULT}" if method in trainers else ""
    return text if "/" in text else f"{method}/{text}"


def variants(config: Mapping[str, Any], trainer: str) -> list[str]:
    """The names of a method's trainings, that of its section's own settings first."""
    return [DEFAULT, *config["trainings"].get(trainer, {}).get("variants", {})]


def training_settings(config: Mapping[str, Any], training: str) -> dict[str, Any]:
    """The config's values for one training, METHOD/VARIANT: its section, and the variant over it.

    What neither says has the default of the method's Settings.
    """
    trainer, _, variant = training.partition("/")
    section = dict(config["trainings"].get(trainer, {}))
    changes = section.pop("variants", {}).get(variant, {})
    return _merged(section, changes)


def check_trainings(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    """Check every section and variant by the Settings of its method.

    Raises:
        GeoEvsError: a section is of no method that trains, its `training.py` breaks the contract,
            or a setting is wrong.
    """
    for trainer, section in config["trainings"].items():
        with located(("trainings", trainer), origins):
            kind = training_class(trainer).Settings
        who = f"the training of '{trainer}'"
        if DEFAULT in section.get("variants", {}):
            where = locate(("trainings", trainer, "variants", DEFAULT), origins)
            raise GeoEvsError(
                f"{where}: '{DEFAULT}' is the training by the section itself; rename the variant"
            )
        with located(("trainings", trainer), origins):
            make_settings(who, kind, training_settings(config, f"{trainer}/{DEFAULT}"))
        for variant, changes in section.get("variants", {}).items():
            with located(("trainings", trainer, "variants", variant), origins):
                make_settings(who, kind, changes)
            with located(("trainings", trainer, "variants", variant), origins):
                make_settings(who, kind, training_settings(config, f"{trainer}/{variant}"))


def check_named(config: Mapping[str, Any], training: str) -> None:
    """Check that there is a training METHOD/VARIANT.

    Raises:
        GeoEvsError: its method does not train, or has no such variant.
    """
    trainer, _, variant = training.partition("/")
    training_class(trainer)
    named = variants(config, trainer)
    if variant not in named:
        raise GeoEvsError(
            f"there is no training '{variant}' under 'trainings.{trainer}.variants'; "
            f"{did_you_mean(variant, named)}"
        )


def _merged(section: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A section with changes over it, those of sections within it one by one."""
    made = dict(section)
    for name, value in changes.items():
        both = isinstance(value, Mapping) and isinstance(made.get(name), Mapping)
        made[name] = _merged(made[name], value) if both else value
    return made
