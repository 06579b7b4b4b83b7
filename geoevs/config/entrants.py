"""The entrants of a run, as its config names them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from geoevs.config.trainings import training_of
from geoevs.methods.finding import find_trainings
from geoevs.protocol.entries import MethodEntry


def method_entries(config: Mapping[str, Any]) -> list[MethodEntry]:
    """The run's entrants, one for every method, variant and seed."""
    trainers = find_trainings()
    return [
        MethodEntry.parse(
            name,
            settings.get("options", {}),
            config["seed"] + seed,
            training_of(name.partition(".")[0], settings.get("training", ""), trainers),
        )
        for name, settings in config["methods"].items()
        if settings is not None
        for seed in settings.get("seeds", [0])
    ]


def stability_entries(config: Mapping[str, Any]) -> list[MethodEntry]:
    """The entrants of the stability suite: the first seed of each, with the suite's options."""
    return _entries_of("stability", config)


def detection_entries(config: Mapping[str, Any]) -> list[MethodEntry]:
    """Whose views detectors are shown: the first seed of each, with the section's options."""
    return _entries_of("detection", config)


def _entries_of(section: str, config: Mapping[str, Any]) -> list[MethodEntry]:
    wanted = config[section]["methods"]
    entries: dict[str, MethodEntry] = {}
    for entry in method_entries(config):
        changed = wanted.get(entry.name)
        if changed is not None and entry.name not in entries:
            entries[entry.name] = replace(entry, options=entry.options | changed)
    return list(entries.values())
