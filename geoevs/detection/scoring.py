"""From rows of boxes to rows of counts, frame by frame."""

from pathlib import Path

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.core.parquet import read_parquet
from geoevs.core.text import clean
from geoevs.detection.counts import FIELDS, SHARD, WHOLE, count_frame, shards_of
from geoevs.detection.frames import Predictions, Truths
from geoevs.detection.rows import (
    BOX,
    FRAME,
    check_frames,
    read_predictions,
    read_truths,
    scored_truths,
)
from geoevs.detection.rules import CAMERA, CAMERAS, CLASSES, CUTOFFS, RULES, Rules

COUNT_TYPES = {
    "scene": "string",
    "frame": "int64",
    "rules": "string",
    **dict.fromkeys(SHARD, "string"),
    "level": "int64",
    "cutoff": "float64",
    **{name: "int64" if name in WHOLE else "float64" for name in FIELDS},
}
"""Columns of rows of counts. A row that would hold zeros alone is not written."""


def score_files(predictions: Path, truths: Path, rules: Rules) -> tuple[pd.DataFrame, list[str]]:
    """Rows of COUNT_TYPES of two files, and what is to be said of them, in sentences.

    Raises:
        GeoEvsError: a file is missing or damaged or holds what cannot be (see `read_predictions`
            and `read_truths`), no truth counts, or no predicted frame has one.
    """
    found, there = read_predictions(predictions), read_truths(truths, rules)
    counted, left_out = scored_truths(there, rules, truths)
    remarks = check_frames(found, there, (predictions, truths))
    remarks += [f"Left out: {count} truths {reason}." for reason, count in left_out.items()]
    if unknown := int((found["class"] == "").sum()):
        remarks.append(f"Left out: {unknown} predictions of no known class.")
    elsewhere = int((~counted["camera"].isin(CAMERAS)).sum())
    if CAMERA in rules.breakdowns and elsewhere:
        remarks.append(f"In no camera's rows: {elsewhere} truths that other cameras see best.")
    return detection_counts(found, counted, rules), remarks


def detection_counts(predictions: pd.DataFrame, truths: pd.DataFrame, rules: Rules) -> pd.DataFrame:
    """Rows of COUNT_TYPES of all frames that have a prediction or a truth.

    Args:
        predictions: rows of PREDICTION_TYPES (`geoevs.detection.rows`).
        truths: rows of TRUTH_TYPES, those that `scored_truths` leaves.
        rules: for whose metrics.

    Raises:
        GeoEvsError: there is neither a prediction nor a truth.
    """
    predictions, truths = (rows[rows["class"] != ""] for rows in (predictions, truths))
    if predictions.empty and truths.empty:
        raise GeoEvsError("there is neither a prediction nor a truth; give rows of either")
    seen, there = predictions.groupby(FRAME).indices, truths.groupby(FRAME).indices
    everything, labels = _predictions(predictions), _truths(truths)
    none = np.zeros(0, int)
    parts = []
    for scene, frame in sorted({*seen, *there}):
        key = (scene, frame)
        counts = count_frame(
            everything.take(seen.get(key, none)), labels.take(there.get(key, none)), rules
        )
        shard, level, cutoff = np.nonzero(counts.any(axis=-1))
        place = {"scene": scene, "frame": frame, "shard": shard, "level": level, "cutoff": cutoff}
        values = dict(zip(FIELDS, counts[shard, level, cutoff].T, strict=True))
        parts.append(pd.DataFrame(place | values))
    return _named(pd.concat(parts, ignore_index=True), rules)


def _predictions(rows: pd.DataFrame) -> Predictions:
    scores, ignored = rows["score"].to_numpy(), rows["ignored"].to_numpy() != 0
    return Predictions(rows[list(BOX)].to_numpy(float), _classes(rows), scores, ignored)


def _truths(rows: pd.DataFrame) -> Truths:
    levels, cameras = rows["level"].to_numpy(), rows["camera"].to_numpy(object)
    return Truths(rows[list(BOX)].to_numpy(float), _classes(rows), levels, cameras)


def _classes(rows: pd.DataFrame) -> np.ndarray:
    return pd.Index(CLASSES).get_indexer(rows["class"])


def _named(rows: pd.DataFrame, rules: Rules) -> pd.DataFrame:
    """Rows of COUNT_TYPES, whose shards, levels and cutoffs were places in their lists."""
    shards = np.array(shards_of(rules), object)[rows["shard"].to_numpy()]
    rows = rows.assign(
        rules=rules.name,
        level=np.array(rules.levels)[rows["level"]],
        cutoff=CUTOFFS[rows["cutoff"]],
        **dict(zip(SHARD, shards.T, strict=True)),
    )
    return rows[list(COUNT_TYPES)].astype(COUNT_TYPES)


def read_counts(path: Path) -> pd.DataFrame:
    """Rows of COUNT_TYPES that were written as a Parquet file.

    Raises:
        GeoEvsError: the file is missing, damaged or empty, its rows are of several or unknown
            rules, or a row is of what its rules do not count or holds no count.
    """
    rows = read_parquet(path, COUNT_TYPES)
    names = list(rows["rules"].unique())
    if len(names) != 1 or names[0] not in RULES:
        shown = ", ".join(clean(name, 60) for name in names[:5])
        raise GeoEvsError(
            f"{path} has counts by the rules '{shown}'; give counts by one of {', '.join(RULES)}"
        )
    values = rows[list(FIELDS)].to_numpy(float)
    if not (np.isfinite(values) & (values >= 0)).all() or min(map(min, _codes(rows))) < 0:
        raise GeoEvsError(
            f"{path} has rows that are no counts by the rules '{names[0]}'; make it again"
        )
    return rows


def scene_sums(rows: pd.DataFrame) -> np.ndarray:
    """(N, S, L, C, F) float64: FIELDS summed over the frames of every scene, by its name.

    Shards, levels and cutoffs are in the order of `shards_of`, of the rules and of CUTOFFS.

    Args:
        rows: rows of COUNT_TYPES, by the same rules.
    """
    rules = RULES[rows["rules"].iloc[0]]
    scenes, _ = pd.factorize(rows["scene"], sort=True)
    places = (scenes, *_codes(rows))
    shape = (scenes.max() + 1, len(shards_of(rules)), len(rules.levels), len(CUTOFFS), len(FIELDS))
    sums = np.zeros(shape)
    np.add.at(sums, places, rows[list(FIELDS)].to_numpy(float))
    return sums


def _codes(rows: pd.DataFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The places of rows' shards, levels and cutoffs in their lists; -1 of what is in none."""
    rules = RULES[rows["rules"].iloc[0]]
    shards = pd.MultiIndex.from_tuples(shards_of(rules))
    shard = shards.get_indexer(pd.MultiIndex.from_frame(rows[SHARD].astype(object)))
    level = pd.Index(rules.levels).get_indexer(rows["level"])
    return shard, level, pd.Index(CUTOFFS).get_indexer(rows["cutoff"])
