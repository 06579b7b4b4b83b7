"""Checking a config's data sets: their sources, options, scenes and partitions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geoevs.config.files import locate, located
from geoevs.config.partitions import check_partitions, check_shared, placed_scenes
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.scenes.scene import load_source, source_class


def check_datasets(config: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Check that every data set can be read, as far as its source tells, and shares no frame.

    Raises:
        GeoEvsError: a source, an option or a scene does not exist, a frame is in two partitions, or
            a data set under `evaluate` has nothing to test.
    """
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
        with located(("datasets", name, "source"), files):
            source_class(dataset["source"])
        with located(("datasets", name, "options"), files):
            source = load_source(dataset["source"], *config["resolution"], dataset["options"])
        for partition, scenes in dataset["partitions"].items():
            with located(("datasets", name, "partitions", partition), files):
                for _, _, scene in placed_scenes({partition: scenes}):
                    source.check(scene)
        with located(("datasets", name, "partitions"), files):
            placed = placed_scenes(dataset["partitions"])
            check_partitions(name, placed)
            for other, earlier in datasets.items():
                if other == name:
                    break
                if earlier["source"] == dataset["source"]:
                    check_shared(name, placed, other, placed_scenes(earlier["partitions"]))
