"""Rows of predicted and of labelled boxes, from Parquet files or Waymo's `Objects`, checked."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.parquet import read_parquet
from geoevs.core.text import clean
from geoevs.detection import objects
from geoevs.detection.rules import (
    CLASSES,
    LEVEL_1,
    LEVEL_2,
    MOST_POINTS_OF_LEVEL_2,
    Rules,
)
from geoevs.scenes.camera import WORLD_LIMIT

BOX = ("x", "y", "z", "length", "width", "height", "heading")
"""Columns of a box, in the order of arrays of boxes (see `geoevs.detection.iou`)."""

_PLACED = {"scene": "string", "frame": "int64", "class": "string", **dict.fromkeys(BOX, "float64")}

PREDICTION_TYPES = {**_PLACED, "score": "float64", "ignored": "int64"}
"""Columns of predictions: `score` lies in [0, 1]; `ignored` is 1 for what overlaps with a zone
without labels, and so is no false positive, and else 0."""

TRUTH_TYPES = {**_PLACED, "points": "int64", "camera": "string", "level": "int64"}
"""Columns of truths: LiDAR `points` in the box; the `camera` that sees it best, empty if none does;
its `level`, 1 or 2 as annotated, 0 if its points decide."""

MOST_TURNS = 2
"""Full turns of a heading, at most; more are degrees."""

NO_CLASS, NO_POINTS, UNSEEN = "of no known class", "without LiDAR points", "seen by no camera"
LEFT_OUT = (NO_CLASS, NO_POINTS, UNSEEN)
"""Why a truth does not count, the first that applies."""

FRAME = ["scene", "frame"]
"""Columns that say which frame a box is of."""


def read_predictions(path: Path) -> pd.DataFrame:
    """Predicted boxes, of a Parquet file (`.parquet`) or an `Objects` file (any other name).

    Returns:
        The columns of PREDICTION_TYPES; `class` is empty for objects of none of CLASSES.

    Raises:
        GeoEvsError: the file is missing or damaged, or a row has a box that is none, an unknown
            class, a score outside [0, 1] or an `ignored` that is neither 0 nor 1.
    """
    if path.suffix == ".parquet":
        rows = _named(read_parquet(path, PREDICTION_TYPES), path)
    else:
        rows = objects.read_predictions(path)
    rows = _checked(rows, PREDICTION_TYPES, path)
    _refuse(rows, ~rows["score"].between(0, 1), "score", "scores lie in [0, 1]", path)
    _refuse(rows, ~rows["ignored"].isin([0, 1]), "ignored", "it is 0 or 1", path)
    return rows


def read_truths(path: Path, rules: Rules) -> pd.DataFrame:
    """Labelled boxes, of a Parquet file (`.parquet`) or an `Objects` file (any other name).

    Returns:
        The columns of TRUTH_TYPES; `class` is empty for objects of none of CLASSES. Of an `Objects`
        file, boxes and points are those that the rules ask for (see `objects.read_truths`).

    Raises:
        GeoEvsError: the file is missing or damaged, or a row has a box that is none, an unknown
            class or another level than 0, 1 or 2.
    """
    if path.suffix == ".parquet":
        rows = _named(read_parquet(path, TRUTH_TYPES), path)
    else:
        rows = objects.read_truths(path, rules.tolerance is not None)
    rows = _checked(rows, TRUTH_TYPES, path)
    levels = [0, LEVEL_1, LEVEL_2]
    _refuse(rows, ~rows["level"].isin(levels), "level", "it is 1, 2, or 0 for unknown", path)
    return rows


def _named(rows: pd.DataFrame, path: Path) -> pd.DataFrame:
    for name in rows["class"].unique():
        if name not in CLASSES:
            raise GeoEvsError(
                f"{path}: there is no class '{clean(name, 60)}'; {did_you_mean(name, CLASSES)}"
            )
    return rows


def _checked(rows: pd.DataFrame, types: Mapping[str, str], path: Path) -> pd.DataFrame:
    """Rows with the columns of `types` alone, whose boxes may be true."""
    rows = rows.reindex(columns=list(types)).astype(dict(types))
    for name in BOX:
        beyond = ~(rows[name].abs() <= WORLD_LIMIT)
        rule = f"boxes are metres in the vehicle's frame, within {WORLD_LIMIT / 1000:g} km"
        _refuse(rows, beyond, name, rule, path)
    turned = rows["heading"].abs() > MOST_TURNS * 2 * np.pi
    _refuse(rows, turned, "heading", "headings are radians, not degrees", path)
    return rows


def _refuse(rows: pd.DataFrame, wrong: pd.Series, column: str, rule: str, path: Path) -> None:
    """Name the first wrong row, counted from 0."""
    places = np.flatnonzero(wrong)
    if len(places):
        value = rows[column].iloc[places[0]]
        more = f", and {len(places) - 1} more rows are wrong" if len(places) > 1 else ""
        raise GeoEvsError(f"{path}: row {places[0]} has the {column} {value}; {rule}{more}")


def scored_truths(
    truths: pd.DataFrame, rules: Rules, path: Path
) -> tuple[pd.DataFrame, dict[str, int]]:
    """The truths that count, and how many do not by reason.

    Boxes without LiDAR points are left out, and under LET metrics those that no camera sees. Who
    has no annotated level gets one by its points.

    Args:
        truths: rows of TRUTH_TYPES.
        rules: for whose metrics.
        path: where they come from, for errors.

    Raises:
        GeoEvsError: none is left.
    """
    reasons = why_left_out(truths, rules)
    left = reasons == ""
    found = reasons.value_counts()
    counts = {reason: int(found[reason]) for reason in LEFT_OUT if reason in found}
    if not left.any():
        why = " and ".join(f"{count} {reason}" for reason, count in counts.items())
        raise GeoEvsError(
            f"none of the {len(truths)} truths of {path} counts{': ' if why else ''}{why}; fill in "
            "classes, points and cameras as docs/detection.md says"
        )
    kept = truths[left]
    level = level_by_points(kept["points"].to_numpy())
    return kept.assign(level=kept["level"].where(kept["level"] > 0, level)), counts


def why_left_out(truths: pd.DataFrame, rules: Rules) -> pd.Series:
    """The first of LEFT_OUT by which each truth does not count; empty for those that do.

    Args:
        truths: rows with `class`, `points` and `camera` of TRUTH_TYPES.
        rules: for whose metrics.
    """
    applies = {NO_CLASS: truths["class"] == "", NO_POINTS: truths["points"] <= 0}
    if rules.tolerance is not None:
        applies[UNSEEN] = truths["camera"] == ""
    reasons = np.select(list(applies.values()), list(applies), default="")
    return pd.Series(reasons, index=truths.index, dtype=object)


def level_by_points(points: np.ndarray) -> np.ndarray:
    """(N,) int64: the level of boxes with so many LiDAR points, unless somebody decided it."""
    return np.where(points <= MOST_POINTS_OF_LEVEL_2, LEVEL_2, LEVEL_1)


def check_frames(
    predictions: pd.DataFrame, truths: pd.DataFrame, paths: tuple[Path, Path]
) -> list[str]:
    """What is to be said of frames that only one of two files has, in sentences.

    Args:
        predictions: rows of PREDICTION_TYPES.
        truths: rows of TRUTH_TYPES, before any is left out.
        paths: where predictions and truths come from.

    Raises:
        GeoEvsError: no predicted frame has a truth, though there are predictions.
    """
    seen, there = (
        set(rows[FRAME].itertuples(index=False, name=None)) for rows in (predictions, truths)
    )
    if seen and there and not seen & there:
        one, other = (f"'{clean(scene, 80)}' at {at}" for scene, at in (min(seen), min(there)))
        raise GeoEvsError(
            f"none of the {len(seen)} frames of {paths[0]} has a truth in {paths[1]} (the first "
            f"are {one} and {other}); scene (context_name) and frame (timestamp) must be the same "
            "in both"
        )
    sentences = []
    if alone := len(seen - there):
        sentences.append(
            f"No truth for {alone} of {len(seen)} frames: all that is predicted there is false."
        )
    if missing := len(there - seen):
        sentences.append(
            f"No prediction for {missing} of {len(there)} frames: all that is there is missed."
        )
    return sentences
