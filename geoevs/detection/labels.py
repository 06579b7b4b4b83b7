"""Labels of a scene: its boxes in the vehicle's frame, and which of them count, or why not.

Detectors are trained on the labels that count, and scored by the same ones.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.core.parquet import read_parquet
from geoevs.core.text import clean
from geoevs.detection.rows import (
    BOX,
    LEFT_OUT,
    TRUTH_TYPES,
    level_by_points,
    why_left_out,
)
from geoevs.detection.rules import LET
from geoevs.projection import project_points
from geoevs.scenes.boxes import Box
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import PointCloud
from geoevs.scenes.store import Scene

CAMERA_HEIGHT = 2.0
"""Metres of the vehicle's origin below its front camera, about where the ground is. Cameras of
driving data are mounted 1.5 to 2.1 m above it."""

TOP_LIDAR = 0
"""The sensor whose points count: LET metrics ask for those of the LiDAR on the roof."""

OUT_OF_RANGE = "out of range"

REASONS = (*LEFT_OUT, OUT_OF_RANGE)
"""Why a label does not count, the first that applies."""

LABEL_TYPES = {**TRUTH_TYPES, "track": "string", "label": "string", "reason": "string"}
"""Columns of labels: those of truths, `class` being empty where the config maps none; the `track`
and the `label` that its source gave it; one of REASONS, empty if it counts. `camera` is the store's
name of it."""

Bounds = Sequence[float]
"""x, y, z from and to, metres in the vehicle's frame: what a detector looks for."""


def world_from_vehicle(scene: Scene, frame: int) -> np.ndarray:
    """(4, 4) float64: the vehicle's frame in the world.

    x is the front camera's heading on the ground plane, y left, z up; the origin lies CAMERA_HEIGHT
    below that camera.
    """
    front = scene.camera(scene.info.rig.front, frame)
    return vehicle_pose(front)


def vehicle_pose(front: Camera) -> np.ndarray:
    """(4, 4) float64: the frame of the vehicle whose front camera this is, in the world."""
    heading = front.optical_axis[:2] / np.linalg.norm(front.optical_axis[:2])
    pose = np.eye(4)
    pose[:2, 0], pose[:2, 1] = heading, (-heading[1], heading[0])
    pose[:3, 3] = front.centre - (0, 0, CAMERA_HEIGHT)
    return pose


def scene_labels(
    scene: Scene, name: str, classes: Mapping[str, Sequence[str]], bounds: Bounds
) -> pd.DataFrame:
    """Rows of LABEL_TYPES of all boxes of a scene.

    Where its source knows where boxes were at the cameras' instants, those are the labels, and the
    camera is theirs; points are counted at the LiDAR's instant. Elsewhere the camera is the one in
    whose image the centre lies, the nearest to its axis.

    Args:
        scene: the store, boxes among it.
        name: the scene's name in rows.
        classes: the labels of the source by class.
        bounds: beyond which a box does not count.
    """
    class_of = {label: kind for kind, labels in classes.items() for label in labels}
    parts = [pd.DataFrame({column: pd.Series(dtype=kind) for column, kind in LABEL_TYPES.items()})]
    for frame in scene.frames:
        boxes = Box.rows(scene.tracks[scene.tracks["frame"] == frame])
        points = _count_points(boxes, scene.points(frame))
        boxes, cameras = _as_seen(scene, frame, boxes)
        table = pd.DataFrame(
            _in_vehicle(boxes, world_from_vehicle(scene, frame)), columns=list(BOX)
        )
        table = table.assign(
            **{"scene": name, "frame": frame, "points": points, "camera": cameras},
            **{"class": [class_of.get(box.label, "") for box in boxes]},
            track=[box.track for box in boxes],
            label=[box.label for box in boxes],
            level=level_by_points(points),
        )
        reason = why_left_out(table, LET)
        outside = (reason == "") & ~inside(table[list(BOX)].to_numpy(), bounds)
        parts.append(table.assign(reason=reason.mask(outside, OUT_OF_RANGE)))
    return pd.concat(parts, ignore_index=True)[list(LABEL_TYPES)].astype(LABEL_TYPES)


