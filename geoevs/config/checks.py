"""Checking a run's config: one sentence per mistake, with the file, the line and the right word."""

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from jsonschema import Draft202012Validator

from geoevs.config.files import check_repeats, explain, locate, located
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.settings import check_options
from geoevs.geometry.depth_models import DEPTH_MODELS, VggtDepth
from geoevs.methods.finding import find_methods, method_class
from geoevs.protocol.entries import ORACLES, MethodEntry
from geoevs.protocol.stressors import MOTION_OPTION
from geoevs.scenes.scene import SceneRef, source_class

SUITE_MODEL = "vggt-nano"
"""The depth model whose pretrained weights come with this suite."""

FREEVS = "freevs"
"""The method whose training has a section of its own, and the name of that training."""

TRAINING_PARTITIONS = {"train", "clips"}
"""What a frame may serve both of."""


def check_config(config: Mapping[str, Any], schema: Path, files: Sequence[Path]) -> None:
    """Check a merged config.

    Args:
        config: what the run will use.
        schema: the JSON schema of its keys.
        files: the files it was merged from, later ones winning; mistakes are located in them.

    Raises:
        GeoEvsError: a key is unknown, missing, repeated or wrong; a data set, source, method or
            option does not exist; two partitions share a frame; there is nothing to evaluate or to
            train on.
    """
    for file in files:
        check_repeats(file)
    validator = Draft202012Validator(yaml.safe_load(Path(schema).read_text()))
    mistakes = sorted(
        validator.iter_errors(config), key=lambda mistake: [str(part) for part in mistake.path]
    )
    if mistakes:
        key, problem = explain(mistakes[0])
        raise GeoEvsError(f"{locate(key, files)}: {problem}")
    _check_datasets(config, files)
    _check_masks(config, files)
    _check_geometry(config, files)
    _check_methods(config, files)
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


def method_entries(config: Mapping[str, Any]) -> list[MethodEntry]:
    """The run's entrants, one for every method, variant and seed."""
    return [
        MethodEntry.parse(
            name, settings.get("options", {}), config["seed"] + seed, settings.get("training", "")
        )
        for name, settings in config["methods"].items()
        if settings is not None
        for seed in settings.get("seeds", [0])
    ]


def stability_entries(config: Mapping[str, Any]) -> list[MethodEntry]:
    """The entrants of the stability suite: the first seed of each, with the suite's options."""
    wanted = config["stability"]["methods"]
    entries: dict[str, MethodEntry] = {}
    for entry in method_entries(config):
        changed = wanted.get(entry.name)
        if changed is not None and entry.name not in entries:
            entries[entry.name] = replace(entry, options=entry.options | changed)
    return list(entries.values())


def expand_scenes(scenes: Iterable[str]) -> list[str]:
    """A config's scenes with its ranges written out.

    Raises:
        GeoEvsError: a range is not of the form NAME and two rising numbers.

    >>> expand_scenes(["junction-7", "curve-008..010"])
    ['junction-7', 'curve-008', 'curve-009', 'curve-010']
    """
    names: list[str] = []
    for text in scenes:
        if ".." not in text:
            names.append(text)
            continue
        found = re.fullmatch(r"([a-zA-Z0-9_.-]*?)([0-9]+)\.\.([0-9]+)", text)
        if found is None or int(found[2]) > int(found[3]):
            raise GeoEvsError(
                f"scene '{text}' is not of the form NAME, NAME@FIRST-LAST (frames) or FIRST..LAST "
                "(scenes), such as curve-1..40"
            )
        prefix, first, last = found.groups()
        numbers = range(int(first), int(last) + 1)
        names.extend(f"{prefix}{number:0{len(first)}d}" for number in numbers)
    return names


def partition_scenes(
    config: Mapping[str, Any], partition: str, datasets: Iterable[str]
) -> list[tuple[str, str]]:
    """(data set, scene) pairs that a partition of some data sets names, in order."""
    return [
        (dataset, scene)
        for dataset in datasets
        for scene in expand_scenes(config["datasets"][dataset]["partitions"].get(partition, []))
    ]


