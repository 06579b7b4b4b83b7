"""The scenes of a config's data sets, by partition; a frame serves one partition only."""

import itertools
import re
from collections.abc import Iterable, Mapping
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.methods.training import PARTITIONS as TRAINING_PARTITIONS
from geoevs.scenes.scene import SceneRef

MOST_SCENES = 10_000
"""Of one range: more are a slip of the keyboard."""


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
        match = re.fullmatch(r"([a-zA-Z0-9_.-]*?)([0-9]+)\.\.([0-9]+)", text)
        if match is None or int(match[2]) > int(match[3]):
            raise GeoEvsError(
                f"scene '{text}' is not of the form NAME, NAME@FIRST-LAST (frames) or FIRST..LAST "
                "(scenes), such as curve-1..40"
            )
        prefix, first, last = match.groups()
        numbers = range(int(first), int(last) + 1)
        if numbers.stop - numbers.start > MOST_SCENES:
            raise GeoEvsError(
                f"scene '{text}' is a range of {numbers.stop - numbers.start} scenes; name "
                f"{MOST_SCENES} at most"
            )
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


Placed = list[tuple[str, str, SceneRef]]
"""Scenes of a data set: the partition, the scene as text, and the text parsed."""


def placed_scenes(partitions: Mapping[str, list[str]]) -> Placed:
    """Every scene of a data set's partitions, ranges of seeds written out (see `expand_scenes`).

    Raises:
        GeoEvsError: a scene is not of the form NAME or NAME@FIRST-LAST.
    """
    return [
        (partition, text, SceneRef.parse(text))
        for partition, texts in partitions.items()
        for text in expand_scenes(texts)
    ]


def check_partitions(dataset: str, placed: Placed) -> None:
    """Check that no frame of a data set serves two partitions, but for those that train.

    Raises:
        GeoEvsError: two scenes share a frame; the sentence names both and their partitions.
    """
    for (first, text, ref), (second, other_text, other) in itertools.combinations(placed, 2):
        if ref.overlaps(other) and {first, second} != set(TRAINING_PARTITIONS):
            raise GeoEvsError(
                f"data set '{dataset}' has scene '{text}' in partition '{first}' and "
                f"'{other_text}' in '{second}'; a frame may serve one partition only, so remove one"
            )


def check_shared(dataset: str, placed: Placed, other: str, other_placed: Placed) -> None:
    """Data sets of one source may share scenes, for instance at other options.

    But a frame that one of them tests must not train anything in the other.
    """
    for (first, text, ref), (second, other_text, other_ref) in itertools.product(
        placed, other_placed
    ):
        if first == second or {first, second} == set(TRAINING_PARTITIONS):
            continue
        if ref.overlaps(other_ref):
            raise GeoEvsError(
                f"data set '{dataset}' has scene '{text}' in partition '{first}' and data set "
                f"'{other}', of the same source, has '{other_text}' in '{second}'; a frame may "
                "serve one partition only, so remove one"
            )
