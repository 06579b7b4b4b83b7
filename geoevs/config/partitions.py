"""The scenes of a config's data sets, by partition; a frame serves one partition only."""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from geoevs.config.scene_lists import listed_scenes
from geoevs.core.errors import GeoEvsError
from geoevs.core.settings import SettingError
from geoevs.core.text import clean
from geoevs.methods.training import PARTITIONS as TRAINING_PARTITIONS
from geoevs.scenes.scene import SceneRef

MOST_SCENES = 10_000
"""Of one data set's partition: more are a slip of the keyboard."""

MOST_OF_ALL = 50_000
"""Scenes of a config."""

RANGE = re.compile(r"([a-zA-Z0-9_.-]*?)([0-9]{1,18})\.\.([0-9]{1,18})")


def expand_scenes(scenes: Iterable[str | Mapping[str, Any]]) -> list[str]:
    """A config's scenes with its ranges and its indices of list files written out.

    Raises:
        GeoEvsError: a range is not of the form NAME and two rising numbers, or there are more than
            MOST_SCENES, which are counted before any is written out; or a list file does not have
            what is asked of it (see `listed_scenes`).

    >>> expand_scenes(["junction-7", "curve-008..010"])
    ['junction-7', 'curve-008', 'curve-009', 'curve-010']
    """
    names: list[str] = []
    for number, text in enumerate(scenes):
        if isinstance(text, Mapping):
            try:
                names.extend(listed_scenes(text))
            except GeoEvsError as mistake:
                raise SettingError((number,), str(mistake)) from mistake
            if len(names) > MOST_SCENES:
                raise SettingError(
                    (number,),
                    f"up to {clean(text['list'], 60)} there are {len(names):,} scenes; a partition "
                    f"has {MOST_SCENES:,} at most, so name fewer",
                )
            continue
        if ".." not in text:
            names.append(text)
            continue
        match = RANGE.fullmatch(text)
        if match is None or int(match[2]) > int(match[3]):
            raise GeoEvsError(
                f"scene '{clean(text, 60)}' is not of the form NAME, NAME@FIRST-LAST (frames) or "
                "FIRST..LAST (scenes), such as curve-1..40"
            )
        prefix, first, last = match.groups()
        count = int(last) - int(first) + 1
        if len(names) + count > MOST_SCENES:
            raise GeoEvsError(
                f"scene '{text}' is a range of {count:,} scenes; a partition has {MOST_SCENES:,} "
                "at most, so name fewer"
            )
        names.extend(f"{prefix}{int(first) + n:0{len(first)}d}" for n in range(count))
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


class Placed(NamedTuple):
    """A scene of a partition: whose it is, as text, and the text parsed."""

    dataset: str
    partition: str
    text: str
    ref: SceneRef


def placed_scenes(dataset: str, partitions: Mapping[str, list[Any]]) -> list[Placed]:
    """Every scene of a data set's partitions, ranges and lists written out (see `expand_scenes`).

    Raises:
        GeoEvsError: a scene is not of the form NAME or NAME@FIRST-LAST.
    """
    return [
        Placed(dataset, partition, text, SceneRef.parse(text))
        for partition, texts in partitions.items()
        for text in expand_scenes(texts)
    ]


def check_partitions(placed: Iterable[Placed]) -> None:
    """Check that no frame of data sets of one source serves two partitions.

    But those that train may share frames, and so may the same partition of two data sets, for
    instance at other options.

    Raises:
        SettingError: two scenes share a frame; the sentence names both and their partitions.
    """
    by_name: dict[str, list[Placed]] = {}
    for scene in placed:
        by_name.setdefault(scene.ref.name, []).append(scene)
    for scenes in by_name.values():
        _check_frames(scenes)


def _check_frames(scenes: list[Placed]) -> None:
    """Each range of a scene's frames against the one of every partition that reaches furthest."""
    furthest: dict[tuple[str, str], Placed] = {}
    for scene in sorted(scenes, key=lambda scene: scene.ref.first or 0):
        for other in furthest.values():
            if scene.ref.overlaps(other.ref) and not _may_share(other, scene):
                raise _shared(other, scene)
        place = scene.dataset, scene.partition
        if place not in furthest or _last(scene) > _last(furthest[place]):
            furthest[place] = scene


def _last(scene: Placed) -> float:
    return math.inf if scene.ref.last is None else scene.ref.last


def _may_share(one: Placed, other: Placed) -> bool:
    training = {one.partition, other.partition} == set(TRAINING_PARTITIONS)
    return training or (one.partition == other.partition and one.dataset != other.dataset)


def _shared(one: Placed, other: Placed) -> SettingError:
    first, second = (one, other) if one.dataset == other.dataset else (other, one)
    rest = (
        f"'{second.text}'"
        if one.dataset == other.dataset
        else f"data set '{second.dataset}', of the same source, has '{second.text}'"
    )
    return SettingError(
        (first.dataset, "partitions"),
        f"data set '{first.dataset}' has scene '{first.text}' in partition '{first.partition}' and "
        f"{rest} in '{second.partition}'; a frame may serve one partition only, so remove one",
    )
