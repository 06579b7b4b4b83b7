"""Checking the config's section of table 3, by `snakemake detection`."""

from collections.abc import Mapping, Sequence
from typing import Any

from geoevs.config.entrants import detection_entries
from geoevs.config.methods import check_method_options
from geoevs.config.partitions import partition_scenes
from geoevs.config.places import Origin, located
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.settings import SettingError
from geoevs.detection.settings import DetectionSettings
from geoevs.protocol.entries import REFERENCE

PARTITIONS = ("detection", "detection-test")
"""Scenes that detectors learn from, and those that they are tested on."""


def check_detection(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    """Check what can be wrong before any scene is looked at.

    Raises:
        GeoEvsError: a setting is wrong, a label is of two classes, an entrant is none of the run's
            or can have no views here, or there are scenes to learn from and none to test on.
    """
    with located(("detection",), origins):
        settings = DetectionSettings.parse(config["detection"])
        _check_classes(settings)
        if 0 in settings.offsets:
            raise SettingError(
                ("offsets",), "the rig without an offset is shown anyway; remove the offset 0"
            )
        _check_methods(config)
    with located(("datasets",), origins):
        there = [bool(partition_scenes(config, name, config["datasets"])) for name in PARTITIONS]
        if there[0] != there[1]:
            has, lacks = PARTITIONS if there[0] else reversed(PARTITIONS)
            raise GeoEvsError(
                f"data sets have scenes under partitions.{has} and none under partitions.{lacks}; "
                "name some there, or remove those"
            )


def _check_classes(settings: DetectionSettings) -> None:
    kinds: dict[str, str] = {}
    for kind, labels in settings.classes.items():
        for label in labels:
            if kinds.setdefault(label, kind) != kind:
                raise SettingError(
                    ("classes", kind),
                    f"the label '{label}' is of the classes '{kinds[label]}' and '{kind}'; choose "
                    "one",
                )


def _check_methods(config: Mapping[str, Any]) -> None:
    for name in config["detection"]["methods"]:
        if name not in config["methods"]:
            hint = did_you_mean(name, config["methods"])
            raise SettingError(("methods", name), f"there is no '{name}' under 'methods'; {hint}")
    for entry in detection_entries(config):
        if entry.method == REFERENCE:
            raise SettingError(
                ("methods", entry.name),
                "the control 'reference' has a picture only where LiDAR has points; remove it, or "
                "name 'truth'",
            )
        try:
            check_method_options(entry)
        except SettingError as mistake:
            key = mistake.key[1:] if mistake.key[:1] == ("options",) else mistake.key
            raise SettingError(("methods", entry.name, *key), str(mistake)) from None
