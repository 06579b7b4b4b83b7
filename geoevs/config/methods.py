"""Checking a config's entrants: their methods, options and trainings."""

from collections.abc import Mapping, Sequence
from typing import Any

from geoevs.config.entrants import method_entries
from geoevs.config.partitions import partition_scenes
from geoevs.config.places import Origin, located
from geoevs.config.trainings import check_named, variants
from geoevs.core.errors import GeoEvsError, did_you_mean, reason_of
from geoevs.core.settings import SettingError, check_options
from geoevs.methods.contract import ORACLES
from geoevs.methods.finding import find_methods, find_trainings, method_class, training_class
from geoevs.protocol.entries import MethodEntry


def check_methods(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    """Check that every entrant exists and is told apart, and can be made with its options.

    Raises:
        GeoEvsError: it does not, or cannot.
    """
    found = find_methods()
    for name in ORACLES:
        if name in found:
            path = found[name].replace(".", "/") + ".py"
            raise GeoEvsError(
                f"{path}: '{name}' is the control that copies the answer, so this method would "
                "never run; rename its folder"
            )
    entries = method_entries(config)
    if not entries:
        with located(("methods",), origins):
            raise GeoEvsError("there is no method to run; give one of them {} in place of null")
    for name in config["methods"]:  # those that null leaves out too: a slip would leave out none
        method = name.partition(".")[0]
        with located(("methods", name), origins):
            if method not in (*ORACLES, *found):
                raise GeoEvsError(
                    f"there is no method '{method}'; {did_you_mean(method, (*ORACLES, *found))}"
                )
    labels: set[str] = set()
    checked: set[str] = set()
    for entry in entries:
        with located(("methods", entry.name), origins):
            if entry.label in labels:
                raise GeoEvsError(f"two entrants are called '{entry.label}'; rename one variant")
            labels.add(entry.label)
            if entry.name in checked:
                continue  # another seed
            checked.add(entry.name)
            if entry.method in ORACLES and entry.options:
                raise GeoEvsError(f"the control '{entry.method}' has no options; remove them")
            _check_training(config, entry)
            check_method_options(entry)


def check_method_options(entry: MethodEntry) -> None:
    """Check that a method can be made with an entry's options.

    Raises:
        GeoEvsError: it has no such option, an option has no such value, or the method refuses them.
    """
    if entry.training and "weights" in entry.options:
        raise SettingError(
            ("options", "weights"),
            f"the weights of '{entry.name}' are those of its training; remove the option 'weights'",
        )
    if entry.method in ORACLES:
        return
    trained = ("weights",) if entry.training else ()
    method = _imported(entry)
    if method is None:
        return
    try:
        check_options(f"method '{entry.name}'", method, entry.options, elsewhere=trained)
    except SettingError as mistake:
        raise SettingError(("options", *mistake.key), str(mistake)) from None
    try:
        method(**entry.options, **dict.fromkeys(trained, ""))
    except GeoEvsError:
        raise
    except (Exception, SystemExit):  # a mistake of the method's own, which its rows will tell
        return


def _check_training(config: Mapping[str, Any], entry: MethodEntry) -> None:
    """Methods that are trained name a training, others none; it needs scenes."""
    trained = entry.method not in ORACLES and "training" in _needs(entry)
    if trained and not entry.training:
        raise GeoEvsError(
            f"method '{entry.name}' is trained before it is fitted; name one under 'training' "
            f"({', '.join(_all_trainings(config))})"
        )
    if entry.training and not trained:
        raise GeoEvsError(
            f"method '{entry.name}' is not trained; remove 'training', or declare it in its needs"
        )
    if not trained:
        return
    trainer, slash, variant = entry.training.partition("/")
    if not (trainer and slash and variant) or "/" in variant:
        raise GeoEvsError(
            f"the training '{entry.training}' is not of the form VARIANT or METHOD/VARIANT; name "
            "one so"
        )
    if trainer == entry.method and trainer not in find_trainings():
        raise GeoEvsError(
            f"method '{trainer}' has no training of its own; name another method's as "
            f"METHOD/VARIANT ({', '.join(_all_trainings(config))})"
        )
    readable = _trainers(entry)
    if readable and trainer not in readable:
        raise SettingError(
            ("training",),
            f"method '{entry.name}' cannot read the weights of '{trainer}'; name a training of "
            f"{' or '.join(map(repr, readable))}",
        )
    check_named(config, entry.training)
    partition = training_class(trainer).partition
    if not partition_scenes(config, partition, config["datasets"]):
        raise GeoEvsError(
            f"method '{entry.name}' is trained, but no data set has scenes under "
            f"partitions.{partition}; name some, or set the method to null"
        )


def _all_trainings(config: Mapping[str, Any]) -> list[str]:
    return [f"{name}/{variant}" for name in find_trainings() for variant in variants(config, name)]


def _needs(entry: MethodEntry) -> tuple[str, ...]:
    method = _imported(entry)
    # A method without info is told so by its rows.
    return _texts(getattr(getattr(method, "info", None), "needs", ()))


def _trainers(entry: MethodEntry) -> tuple[str, ...]:
    """Whose weights a method reads: those it names, else its own; none if nobody knows."""
    own = (entry.method,) if entry.method in find_trainings() else ()
    return _texts(getattr(_imported(entry), "trainers", own))


def _texts(declared: Any) -> tuple[str, ...]:
    """What a class declares as texts; nothing of what is something else, as its rows will tell."""
    return tuple(declared) if isinstance(declared, (tuple, list)) else ()


def _imported(entry: MethodEntry) -> type | None:
    """An entrant's class; None for one that cannot be imported and so says so in its rows.

    Raises:
        GeoEvsError: it cannot be imported although the config says more of it than its name.
    """
    try:
        return method_class(entry.method)
    except GeoEvsError:
        raise
    except (Exception, SystemExit) as error:  # a method's module may raise anything
        if not (entry.training or entry.options):
            return None
        raise GeoEvsError(
            f"method '{entry.method}' cannot be imported ({reason_of(error)}); install what it "
            "lacks, or set it to null to leave it out"
        ) from error