def inside(boxes: np.ndarray, bounds: Bounds) -> np.ndarray:
    """(N,) bool: boxes (N, 7) whose centres lie within bounds."""
    low, high = np.array(bounds[:3]), np.array(bounds[3:])
    return ((boxes[:, :3] >= low) & (boxes[:, :3] <= high)).all(axis=1)


def _count_points(boxes: Sequence[Box], cloud: PointCloud) -> np.ndarray:
    """(N,) int64: points of TOP_LIDAR in each box."""
    xyz = cloud.xyz[cloud.sensor == TOP_LIDAR].astype(np.float64)
    return np.array([int(box.holds(xyz).sum()) for box in boxes], np.int64)


def _as_seen(scene: Scene, frame: int, boxes: Sequence[Box]) -> tuple[list[Box], list[str]]:
    """Boxes where cameras saw them, and which camera sees each best, empty if none does."""
    if scene.synced_tracks is None:
        cameras = [scene.camera(name, frame) for name in scene.cameras]
        centres = np.array([box[3:6] for box in boxes], np.float64).reshape(-1, 3)
        return list(boxes), most_visible(centres, cameras)
    of_frame = scene.synced_tracks[scene.synced_tracks["frame"] == frame]
    cameras_of = dict(zip(of_frame["track"], of_frame["camera"], strict=True))
    synced = {box.track: box for box in Box.rows(of_frame)}
    return (
        [synced.get(box.track, box) for box in boxes],
        [cameras_of.get(box.track, "") for box in boxes],
    )


def most_visible(
    centres: np.ndarray,  # [N, 3] in the world
    cameras: Sequence[Camera],
) -> list[str]:
    """The camera in whose image each point lies nearest to the axis, by name; empty if in none."""
    best, names = np.full(len(centres), -np.inf), np.full(len(centres), "", object)
    for camera in cameras:
        uv, _ = project_points(centres, camera)
        with np.errstate(invalid="ignore"):
            seen = ((uv >= 0) & (uv < (camera.width, camera.height))).all(axis=1)
        apart = centres - camera.centre
        ahead = apart @ camera.optical_axis / np.maximum(np.linalg.norm(apart, axis=1), 1e-9)
        better = seen & (ahead > best)
        best[better], names[better] = ahead[better], camera.name
    return list(names)


def _in_vehicle(boxes: Sequence[Box], pose: np.ndarray) -> np.ndarray:
    """(N, 7) float64 as BOX: boxes of the world in the vehicle's frame."""
    if not boxes:
        return np.zeros((0, 7))
    centres = (np.array([box[3:6] for box in boxes]) - pose[:3, 3]) @ pose[:3, :3]
    sides = np.array([box[6:9] for box in boxes])
    turn = np.radians([box.yaw for box in boxes]) - np.arctan2(pose[1, 0], pose[0, 0])
    heading = np.mod(turn + np.pi, 2 * np.pi) - np.pi
    return np.concatenate([centres, sides, heading[:, None]], axis=1)


def read_labels(path: Path) -> pd.DataFrame:
    """Rows that `scene_labels` made and a Parquet file holds.

    Raises:
        GeoEvsError: the file is missing or damaged, or a reason is none of REASONS.
    """
    rows = read_parquet(path, LABEL_TYPES)
    unknown = ~rows["reason"].isin(["", *REASONS])
    if unknown.any():
        shown = clean(rows.loc[unknown, "reason"].iloc[0], 60)
        raise GeoEvsError(f"{path} has the reason '{shown}', which is none; make it again")
    return rows


def scored(labels: pd.DataFrame, what: str) -> pd.DataFrame:
    """The labels that count.

    Args:
        labels: rows of LABEL_TYPES.
        what: whose they are, for errors.

    Raises:
        GeoEvsError: there is none.
    """
    kept = labels[labels["reason"] == ""]
    if kept.empty:
        why = labels["reason"].value_counts(sort=False)
        said = ", ".join(f"{count} {reason}" for reason, count in why.items()) or "no boxes at all"
        raise GeoEvsError(
            f"no label of {what} counts ({said}); name scenes with boxes that cameras and LiDAR "
            "see, and their labels under detection.classes"
        )
    return kept
