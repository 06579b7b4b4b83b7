"""nuScenes' annotations as tracks: one box a keyframe and instance."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.checks import check_tracks
from geoevs.scenes.scene import TRACK_COLUMNS
from geoevs.scenes.sources.conventions import MOVING_SPEED, mark_moving
from geoevs.scenes.sources.nuscenes.tables import Record, Table

MOVES = {
    "vehicle.moving": True,
    "vehicle.stopped": False,
    "vehicle.parked": False,
    "pedestrian.moving": True,
    "pedestrian.standing": False,
    "pedestrian.sitting_lying_down": False,
}
"""What an attribute says of a box at its instant. Those of cycles say whether somebody rides, and
things have none: there, speed decides."""

NUMBERS = ("x", "y", "z", "length", "width", "height", "yaw", "seconds")

ELSEWHERE = -1
"""The frame of boxes that count only for what moves."""


def read_tracks(
    folder: Path,
    samples: Mapping[str, Record],
    frames: Mapping[str, int],
    origin: tuple[float, float, float],
) -> pd.DataFrame:
    """The boxes of a scene's keyframes, with TRACK_COLUMNS.

    Args:
        folder: of the tables.
        samples: all of the scene, so that what moves in one of them moves in each.
        frames: numbers of those whose boxes are wanted, by sample.
        origin: metres that are subtracted from positions.

    Raises:
        GeoEvsError: a table is missing or broken, or a box cannot be (see `check_tracks`); the
            sentence names the record.
    """
    annotations = Table(folder, "sample_annotation", "sample_token", samples)
    wanted = {annotation.text("instance_token") for annotation in annotations.values()}
    instances = Table(folder, "instance", "token", wanted)
    categories = Table(folder, "category")
    attributes = {
        token: attribute.text("name") for token, attribute in Table(folder, "attribute").items()
    }
    seconds = {token: sample.seconds for token, sample in samples.items()}
    rows = []
    for annotation in annotations.values():
        instance = instances.named(annotation, "instance_token")
        x, y, z = annotation.array("translation", (3,)) - origin
        width, length, height = annotation.array("size", (3,))
        forward = annotation.rotation[:, 0]
        sample = annotation.text("sample_token")
        rows.append(
            {
                "frame": frames.get(sample, ELSEWHERE),
                "track": instance.text("token"),
                "label": categories.named(instance, "category_token").text("name"),
                **{"x": x, "y": y, "z": z, "length": length, "width": width, "height": height},
                "yaw": np.degrees(np.arctan2(forward[1], forward[0])),
                "said": _said(annotation, attributes),
                "seconds": seconds[sample],
                "where": annotation.where,
            }
        )
    columns = ["frame", "track", "label", *NUMBERS, "said", "where"]
    boxes = pd.DataFrame(rows, columns=columns).astype(dict.fromkeys(NUMBERS, float))
    boxes = mark_moving(boxes, _moves(boxes))
    boxes = boxes[boxes["frame"] != ELSEWHERE].sort_values(
        "frame", kind="stable", ignore_index=True
    )
    _check(boxes, annotations.path)
    return boxes[list(TRACK_COLUMNS)]


def _said(annotation: Record, attributes: Mapping[str, str]) -> bool | None:
    """Whether a box moves, by its attributes; None where they do not say."""
    for token in annotation.texts("attribute_tokens"):
        if token not in attributes:
            raise GeoEvsError(
                f"{annotation.where} names an attribute that attribute.json does not have; "
                "download both tables again"
            )
        if attributes[token] in MOVES:
            return MOVES[attributes[token]]
    return None


def _moves(boxes: pd.DataFrame) -> np.ndarray:
    """(N,) bool: by what attributes say, else by the way since the track's last box."""
    ways = boxes.sort_values("seconds").groupby("track")[["x", "y", "seconds"]].diff()
    fast = np.hypot(ways["x"], ways["y"]) > MOVING_SPEED * ways["seconds"]  # not a track's first
    return boxes["said"].astype("boolean").fillna(fast.reindex(boxes.index)).to_numpy(bool)


def _check(boxes: pd.DataFrame, path: Path) -> None:
    """Check the boxes, and find the record at fault."""
    try:
        check_tracks(boxes, path)
    except GeoEvsError:
        for place, where in enumerate(boxes["where"]):
            check_tracks(boxes.iloc[[place]], where)
        raise