def _check_datasets(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    datasets = config["datasets"]
    for name in config["evaluate"]:
        if name not in datasets:
            raise GeoEvsError(
                f"{locate(('evaluate',), files)}: there is no data set '{name}' under 'datasets'; "
                f"{did_you_mean(name, datasets)}"
            )
        if not datasets[name]["partitions"].get("test"):
            raise GeoEvsError(
                f"{locate(('evaluate',), files)}: data set '{name}' has no test scenes; name some "
                "under its partitions.test, or do not evaluate it"
            )
    for name, dataset in datasets.items():
        source = dataset["source"]
        with located(("datasets", name, "source"), files):
            source_class(source)
        with located(("datasets", name, "options"), files):
            check_options(f"data source '{source}'", source_class(source), dataset["options"], 2)
        with located(("datasets", name, "partitions"), files):
            placed = _placed_scenes(dataset["partitions"])
            _check_partitions(name, placed)
            for other, earlier in datasets.items():
                if other == name:
                    break
                if earlier["source"] == source:
                    _check_shared(name, placed, other, _placed_scenes(earlier["partitions"]))


Placed = list[tuple[str, str, SceneRef]]
"""Scenes of a data set: partition, the scene as text, and what that means."""


def _placed_scenes(partitions: Mapping[str, list[str]]) -> Placed:
    return [
        (partition, text, SceneRef.parse(text))
        for partition, texts in partitions.items()
        for text in expand_scenes(texts)
    ]


def _check_partitions(dataset: str, placed: Placed) -> None:
    for (first, text, ref), (second, other_text, other) in itertools.combinations(placed, 2):
        if ref.overlaps(other) and {first, second} != TRAINING_PARTITIONS:
            raise GeoEvsError(
                f"data set '{dataset}' has scene '{text}' in partition '{first}' and "
                f"'{other_text}' in '{second}'; a frame may serve one partition only, so remove one"
            )


def _check_shared(dataset: str, placed: Placed, other: str, other_placed: Placed) -> None:
    """Data sets of one source may share scenes, for instance at other options.

    But a frame that one of them tests must not train anything in the other.
    """
    for (first, text, ref), (second, other_text, other_ref) in itertools.product(
        placed, other_placed
    ):
        if first == second or {first, second} == TRAINING_PARTITIONS:
            continue
        if ref.overlaps(other_ref):
            raise GeoEvsError(
                f"data set '{dataset}' has scene '{text}' in partition '{first}' and data set "
                f"'{other}', of the same source, has '{other_text}' in '{second}'; a frame may "
                "serve one partition only, so remove one"
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


def _check_masks(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Shifts that train must not be among those that test; yaws are in other units, see `masks`."""
    tested = config["protocol"]["masked"]["lateral"]
    shared = sorted(set(config["conditions"]["masks"]["lateral"]) & set(tested))
    if shared:
        raise GeoEvsError(
            f"{locate(('conditions', 'masks', 'lateral'), files)}: masks shifted by {shared[0]} m "
            "are what protocol.masked tests with; change one of them"
        )


def _check_methods(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    methods = [*ORACLES, *find_methods()]
    labels = set()
    if FREEVS in config["training"]["variants"]:
        where = locate(("training", "variants", FREEVS), files)
        raise GeoEvsError(f"{where}: '{FREEVS}' is FreeVS's own training; rename the variant")
    for entry in method_entries(config):
        name = entry.name
        with located(("methods", name), files):
            if entry.method not in methods:
                raise GeoEvsError(
                    f"there is no method '{entry.method}'; {did_you_mean(entry.method, methods)}"
                )
            if entry.method in ORACLES and entry.options:
                raise GeoEvsError(f"the control '{entry.method}' has no options; remove them")
            _check_training(config, entry, name)
            _check_method_options(entry)
            if entry.label in labels:
                raise GeoEvsError(f"two entrants are called '{entry.label}'; rename one variant")
            labels.add(entry.label)


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
    for name in stability["datasets"]:
        dataset = config["datasets"][name]
        for level in stability["levels"]["motion"]:
            with located(("stability", "levels", "motion"), files):
                options = dataset["options"] | {MOTION_OPTION: level}
                source = source_class(dataset["source"])
                check_options(f"data source '{dataset['source']}'", source, options, 2)
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
            _check_method_options(entry)


def _check_method_options(entry: MethodEntry) -> None:
    given = entry.options | ({"weights": ""} if entry.training else {})
    if given:
        check_options(f"method '{entry.name}'", _imported(entry.method), given)


def training_settings(config: Mapping[str, Any], training: str) -> dict[str, Any]:
    """What one of the config's trainings is made with: the section, and the variant over it."""
    shared = {key: value for key, value in config["training"].items() if key != "variants"}
    variant = config["training"]["variants"][training]
    return {**shared, **variant, "sampling": shared["sampling"] | variant.get("sampling", {})}


def _check_training(config: Mapping[str, Any], entry: MethodEntry, name: str) -> None:
    """Methods that are trained name a training of theirs, others none; it needs scenes."""
    if entry.method == FREEVS:
        trainings, where, partition = [FREEVS], FREEVS, "clips"
    else:
        trainings, where = list(config["training"]["variants"]), "training.variants"
        partition = "train"
    trained = entry.method not in ORACLES and "training" in _needs(entry)
    if trained and not entry.training:
        raise GeoEvsError(
            f"method '{name}' is trained before it is fitted; name one under 'training' "
            f"({', '.join(trainings)})"
        )
    if entry.training and not trained:
        raise GeoEvsError(f"method '{name}' is not trained; remove 'training'")
    if trained and entry.training not in trainings:
        raise GeoEvsError(
            f"there is no training '{entry.training}' under '{where}'; "
            f"{did_you_mean(entry.training, trainings)}"
        )
    if trained and not partition_scenes(config, partition, config["datasets"]):
        raise GeoEvsError(
            f"method '{name}' is trained, but no data set has scenes under partitions.{partition}; "
            "name some, or set the method to null"
        )


def _needs(entry: MethodEntry) -> tuple[str, ...]:
    """What a method declares; one that cannot be imported says so in rows of its own, as ever."""
    if entry.training or entry.options:
        return _imported(entry.method).info.needs
    try:
        return method_class(entry.method).info.needs
    except Exception:  # a method's module may raise anything
        return ()


def _imported(method: str) -> type:
    try:
        return method_class(method)
    except ImportError as error:
        raise GeoEvsError(
            f"method '{method}' cannot be imported ({error}); install what it lacks, or set it to "
            "null to leave it out"
        ) from error
