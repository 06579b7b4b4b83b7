"""Average precision from sums of counts, as Waymo computes it.

In a notebook:

    predictions = Predictions(boxes, classes, scores, ignored)
    truths = Truths(boxes, classes, levels, cameras)
    average_precisions(count_frame(predictions, truths, LET))["ap"]  # of `shards_of(LET)`

Counts of several frames are added first. `metrics_table` does so with rows of counts.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from geoevs.detection.counts import FIELDS, SHARD, shards_of
from geoevs.detection.rules import ROAD_USERS, RULES, TYPE, Rules
from geoevs.detection.scoring import scene_sums

RECALL_STEP = 0.05
"""Between points of the precision-recall curve, at most."""

SLACK = 1e-6
"""By which a gap may be wider than RECALL_STEP."""

WEIGHTS = {"apl": "affinity", "ap": "true_positives", "aph": "heading_accuracy"}
"""What a match counts in the precision: its longitudinal affinity, 1, or its heading accuracy."""


def average_precisions(
    counts: np.ndarray,  # [..., C, F]
) -> dict[str, np.ndarray]:
    """The keys of WEIGHTS, each (...) float64: NaN where there is no truth.

    Precision is the sum of what matches count over matches and false positives, 0 of nothing;
    recall is matches over matches and missed truths, whatever a match counts.
    """
    field = {name: counts[..., place] for place, name in enumerate(FIELDS)}
    hits = field["true_positives"]
    claimed, wanted = hits + field["false_positives"], hits + field["false_negatives"]
    recall = np.divide(hits, wanted, out=np.zeros_like(hits), where=wanted > 0)
    found = {}
    for name, weight in WEIGHTS.items():
        summed = field[weight]
        precision = np.divide(summed, claimed, out=np.zeros_like(hits), where=claimed > 0)
        value = average_precision(precision, recall)
        found[name] = np.where(field["truths"].any(axis=-1), value, np.nan)
    return found


def average_precision(
    precision: np.ndarray,  # [..., C]
    recall: np.ndarray,  # [..., C]
) -> np.ndarray:
    """(...) the area below the precision-recall curve of some cutoffs, in any order.

    At every recall the curve has the best precision of that recall or a higher one. From one point
    to the next lower recall it stays level in steps of RECALL_STEP, and falls or rises within the
    last, shorter step. Down to recall 0 it stays level.
    """
    # Complex numbers are sorted by their real parts, and equal ones by the imaginary parts.
    falling = -np.sort(-(recall + 1j * precision), axis=-1)
    recall = falling.real
    best = np.maximum.accumulate(np.where(recall > 0, falling.imag, 0), axis=-1)
    gap = -np.diff(recall, axis=-1, append=0)
    steps = np.maximum(np.ceil((gap - SLACK) / RECALL_STEP) - 1, 0)
    rest = gap - steps * RECALL_STEP
    climb = np.diff(best, axis=-1, append=best[..., -1:])
    return (best * gap + climb * rest / 2).sum(axis=-1)


MEAN = "mean"
"""In the place of a class: the mean over those of ROAD_USERS that have truths."""


def metrics_table(counts: pd.DataFrame, resamples: int, confidence: float) -> pd.DataFrame:
    """Metrics of every breakdown, class, bin and level, with percentile intervals.

    Scenes are redrawn with replacement, and their counts added again: an interval says how sure a
    number is for other scenes of the kind. Where one scene alone has truths, there is none.

    Args:
        counts: rows of COUNT_TYPES (`geoevs.detection.scoring`), by the same rules.
        resamples: of the bootstrap.
        confidence: of the intervals, such as 0.95.

    Returns:
        Columns `breakdown`, `class`, `bin`, `level`; for every key of WEIGHTS its value and the
        ends of its interval (`_low`, `_high`), NaN where there is no truth; `truths` of the level;
        `predictions`; and `flipped`, the share of all matches whose heading is off by more than 90
        degrees, NaN of none. For every level, a row of MEAN follows the classes themselves.
    """
    rules = RULES[counts["rules"].iloc[0]]
    sums = scene_sums(counts)
    draws, which = np.unique(_draws(len(sums), resamples), axis=0, return_inverse=True)
    values = {
        (place, level): average_precisions(np.tensordot(draws, sums[:, place, level], 1))
        for place, level in np.ndindex(sums.shape[1:3])
    }
    tail = (1 - confidence) / 2
    rows = []
    for names, places in _groups(rules):
        for level, number in enumerate(rules.levels):
            row = {**dict(zip(SHARD, names, strict=True)), "level": number}
            all_predictions = sums[:, places, level, 0].sum(axis=1)  # [N, F]
            varied = np.count_nonzero(all_predictions[:, FIELDS.index("truths")]) > 1
            for name in WEIGHTS:
                drawn = _mean_known([values[place, level][name] for place in places])[which]
                low, high = _quantiles(drawn[1:] if varied else drawn[:0], [tail, 1 - tail])
                row |= {name: drawn[0], f"{name}_low": low, f"{name}_high": high}
            rows.append(row | _sizes(all_predictions.sum(axis=0)))
    return pd.DataFrame(rows)


def _sizes(counts: np.ndarray) -> dict[str, float]:
    """What a table says of FIELDS of all predictions, besides metrics."""
    field = dict(zip(FIELDS, counts, strict=True))
    hits = field["true_positives"]
    return {
        "truths": int(field["truths"]),
        "predictions": int(field["predictions"]),
        "flipped": field["flipped"] / hits if hits else np.nan,
    }


def _groups(rules: Rules) -> Iterator[tuple[tuple[str, str, str], list[int]]]:
    """What each line of a table is of, and the places of the shards that it is the mean of."""
    shards = shards_of(rules)
    types = len([shard for shard in shards if shard.breakdown == TYPE])
    for place, shard in enumerate(shards):
        yield shard, [place]
        if place == types - 1:
            users = [place for place in range(types) if shards[place].label in ROAD_USERS]
            yield (TYPE, MEAN, "all"), users


def _draws(scenes: int, resamples: int) -> np.ndarray:
    """(1 + resamples, scenes) how often each scene counts: once at first, then as it is redrawn."""
    if scenes == 1:
        return np.ones((1, 1))
    drawn = np.random.default_rng(0).multinomial(scenes, np.full(scenes, 1 / scenes), resamples)
    return np.concatenate([np.ones((1, scenes)), drawn])


def _mean_known(values: Sequence[np.ndarray]) -> np.ndarray:
    """The mean of arrays of one shape, in every place over those that are numbers there."""
    stacked = np.stack(values)
    known = ~np.isnan(stacked)
    total, count = np.where(known, stacked, 0).sum(axis=0), known.sum(axis=0)
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def _quantiles(values: np.ndarray, shares: list[float]) -> np.ndarray:
    """Quantiles of those that are numbers; NaN if none is."""
    known = values[~np.isnan(values)]
    if not len(known):
        return np.full(len(shares), np.nan)
    return np.quantile(known, shares, method="inverted_cdf")
