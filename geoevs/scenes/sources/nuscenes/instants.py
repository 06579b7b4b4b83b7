"""A scene's instants: which image of each camera and which LiDAR sweep belong together."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.text import clean
from geoevs.scenes.sources.nuscenes.tables import Record, Table

CAMERAS = (
    "CAM_FRONT",
    "CAM_FRONT_LEFT",
    "CAM_FRONT_RIGHT",
    "CAM_BACK",
    "CAM_BACK_LEFT",
    "CAM_BACK_RIGHT",
)
LIDAR = "LIDAR_TOP"
CHANNELS = (*CAMERAS, LIDAR)

TURN = 0.05
"""Seconds of a turn of the LiDAR, 20 a second."""


class Reading(NamedTuple):
    """What a sensor recorded at one instant, by the records that say so."""

    data: Record
    sensor: Record
    """Of `calibrated_sensor`: where it is on the car."""
    ego: Record
    """Of `ego_pose`: where the car was at the time of `data`."""


@dataclass(frozen=True)
class Instant:
    """An image of each camera and a LiDAR sweep; `sample` is the token of a keyframe's sample."""

    sample: str | None
    readings: Mapping[str, Reading]  # by channel


@dataclass(frozen=True)
class Recording:
    """A scene: its samples by token and its instants, both in the order of time."""

    samples: Mapping[str, Record]
    instants: Sequence[Instant]


class _Shot(NamedTuple):
    """A record of `sample_data`, with its sensor's place on the car and its seconds."""

    data: Record
    sensor: Record
    seconds: float


Shots = Mapping[str, _Shot]
"""What belongs to one instant, by channel."""


def read_recording(folder: Path, name: str, sweeps: bool) -> Recording:
    """Find what belongs to a scene in the tables.

    Args:
        folder: of the tables, such as v1.0-mini.
        name: of the scene.
        sweeps: whether instants between keyframes are wanted too (see `_between`).

    Raises:
        GeoEvsError: a table is missing or broken, there is no such scene, or a record points to
            one that is not there; the sentence names the file and the record.
    """
    scene = _find_scene(Table(folder, "scene"), name)
    table = Table(folder, "sample", "scene_token", {scene.text("token")})
    samples = {sample.text("token"): sample for sample in _chain(scene, table)}
    shots = _shots(folder, samples)
    keyframes = _keyframes(samples, shots)
    chosen: list[tuple[str | None, Shots]] = list(zip(samples, keyframes, strict=True))
    if sweeps:
        chosen += [(None, between) for between in _between(keyframes, shots)]
        chosen.sort(key=lambda instant: instant[1][LIDAR].seconds)
    wanted = {
        shot.data.text("ego_pose_token") for _, instant in chosen for shot in instant.values()
    }
    poses = Table(folder, "ego_pose", "token", wanted)
    instants = [
        Instant(
            sample,
            {
                channel: Reading(shot.data, shot.sensor, poses.named(shot.data, "ego_pose_token"))
                for channel, shot in instant.items()
            },
        )
        for sample, instant in chosen
    ]
    return Recording(samples, instants)


def _find_scene(scenes: Table, name: str) -> Record:
    found = [scene for scene in scenes.values() if scene.text("name") == name]
    if not found:
        names = (clean(scene.text("name"), 40) for scene in scenes.values())
        raise GeoEvsError(f"{scenes.path} has no scene '{name}'; {did_you_mean(name, names)}")
    if len(found) > 1:
        raise GeoEvsError(f"{found[1].where} is another scene '{name}'; download the table again")
    return found[0]


def _chain(scene: Record, samples: Table) -> Iterator[Record]:
    """The samples of a scene, each of which names the next one."""
    sample = samples.named(scene, "first_sample_token")
    seen: set[str] = set()
    while True:
        seen.add(sample.text("token"))
        yield sample
        if not sample.text("next"):
            break
        sample, before = samples.named(sample, "next"), sample
        if sample.text("token") in seen:
            raise GeoEvsError(
                f"{before.where} names a sample before it as the next one, so that the scene never "
                "ends; download the table again"
            )
    if len(seen) != len(samples):
        raise GeoEvsError(
            f"{sample.where} names no next sample, but the scene has {len(samples) - len(seen)} "
            "more; download the table again"
        )


def _shots(folder: Path, samples: Mapping[str, Record]) -> dict[str, list[_Shot]]:
    """What the cameras and the LiDAR recorded during a scene, in the order of time."""
    data = Table(folder, "sample_data", "sample_token", samples)
    wanted = {record.text("calibrated_sensor_token") for record in data.values()}
    calibrated = Table(folder, "calibrated_sensor", "token", wanted)
    sensors = Table(folder, "sensor")
    shots = defaultdict(list)
    for record in data.values():
        sensor = calibrated.named(record, "calibrated_sensor_token")
        channel = sensors.named(sensor, "sensor_token").text("channel")
        if channel in CHANNELS:  # the others are radars
            shots[channel].append(_Shot(record, sensor, record.seconds))
    return {channel: sorted(shots[channel], key=lambda shot: shot.seconds) for channel in CHANNELS}


def _keyframes(samples: Mapping[str, Record], shots: Mapping[str, list[_Shot]]) -> list[Shots]:
    """What belongs to each sample."""
    found: dict[str, dict[str, _Shot]] = {token: {} for token in samples}
    for channel in CHANNELS:
        for shot in shots[channel]:
            if not shot.data.flag("is_key_frame"):
                continue
            keyframe = found[shot.data.text("sample_token")]
            if channel in keyframe:
                raise GeoEvsError(
                    f"{shot.data.where} is a second keyframe of {channel} for one sample; download "
                    "the table again"
                )
            keyframe[channel] = shot
        for token, sample in samples.items():
            if channel not in found[token]:
                raise GeoEvsError(
                    f"{sample.where} has no keyframe of {channel} in sample_data.json; download "
                    "both tables again"
                )
    return list(found.values())


def _between(keyframes: Sequence[Shots], shots: Mapping[str, list[_Shot]]) -> list[Shots]:
    """The LiDAR sweeps between keyframes of which every camera took an image.

    A camera is triggered when the LiDAR's beam passes it, always as long before the sweep's
    timestamp, but not in every turn. An image therefore belongs to the sweep that is nearest to its
    time plus this lag, the median over keyframes.
    """
    first, last = keyframes[0][LIDAR].seconds, keyframes[-1][LIDAR].seconds
    sweeps = [shot for shot in _sweeps(shots[LIDAR]) if first < shot.seconds < last]
    instants = [{LIDAR: sweep} for sweep in sweeps]
    ends = np.array([sweep.seconds for sweep in sweeps])
    for camera in CAMERAS if sweeps else ():
        lag = np.median([shot[LIDAR].seconds - shot[camera].seconds for shot in keyframes])
        for image in _sweeps(shots[camera]):
            away = np.abs(ends - (image.seconds + lag))
            nearest = int(np.argmin(away))
            if away[nearest] < TURN / 2:
                instants[nearest][camera] = image
    return [instant for instant in instants if len(instant) == len(CHANNELS)]


def _sweeps(shots: Sequence[_Shot]) -> list[_Shot]:
    return [shot for shot in shots if not shot.data.flag("is_key_frame")]
