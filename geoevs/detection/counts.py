"""Additive counts: what was right and wrong in a frame, by breakdown, class, bin, level and cutoff.

Sums of counts over frames are all that metrics derive from, so that intervals and other selections
of frames need no matching.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from geoevs.detection.frames import Predictions, Truths
from geoevs.detection.matching import Pairs, match_first, pair_up
from geoevs.detection.rules import (
    BINS,
    CAMERA,
    CAMERAS,
    CLASSES,
    CUTOFFS,
    HALF_FIELD_OF_VIEW,
    RANGE,
    RANGES,
    Rules,
)

WHOLE = ("truths", "predictions", "true_positives", "false_positives", "false_negatives", "flipped")
"""Fields of counts that are whole numbers."""

FIELDS = (*WHOLE, "heading_accuracy", "affinity")
"""What is counted: truths of the level; predictions above the cutoff; matches; predictions and
truths without one; matches whose heading is off by more than 90 degrees; and the sums over matches
of heading accuracy and affinity."""

OVERLAP = 0.01
"""The least IoU by which a prediction belongs to another camera's truth, so that it is no false
positive of this one."""


class Shard(NamedTuple):
    """A class within a bin of a breakdown; it is matched by itself."""

    breakdown: str
    label: str
    bin: str


SHARD = ["breakdown", "class", "bin"]
"""A shard's fields, as columns of rows are called."""


def shards_of(rules: Rules) -> list[Shard]:
    """All that the rules count, in the order of Waymo's tables."""
    return [
        Shard(breakdown, label, name)
        for breakdown in rules.breakdowns
        for label in CLASSES
        for name in BINS[breakdown]
    ]


def count_frame(predictions: Predictions, truths: Truths, rules: Rules) -> np.ndarray:
    """(S, L, C, F) float64: FIELDS of a frame, of `shards_of`, the rules' levels and CUTOFFS.

    Boxes are in the vehicle's frame. The order of predictions and of truths does not matter.
    """
    predictions, truths = predictions.ordered(), truths.ordered()
    pairs = pair_up(predictions, truths, rules)
    counts = np.zeros((len(shards_of(rules)), len(rules.levels), len(CUTOFFS), len(FIELDS)))
    for place, (seen, there, counted) in enumerate(_members(predictions, truths, rules)):
        if len(seen) or len(there):
            counts[place] = _count_shard(
                predictions.take(seen), truths.take(there), pairs.take(seen, there), counted, rules
            )
    return counts


class _Members(NamedTuple):
    predictions: np.ndarray  # [n] indices
    truths: np.ndarray  # [m] indices
    counted: np.ndarray  # [m] bool, truths of the bin itself


def _members(predictions: Predictions, truths: Truths, rules: Rules) -> Iterator[_Members]:
    """Who takes part in every shard.

    The bin of a type or a range holds a box by the box alone. In a camera, everything in its field
    of view is matched, but only truths that it sees best are counted.
    """
    for shard in shards_of(rules):
        index = CLASSES.index(shard.label)
        seen = np.flatnonzero((predictions.classes == index) & _in_bin(predictions.boxes, shard))
        there = np.flatnonzero((truths.classes == index) & _in_bin(truths.boxes, shard))
        counted = np.ones(len(there), bool)
        if shard.breakdown == CAMERA:
            counted = truths.cameras[there] == shard.bin
        yield _Members(seen, there, counted)


def _in_bin(boxes: np.ndarray, shard: Shard) -> np.ndarray:
    """(N,) bool: whose centres lie in a range or in a camera's field of view."""
    if shard.breakdown == RANGE:
        ends = list(RANGES.values())
        bin = np.searchsorted(ends, np.linalg.norm(boxes[:, :3], axis=1), side="right")
        return bin == list(RANGES).index(shard.bin)
    if shard.breakdown == CAMERA:
        bearing = np.degrees(np.arctan2(boxes[:, 1], boxes[:, 0]))
        return np.abs(bearing - CAMERAS[shard.bin]) < HALF_FIELD_OF_VIEW
    return np.ones(len(boxes), bool)


def _count_shard(
    predictions: Predictions, truths: Truths, pairs: Pairs, counted: np.ndarray, rules: Rules
) -> np.ndarray:
    """(L, C, F): FIELDS of one shard, whose predictions are ordered by falling score."""
    above = np.searchsorted(-np.float32(predictions.scores), -np.float32(CUTOFFS), side="right")
    wrong = ~predictions.ignored & ~_overlapping_with_others(pairs, counted)
    wrong_above = np.concatenate([[0], np.cumsum(wrong)])
    of_level = [counted & (truths.levels <= level) for level in rules.levels]
    numbers, which = np.unique(above, return_inverse=True)
    counts = np.zeros((len(rules.levels), len(numbers), len(FIELDS)))
    for place, (prediction, truth) in enumerate(match_first(pairs, numbers)):
        hit = counted[truth]
        heading = pairs.heading[prediction, truth][hit]
        affinity = pairs.affinity[prediction, truth][hit].sum(dtype=np.float64)
        unmatched = wrong_above[numbers[place]] - wrong[prediction].sum()
        for level, members in enumerate(of_level):
            there = members.sum()
            counts[level, place] = (
                *(there, numbers[place], hit.sum(), unmatched, there - members[truth].sum()),
                *((heading < 0.5).sum(), heading.sum(), affinity),
            )
    return counts[:, which]


def _overlapping_with_others(pairs: Pairs, counted: np.ndarray) -> np.ndarray:
    """(n,) bool: predictions that overlap most with a truth of another bin."""
    if counted.all():
        return np.zeros(len(pairs.iou), bool)
    nearest = pairs.iou.argmax(axis=1)
    return (pairs.iou.max(axis=1) >= OVERLAP) & ~counted[nearest]
