"""Checking a run's config: one sentence per mistake, with the file, the line and the right word."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from jsonschema import Draft202012Validator
from jsonschema.validators import extend

from geoevs.config.datasets import check_datasets
from geoevs.config.detection import check_detection
from geoevs.config.entrants import method_entries, stability_entries
from geoevs.config.methods import check_method_options, check_methods
from geoevs.config.partitions import partition_scenes
from geoevs.config.places import COMMAND_LINE, ConfigFile, Key, Origin, locate, located
from geoevs.config.trainings import check_trainings
from geoevs.config.values import check_values, explain
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.names import expanded
from geoevs.core.plugins import check_imports
from geoevs.core.settings import check_options
from geoevs.geometry.depth_models import DEPTH_MODELS, VggtDepth
from geoevs.methods.contract import ORACLES
from geoevs.methods.finding import find_methods, find_trainings
from geoevs.protocol.stability import levels_of
from geoevs.protocol.stressors import STRESSORS, stressor_named
from geoevs.scenes.scene import find_sources, source_class

VALIDATOR = extend(
    Draft202012Validator,
    type_checker=Draft202012Validator.TYPE_CHECKER.redefine(
        "integer", lambda _, value: isinstance(value, int) and not isinstance(value, bool)
    ),
)
"""By JSON Schema 3.0 is an integer; by the commands that are given it, it is none."""

SUITE_MODEL = "vggt-nano"
"""The depth model whose pretrained weights come with this suite."""

POSES: tuple[Key, ...] = (
    ("protocol", "lateral"),
    ("protocol", "pose_sweep", "angles"),
    ("protocol", "masked", "yaw"),
    ("protocol", "masked", "lateral"),
    ("conditions", "masks", "lateral"),
    ("stability", "lateral"),
    *(("stability", "levels", name) for name in STRESSORS),
)
"""Lists whose values are parts of the names of files: of targets, masks and stresses."""

DETECTION_POSES: tuple[Key, ...] = (
    ("detection", "views", "shares"),
    ("detection", "views", "lateral"),
    ("detection", "offsets"),
)
"""Likewise, where the section is as `check_detection` wants it."""


def check_config(
    config: Mapping[str, Any],
    schema: Path,
    files: Sequence[Path],
    arguments: Mapping[str, Any] | None = None,
) -> None:
    """Check a merged config.

    Args:
        config: what the run will use.
        schema: the JSON schema of its keys.
        files: the files it was merged from, later ones winning; mistakes are located in them.
        arguments: what `--config` set on top of them.

    Raises:
        GeoEvsError: a file is not as `read_nodes` wants it; a key is unknown, missing or wrong; a
            data set, source, method, training or option does not exist, or has no such value; two
            partitions share a frame; there is nothing to evaluate or to train on.
    """
    origins: list[Origin] = [ConfigFile.read(file) for file in files]
    if arguments:
        origins.append(arguments)
    with located((), origins):
        check_values(config)
    _check_moved(config, origins)
    validator = VALIDATOR(yaml.safe_load(Path(schema).read_text(encoding="utf-8")))
    mistakes = sorted(
        validator.iter_errors(config), key=lambda mistake: [str(part) for part in mistake.path]
    )
    if mistakes:
        key, problem = explain(mistakes[0])
        place = locate(key, origins)
        if place == COMMAND_LINE and len(key) > 1:
            problem += "; `--config` takes all that is in a section for text, so write a file"
        raise GeoEvsError(f"{place}: {problem}")
    _check_imports(config)
    check_datasets(config, origins)
    _check_poses(config, origins, POSES)
    _check_masks(config, origins)
    _check_geometry(config, origins)
    check_trainings(config, origins)
    check_methods(config, origins)
    _check_stability(config, origins)
    check_detection(config, origins)
    _check_poses(config, origins, DETECTION_POSES)
    _check_tables(config, origins)


def _check_tables(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    tables = config["tables"]
    for name in ("pose_bins", "support_bins"):
        if any(low >= high for low, high in itertools.pairwise(tables[name])):
            where = locate(("tables", name), origins)
            raise GeoEvsError(f"{where}: the edges must rise; sort them and drop repeats")
    with located(("tables", "ablation"), origins):
        method, methods = tables["ablation"], find_methods()
        if method not in methods:
            raise GeoEvsError(f"there is no method '{method}'; {did_you_mean(method, methods)}")


def _check_moved(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    """Version 0.1 had a section `training` for the method of the ablation, others by their name."""
    tables = config.get("tables")
    ablated = tables.get("ablation", "METHOD") if isinstance(tables, Mapping) else "METHOD"
    moved = {"training": ablated} | {name: name for name in find_trainings()}
    for old, method in moved.items():
        if old in config:
            raise GeoEvsError(
                f"{locate((old,), origins)}: the section '{old}' is 'trainings.{method}' now; move "
                f"its keys under 'trainings:', '{method}:'"
            )


def _check_imports(config: Mapping[str, Any]) -> None:
    """Code that a config names must not end the process that checks it."""
    methods, trainings, sources = find_methods(), find_trainings(), find_sources()
    named = {entry.method for entry in method_entries(config)}
    trained = {entry.training.partition("/")[0] for entry in method_entries(config)}
    check_imports(
        modules[name]
        for modules, names in (
            (methods, named),
            (trainings, {*config["trainings"], *trained}),
            (sources, {dataset["source"] for dataset in config["datasets"].values()}),
        )
        for name in sorted(names & modules.keys())
    )


def _check_poses(config: Mapping[str, Any], origins: Sequence[Origin], keys: Sequence[Key]) -> None:
    """Shifts, angles and levels name files, by the six digits that `g` writes of them."""
    for key in keys:
        values: Any = config
        for part in key:
            values = values.get(part, {})
        named: dict[str, float] = {}
        for value in values:
            other = named.setdefault(f"{value:g}", value)
            if other is not value:
                raise GeoEvsError(
                    f"{locate(key, origins)}: '{'.'.join(key)}' has {other!r} and {value!r}, whose "
                    "files would overwrite each other; choose values that differ in their first "
                    "six digits"
                )


def _check_masks(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    """Shifts that train must not be among those that test; yaws are in other units, see `masks`."""
    tested = config["protocol"]["masked"]["lateral"]
    shared = sorted(set(config["conditions"]["masks"]["lateral"]) & set(tested))
    if shared:
        raise GeoEvsError(
            f"{locate(('conditions', 'masks', 'lateral'), origins)}: masks shifted by {shared[0]} "
            "m are what protocol.masked tests with; change one of them"
        )


def _check_weights(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    """They are inputs of rules, where braces are wildcards."""
    for key, path in (
        (("weights",), config["weights"]),
        (("geometry", "weights"), config["geometry"]["weights"]),
    ):
        if path is not None and set("{}") & set(str(expanded(path))):
            raise GeoEvsError(
                f"{locate(key, origins)}: '{path}' has braces, which Snakemake takes for "
                "wildcards; rename the folder"
            )


def _check_geometry(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    _check_weights(config, origins)
    geometry = config["geometry"]
    model = geometry["model"]
    with located(("geometry", "model"), origins):
        if model not in DEPTH_MODELS:
            raise GeoEvsError(
                f"there is no depth model '{model}'; {did_you_mean(model, DEPTH_MODELS)}"
            )
    if model == "lidar":
        return
    if geometry["weights"] is None and model != SUITE_MODEL:
        raise GeoEvsError(
            f"{locate(('geometry', 'weights'), origins)}: depth model '{model}' needs weights; "
            "give their path"
        )
    if geometry["finetune"] is None:
        return
    with located(("geometry", "finetune"), origins):
        if DEPTH_MODELS[model] is not VggtDepth:
            raise GeoEvsError(f"depth model '{model}' cannot be fine-tuned; set 'finetune' to null")
        if not partition_scenes(config, "geometry", config["datasets"]):
            raise GeoEvsError(
                f"there are no scenes to fine-tune '{model}' on; name some under "
                "partitions.geometry of a data set, or set 'finetune' to null"
            )


def _check_stability(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    """Its data sets have target lists of their own; its methods are among the run's."""
    stability = config["stability"]
    with located(("stability", "datasets"), origins):
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
        with located(("stability", "levels", name), origins):
            stressor_named(name)
    worlds = [name for name, stressor in STRESSORS.items() if stressor.kind == "world"]
    for dataset, stressor in itertools.product(stability["datasets"], worlds):
        with located(("stability", "levels", stressor), origins):
            _check_worlds(config["datasets"][dataset], stressor, levels_of(stressor, stability))
    for name in stability["methods"]:
        with located(("stability", "methods", name), origins):
            if name not in config["methods"]:
                hint = did_you_mean(name, config["methods"])
                raise GeoEvsError(f"there is no '{name}' under 'methods'; {hint}")
    for entry in stability_entries(config):
        with located(("stability", "methods", entry.name), origins):
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
