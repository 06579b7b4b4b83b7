"""Waymo's `Objects` files, which its metric tools and leaderboards take.

They are messages of metrics.proto and label.proto of the Waymo Open Dataset.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import whole_file
from geoevs.core.protobuf import BYTES, VARINT, Message, damaged, read_key
from geoevs.detection.rules import CLASSES

OBJECT = {"label": 1, "score": 2, "ignored": 3, "context": 4, "timestamp": 5, "camera": 6}
LABEL = {
    **{"box": 1, "type": 3, "level": 5, "points": 7, "camera": 11},
    **{"synced_box": 12, "top_points": 13},
}
BOX = {"x": 1, "y": 2, "z": 3, "length": 5, "width": 4, "height": 6, "heading": 7}
"""The numbers of the fields that are read."""


def read_predictions(path: Path) -> pd.DataFrame:
    """An `Objects` file's columns of PREDICTION_TYPES (`geoevs.detection.rows`), unchecked.

    A missing score is 1, as in Waymo's message.

    Raises:
        GeoEvsError: the file is missing or no such message.
    """
    rows = []
    for found, label in _objects(path):
        score = found.float(OBJECT["score"]) if OBJECT["score"] in found.fields else 1.0
        ignored = int(found.whole(OBJECT["ignored"]) != 0)
        rows.append(
            _place(found, label) | _box(label, "box") | {"score": score, "ignored": ignored}
        )
    return pd.DataFrame(rows)


def read_truths(path: Path, tolerant: bool) -> pd.DataFrame:
    """An `Objects` file's columns of TRUTH_TYPES (`geoevs.detection.rows`), unchecked.

    Args:
        path: the file.
        tolerant: take what LET metrics take: boxes at the time when the camera saw them, and the
            points of the top LiDAR, which sees about what cameras see.

    Raises:
        GeoEvsError: the file is missing or no such message, or LET metrics are to be computed and a
            visible truth has no box synchronised with its camera.
    """
    box, points = ("synced_box", "top_points") if tolerant else ("box", "points")
    rows = []
    for found, label in _objects(path):
        camera = label.text(LABEL["camera"])
        row = _place(found, label) | _box(label, box)
        row |= {"points": _signed(label.whole(LABEL[points])), "camera": camera}
        row |= {"level": _signed(label.whole(LABEL["level"]))}
        if tolerant and camera and row["points"] > 0 and LABEL[box] not in label.fields:
            raise GeoEvsError(
                f"{label.where} names a camera that sees it but has no camera_synced_box; take "
                "labels of Waymo 1.3.2 or later"
            )
        rows.append(row)
    return pd.DataFrame(rows)


def _objects(path: Path) -> Iterator[tuple[Message, Message]]:
    """Every object of a file, and the label in it."""
    with whole_file(path):
        data = memoryview(path.read_bytes())
    at = number = 0
    while at < len(data):
        key = read_key(data, at, str(path))
        at = key.at + (0 if key.kind == VARINT else key.size)
        if at > len(data):
            raise damaged(str(path), f"it ends within object {number}")
        if key.number == 1:
            if key.kind != BYTES:
                raise damaged(str(path), f"object {number} is no message")
            found = Message(data[key.at : at], f"object {number} of {path}")
            yield found, found.message(OBJECT["label"])
            number += 1


def _place(found: Message, label: Message) -> dict[str, Any]:
    """Whose frame it is, and what it is."""
    scene = found.text(OBJECT["context"])
    if camera := found.whole(OBJECT["camera"]):  # of an image: its objects are a frame of their own
        scene = f"{scene}_{camera}"
    kind = label.whole(LABEL["type"])
    name = CLASSES[kind - 1] if 1 <= kind <= len(CLASSES) else ""
    return {"scene": scene, "frame": _signed(found.whole(OBJECT["timestamp"])), "class": name}


def _box(label: Message, name: str) -> dict[str, float]:
    box = label.message(LABEL[name])
    return {side: box.double(number) for side, number in BOX.items()}


def _signed(value: int) -> int:
    """A whole number that may be negative, of the 64 bits that hold it."""
    return value - 2**64 if value >= 2**63 else value
