"""Waymo's boxes as tracks: from the vehicle's axes to the world, with one rule for what moves."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.checks import check_tracks
from geoevs.scenes.scene import TRACK_COLUMNS
from geoevs.scenes.sources.conventions import MOVING_SPEED, mark_moving
from geoevs.scenes.sources.waymo.segment import CAMERAS, LABELS, FrameLabels, Label

Origin = tuple[float, float, float]


def read_tracks(
    frames: Mapping[int, FrameLabels], origin: Origin
) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """The boxes of frames at their own instants, and those at the instants of cameras.

    Args:
        frames: poses and boxes by frame.
        origin: metres that are subtracted.

    Returns:
        Boxes with TRACK_COLUMNS; and boxes with `camera` besides, None where the data have none.

    Raises:
        GeoEvsError: a box is impossible (see `check_tracks`), or of a type that there is not.
    """
    boxes, synced = [], []
    for frame, drawn in frames.items():
        boxes.append(_boxes(frame, drawn, [(label, label.box) for label in drawn.labels], origin))
        seen = [
            (label, label.synced)
            for label in drawn.labels
            if label.synced is not None and label.camera
        ]
        cameras = [CAMERAS[label.camera - 1] for label, _ in seen]
        synced.append(_boxes(frame, drawn, seen, origin).assign(camera=cameras))
    tracks = pd.concat(boxes, ignore_index=True)
    tracks = mark_moving(tracks, tracks["speed"].to_numpy() >= MOVING_SPEED)
    shown = pd.concat(synced, ignore_index=True)
    if not len(shown):
        return tracks[list(TRACK_COLUMNS)], None
    moving = tracks.groupby("track")["moving"].first()
    shown["moving"] = shown["track"].map(moving).astype(bool)
    return tracks[list(TRACK_COLUMNS)], shown[[*TRACK_COLUMNS, "camera"]]


def _boxes(
    frame: int,
    drawn: FrameLabels,
    boxes: Sequence[tuple[Label, Sequence[float]]],
    origin: Origin,
) -> pd.DataFrame:
    labels = [label for label, _ in boxes]
    for label in labels:
        if not 0 <= label.kind < len(LABELS):
            raise GeoEvsError(
                f"{drawn.where}: a box is of type {label.kind}, and there are 0 to "
                f"{len(LABELS) - 1} ({', '.join(LABELS)}); download the file again"
            )
    numbers = np.array([box for _, box in boxes], np.float64).reshape(-1, 7)  # [N, 7]
    with np.errstate(invalid="ignore", over="ignore"):  # NaN and the like are refused below
        places = numbers[:, :3] @ drawn.pose[:3, :3].T + drawn.pose[:3, 3] - origin
        heading = numbers[:, 6]
        ahead = np.stack([np.cos(heading), np.sin(heading)]).T @ drawn.pose[:2, :2].T  # [N, 2]
    table = pd.DataFrame(
        {
            "frame": np.full(len(labels), frame, np.int64),
            "track": pd.Series([label.track for label in labels], dtype=object),
            "label": pd.Series([LABELS[label.kind] for label in labels], dtype=object),
            **dict(zip("xyz", places.T, strict=True)),
            **dict(zip(("length", "width", "height"), numbers[:, 3:6].T, strict=True)),
            "yaw": np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0])),
            "moving": np.zeros(len(labels), bool),
            "speed": np.array([np.hypot(*label.speed) for label in labels], np.float64),
        }
    )
    return check_tracks(table, drawn.where)
