"""Checking a run's config: one sentence per mistake, with the file, the line and the right word."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from jsonschema import Draft202012Validator

from geoevs.config.datasets import check_datasets
from geoevs.config.entrants import stability_entries
from geoevs.config.files import check_repeats, explain, locate, located
from geoevs.config.methods import check_method_options, check_methods
from geoevs.config.partitions import partition_scenes
from geoevs.config.trainings import check_trainings
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.settings import check_options
from geoevs.geometry.depth_models import DEPTH_MODELS, VggtDepth
from geoevs.methods.contract import ORACLES
from geoevs.methods.finding import find_methods, find_trainings
from geoevs.protocol.stability import levels_of
from geoevs.protocol.stressors import STRESSORS, stressor_named
from geoevs.scenes.scene import source_class

SUITE_MODEL = "vggt-nano"
"""The depth model whose pretrained weights come with this suite."""


def check_config(config: Mapping[str, Any], schema: Path, files: Sequence[Path]) -> None:
    """Check a merged config.

    Args:
        config: what the run will use.
        schema: the JSON schema of its keys.
        files: the files it was merged from, later ones winning; mistakes are located in them.

    Raises:
        GeoEvsError: a key is unknown, missing, repeated or wrong; a data set, source, method,
            training or option does not exist, or has no such value; two partitions share a frame;
            there is nothing to evaluate or to train on.
    """
    for file in files:
        check_repeats(file)
    _check_moved(config, files)
    validator = Draft202012Validator(yaml.safe_load(Path(schema).read_text(encoding="utf-8")))
    mistakes = sorted(
        validator.iter_errors(config), key=lambda mistake: [str(part) for part in mistake.path]
    )
    if mistakes:
        key, problem = explain(mistakes[0])
        raise GeoEvsError(f"{locate(key, files)}: {problem}")
    check_datasets(config, files)
    _check_masks(config, files)
    _check_geometry(config, files)
    check_trainings(config, files)
    check_methods(config, files)
    _check_stability(config, files)
    _check_tables(config, files)


def _check_tables(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    tables = config["tables"]
    for name in ("pose_bins", "support_bins"):
        if any(low >= high for low, high in itertools.pairwise(tables[name])):
            where = locate(("tables", name), files)
            raise GeoEvsError(f"{where}: the edges must rise; sort them and drop repeats")
    with located(("tables", "ablation"), files):
        method, methods = tables["ablation"], find_methods()
        if method not in methods:
            raise GeoEvsError(f"there is no method '{method}'; {did_you_mean(method, methods)}")


def _check_moved(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Version 0.1 had a section `training` for the method of the ablation, others by their name."""
    tables = config.get("tables")
    ablated = tables.get("ablation", "METHOD") if isinstance(tables, Mapping) else "METHOD"
    moved = {"training": ablated} | {name: name for name in find_trainings()}
    for old, method in moved.items():
        if old in config:
            raise GeoEvsError(
                f"{locate((old,), files)}: the section '{old}' is 'trainings.{method}' now; move "
                f"its keys under 'trainings:', '{method}:'"
            )


def _check_masks(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Shifts that train must not be among those that test; yaws are in other units, see `masks`."""
    tested = config["protocol"]["masked"]["lateral"]
    shared = sorted(set(config["conditions"]["masks"]["lateral"]) & set(tested))
    if shared:
        raise GeoEvsError(
            f"{locate(('conditions', 'masks', 'lateral'), files)}: masks shifted by {shared[0]} m "
            "are what protocol.masked tests with; change one of them"
        )


def _check_geometry(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    geometry = config["geometry"]
    model = geometry["model"]
    with located(("geometry", "model"), files):
        if model not in DEPTH_MODELS:
            raise GeoEvsError(
                f"there is no depth model '{model}'; {did_you_mean(model, DEPTH_MODELS)}"
            )
    if model == "lidar":
        return
    if geometry["weights"] is None and model != SUITE_MODEL:
        raise GeoEvsError(
            f"{locate(('geometry', 'weights'), files)}: depth model '{model}' needs weights; "
            "give their path"
        )
    if geometry["finetune"] is None:
        return
    with located(("geometry", "finetune"), files):
        if DEPTH_MODELS[model] is not VggtDepth:
            raise GeoEvsError(f"depth model '{model}' cannot be fine-tuned; set 'finetune' to null")
        if not partition_scenes(config, "geometry", config["datasets"]):
            raise GeoEvsError(
                f"there are no scenes to fine-tune '{model}' on; name some under "
                "partitions.geometry of a data set, or set 'finetune' to null"
            )


def _check_stability(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Its data sets have target lists of their own; its methods are among the run's."""
    stability = config["stability"]
    with located(("stability", "datasets"), files):
        for name in stability["datasets"]:
            if name not in config["datasets"]:
                hint = did_you_mean(name, config["datasets"])
                raise GeoEvsError(f"there is no data set '{name}' under 'datasets'; {hint}")
            if name in config["evaluate"]:
                raise GeoEvsError(
                    f"data set '{name}' is under 'evaluate' too, at other targets; name another "
                    "one of the same source"
                )
    for name in stability["levels"]:
        with located(("stability", "levels", name), files):
            stressor_named(name)
    worlds = [name for name, stressor in STRESSORS.items() if stressor.kind == "world"]
    for dataset, stressor in itertools.product(stability["datasets"], worlds):
        with located(("stability", "levels", stressor), files):
            _check_worlds(config["datasets"][dataset], stressor, levels_of(stressor, stability))
    for name in stability["methods"]:
        with located(("stability", "methods", name), files):
            if name not in config["methods"]:
                hint = did_you_mean(name, config["methods"])
                raise GeoEvsError(f"there is no '{name}' under 'methods'; {hint}")
    for entry in stability_entries(config):
        with located(("stability", "methods", entry.name), files):
            if entry.method in ORACLES:
                raise GeoEvsError(
                    f"the control '{entry.method}' is given nothing that could be stressed; "
                    "remove it"
                )
            check_method_options(entry)


def _check_worlds(dataset: Mapping[str, Any], stressor: str, levels: Iterable[float]) -> None:
    """The data source must take every level as the option that the stressor sets."""
    source = dataset["source"]
    for level in levels:
        options = dataset["options"] | {STRESSORS[stressor].option: level}
        try:
            check_options(f"data source '{source}'", source_class(source), options, 2)
        except GeoEvsError as mistake:
            raise GeoEvsError(
                f"{mistake}; the stressor '{stressor}' sets that option, and is left out by an "
                "empty list of levels"
            ) from mistake
