"""Checking a config's data sets: their sources, options, scenes and partitions."""

from collections.abc import Mapping, Sequence
from typing import Any

from geoevs.config.partitions import MOST_OF_ALL, Placed, check_partitions, placed_scenes
from geoevs.config.places import Origin, locate, located
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.scenes.scene import load_source, source_class


def check_datasets(config: Mapping[str, Any], origins: Sequence[Origin]) -> None:
    """Check that every data set can be read, as far as its source tells, and shares no frame.

    Raises:
        GeoEvsError: a source, an option or a scene does not exist, a frame is in two partitions, or
            a data set under `evaluate` has nothing to test.
    """
    datasets = config["datasets"]
    where = locate(("evaluate",), origins)
    for name in config["evaluate"]:
        if name not in datasets:
            raise GeoEvsError(
                f"{where}: there is no data set '{name}' under 'datasets'; "
                f"{did_you_mean(name, datasets)}"
            )
        if not datasets[name]["partitions"].get("test"):
            raise GeoEvsError(
                f"{where}: data set '{name}' has no test scenes; name some "
                "under its partitions.test, or do not evaluate it"
            )
    by_source: dict[str, list[Placed]] = {}
    for name, dataset in datasets.items():
        with located(("datasets", name, "source"), origins):
            source_class(dataset["source"])
        with located(("datasets", name, "options"), origins):
            source = load_source(dataset["source"], *config["resolution"], dataset["options"])
        placed = by_source.setdefault(dataset["source"], [])
        for partition, scenes in dataset["partitions"].items():
            with located(("datasets", name, "partitions", partition), origins):
                for scene in placed_scenes(name, {partition: scenes}):
                    source.check(scene.ref)
                    placed.append(scene)
        if sum(map(len, by_source.values())) > MOST_OF_ALL:
            raise GeoEvsError(
                f"{locate(('datasets', name, 'partitions'), origins)}: up to data set '{name}' "
                f"there are more than {MOST_OF_ALL:,} scenes; name fewer"
            )
    for placed in by_source.values():
        with located(("datasets",), origins):
            check_partitions(placed)
