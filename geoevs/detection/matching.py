"""Which prediction is which truth: the assignment that overlaps most, at every cutoff."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from geoevs.detection.frames import Predictions, Truths
from geoevs.detection.iou import iou_3d
from geoevs.detection.let import affinities, aligned
from geoevs.detection.rules import Rules

UNITS = 1_000_000
"""Weights are whole numbers of this part of an IoU."""


@dataclass(frozen=True)
class Pairs:
    """What every prediction and every truth of a frame have in common.

    Args:
        iou: (N, M) float32, 0 of different classes; without errors along the line of sight where
            the rules tolerate them. Under rules of distance, 1 - distance / the most allowed, from
            0 on.
        affinity: (N, M) float32, 1 where the rules tolerate none.
        heading: (N, M) float64, the heading accuracy: 1 - |difference| / pi.
        may_match: (N, M) bool.
    """

    iou: np.ndarray
    affinity: np.ndarray
    heading: np.ndarray
    may_match: np.ndarray

    @property
    def weight(self) -> np.ndarray:
        """(N, M) float64 whole numbers: what a match is worth, 0 where there may be none."""
        worth = np.floor(self.iou * self.affinity * np.float32(UNITS) + np.float32(0.5))
        return np.where(self.may_match, worth, 0).astype(np.float64)

    def take(self, predictions: np.ndarray, truths: np.ndarray) -> "Pairs":
        """Those of some predictions and truths, by their indices."""
        part = np.ix_(predictions, truths)
        return Pairs(self.iou[part], self.affinity[part], self.heading[part], self.may_match[part])


def pair_up(predictions: Predictions, truths: Truths, rules: Rules) -> Pairs:
    """Compare all predictions of a frame with all its truths.

    Numbers that are compared with thresholds are float32, as Waymo's are, so that an IoU of exactly
    a threshold counts in both.
    """
    same = predictions.classes[:, None] == truths.classes
    heading = heading_accuracies(predictions.boxes[:, None, 6], truths.boxes[:, 6])
    if rules.distance is not None:
        apart = np.hypot(*(predictions.boxes[:, None, :2] - truths.boxes[:, :2]).transpose(2, 0, 1))
        near = np.where(same, np.maximum(1 - apart / rules.distance, 0), 0).astype(np.float32)
        return Pairs(near, np.ones_like(near), heading, near > 0)
    if rules.tolerance is None:
        boxes = np.broadcast_to(predictions.boxes[:, None], (*same.shape, 7))
        affinity = np.ones(same.shape)
    else:
        boxes = aligned(predictions.boxes, truths.boxes, rules.tolerance)
        affinity = affinities(predictions.boxes, truths.boxes, rules.tolerance)
    iou = np.zeros(same.shape)
    _, truth = np.nonzero(same)
    iou[same] = iou_3d(boxes[same], truths.boxes[truth])
    iou, affinity = iou.astype(np.float32), affinity.astype(np.float32)
    least = np.array(rules.thresholds, np.float32)[truths.classes]
    return Pairs(iou, affinity, heading, same & (affinity > 0) & (iou >= least))


def heading_accuracies(headings: np.ndarray, others: np.ndarray) -> np.ndarray:
    """1 - |difference| / pi of two headings in radians: 1 alike, 0 opposite."""
    turn = np.abs(np.mod(headings - others + np.pi, 2 * np.pi) - np.pi)
    return np.clip(1 - turn / np.pi, 0, 1)


def match(pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """The predictions and the truths that are matched, (K,) indices each: the heaviest assignment.

    Pairs that may not match are dropped from it afterwards.
    """
    prediction, truth = linear_sum_assignment(pairs.weight, maximize=True)
    matched = pairs.may_match[prediction, truth]
    return prediction[matched], truth[matched]


def match_first(pairs: Pairs, counts: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """`match` of the first n predictions alone, for each n of `counts`.

    Predictions that may match no truth change no assignment, so that it is found once for every
    number of the others, not once for every cutoff.
    """
    able = np.flatnonzero(pairs.may_match.any(axis=1))
    truths = np.flatnonzero(pairs.may_match.any(axis=0))
    reduced = pairs.take(able, truths)
    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    numbers = np.searchsorted(able, counts)
    for number in np.unique(numbers):
        prediction, truth = match(reduced.take(np.arange(number), np.arange(len(truths))))
        found[number] = able[prediction], truths[truth]
    return [found[number] for number in numbers]
