"""PandaSet's cuboids as tracks: one box a frame and object, heading along its length."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.checks import check_tracks
from geoevs.scenes.scene import TRACK_COLUMNS
from geoevs.scenes.sources.conventions import mark_moving
from geoevs.scenes.sources.pandaset.unpickle import check_numbers, read_table

# Where PandaSet keeps each number; a box's y side is its length, its x side its width.
NUMBERS = {
    "x": "position.x",
    "y": "position.y",
    "z": "position.z",
    "length": "dimensions.y",
    "width": "dimensions.x",
    "height": "dimensions.z",
    "yaw": "yaw",
}
SENSOR, SIBLING = "cuboids.sensor_id", "cuboids.sibling_id"
FRONT_LIDAR = 1
SENSORS = (-1, 0, 1)  # -1 is none, of a box that both sensors share
COLUMNS = ("uuid", "label", "stationary", SENSOR, SIBLING, *NUMBERS.values())


def read_tracks(
    folder: Path, frames: Iterable[int], origin: tuple[float, float, float]
) -> pd.DataFrame:
    """The boxes of `frames` from `folder`/NN.pkl.gz, with TRACK_COLUMNS, less `origin` in metres.

    A moving object that both LiDARs see is boxed twice, once for each sensor's instant. The pair is
    one track, under the Pandar64 box's uuid, and the Pandar64 box is kept where a frame has both.

    Raises:
        GeoEvsError: a file is missing, unreadable (see `read_table`), lacks a column, or has boxes
            that cannot be (see `check_tracks`).
    """
    boxes = pd.concat([_read_frame(folder, frame, origin) for frame in frames], ignore_index=True)
    paired = boxes["from_front_lidar"] & boxes["sibling"].isin(boxes["track"])
    boxes["track"] = boxes["track"].where(~paired, boxes["sibling"])
    boxes = mark_moving(boxes, boxes["moving"].to_numpy(bool))
    boxes = boxes.sort_values(["frame", "from_front_lidar"], kind="stable")
    boxes = boxes.drop_duplicates(["frame", "track"])
    return boxes[list(TRACK_COLUMNS)].reset_index(drop=True)


def _read_frame(folder: Path, frame: int, origin: tuple[float, float, float]) -> pd.DataFrame:
    path = folder / f"{frame:02d}.pkl.gz"
    table = read_table(path)
    for column in COLUMNS:
        if column not in table:
            raise GeoEvsError(f"{path} has no column '{column}'; download it again")
    check_numbers(table, (*NUMBERS.values(), SENSOR), path)
    numbers = {name: table[column].to_numpy(np.float64) for name, column in NUMBERS.items()}
    for name, metres in zip("xyz", origin, strict=True):
        numbers[name] = numbers[name] - metres
    for column, kind, what in (
        ("uuid", str, "text"),
        ("label", str, "text"),
        (SIBLING, str, "text"),
        ("stationary", bool | np.bool_, "true or false"),
    ):
        if not all(isinstance(value, kind) for value in table[column]):
            raise GeoEvsError(f"{path} has a '{column}' that is not {what}; download it again")
    if not table[SENSOR].isin(SENSORS).all():
        raise GeoEvsError(f"{path} has boxes whose {SENSOR} is not -1, 0 or 1; download it again")
    numbers["yaw"] = np.degrees(numbers["yaw"])
    boxes = pd.DataFrame(
        {
            "frame": frame,
            "track": table["uuid"].astype(str),
            "sibling": table[SIBLING].astype(str),
            "label": table["label"].astype(str),
            **numbers,
            "moving": ~table["stationary"].astype(bool),
            "from_front_lidar": table[SENSOR] == FRONT_LIDAR,
        }
    )
    check_tracks(boxes, path)
    # PandaSet's yaw is 0 along world y; ours along world x, as atan2 has it.
    boxes["yaw"] = (boxes["yaw"] + 90 + 180) % 360 - 180
    return boxes
