"""Table 3: what detectors find with generated views beside the recorded ones, and what without."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoevs.core.parquet import read_parquet
from geoevs.detection.counts import FIELDS, shards_of
from geoevs.detection.metrics import average_precisions
from geoevs.detection.outcomes import Outcome
from geoevs.detection.rules import CENTRE, CUTOFFS, RANGE, RANGES, ROAD_USERS, RULES, TYPE
from geoevs.detection.scoring import scene_sums
from geoevs.detection.setting_counts import SETTING_COUNT_TYPES
from geoevs.detection.training_settings import AUGMENTED, BLIND, LONGER, NATIVE, views_label
from geoevs.methods.contract import DEFAULT
from geoevs.results.bootstrap import redraw
from geoevs.results.entrants import Entrants
from geoevs.results.paper import paper_values
from geoevs.results.settings import TableSettings

GAINS = ("let_mapl", "let_map", "let_maph", "l1_aph_vehicle")
"""Metrics of the paper's table, and LET-mAP; their gains over NATIVE are paired."""

NAMES = {
    BLIND: "blind (grey pictures)",
    NATIVE: "recorded views",
    LONGER: "recorded views, longer",
    AUGMENTED: "recorded views, augmented",
}

TRACKS = "tracks"
"""The need of methods that are handed boxes."""

Entries = Mapping[str, tuple[str, str]]
"""Method and variant of entrants, by label."""

Draws = tuple[np.ndarray, ...]
"""How often each scene (R, N) and each seed (R, K) counts: once at first, then as redrawn."""


@dataclass(frozen=True)
class Shard:
    """A number of the table: the mean over classes of one bin, by some rules at a level."""

    rules: str
    breakdown: str
    classes: Sequence[str]
    bin: str
    level: int
    weight: str


LET_WEIGHTS = {"let_mapl": "apl", "let_map": "ap", "let_maph": "aph"}


def _numbers() -> dict[str, Shard]:
    """What the table has of every setting, by column."""
    let = {
        name: Shard("LET", TYPE, ROAD_USERS, "all", 2, weight)
        for name, weight in LET_WEIGHTS.items()
    }
    by_class = {
        f"let_{weight}_{label}": Shard("LET", TYPE, [label], "all", 2, weight)
        for label in ROAD_USERS
        for weight in LET_WEIGHTS.values()
    }
    by_range = {
        f"let_mapl_{column}": Shard("LET", RANGE, ROAD_USERS, name, 2, "apl")
        for column, name in zip(("to_30m", "30_to_50m", "from_50m"), RANGES, strict=True)
    }
    return {
        **let,
        "l1_aph_vehicle": Shard("plain", TYPE, ["vehicle"], "all", 1, "aph"),
        "ap_2m_vehicle": Shard("centre", TYPE, ["vehicle"], "all", 2, "ap"),
        **by_class,
        **by_range,
    }


NUMBERS = _numbers()
DETAILS = [
    name for name in NUMBERS if name not in (*LET_WEIGHTS, "l1_aph_vehicle", "ap_2m_vehicle")
]
"""Those by class and by range."""

INTERVALS = (*GAINS, "ap_2m_vehicle")
"""Those with an interval of their own."""


def read_setting_counts(path: Path) -> pd.DataFrame:
    """Rows of SETTING_COUNT_TYPES of a Parquet file.

    Raises:
        GeoEvsError: the file is missing or damaged.
    """
    return read_parquet(path, SETTING_COUNT_TYPES)


def detection_stage_table(
    counts: pd.DataFrame,
    outcomes: Mapping[tuple[str, int], Outcome],
    settings: TableSettings,
    entries: Entries,
    entrants: Entrants,
) -> pd.DataFrame:
    """One row for every setting of table 3.

    Args:
        counts: rows of SETTING_COUNT_TYPES.
        outcomes: of every setting and seed, in the order of the table.
        settings: the config's `tables` section.
        entries: method and variant by label, of those whose views are generated.
        entrants: who plays.

    Returns:
        `setting`, `name`, `group` (`recorded`, `control` or `generated`), `method`, `variant`,
        `needs`, `views`, `seeds`, `frames`, NUMBERS in percent, `_low` and `_high` of INTERVALS,
        `_gain` of GAINS with theirs, `_paper`, `truths`, `predictions`, `flipped`, seconds, `note`.
        A setting of which a seed failed has a note in the place of numbers.
    """
    names = list(dict.fromkeys(name for name, _ in outcomes))
    seeds = sorted({seed for _, seed in outcomes})
    sums = _sums(counts, names, seeds)
    scenes = counts["scene"].nunique()
    rng = np.random.default_rng(0)
    draws = tuple(
        np.concatenate([np.ones((1, n)), redraw(np.zeros(n), settings.resamples, rng)])
        for n in (scenes, len(seeds))
    )
    redrawn = settings if scenes * len(seeds) > 1 else None
    rows, drawn = [], {}
    for place, name in enumerate(names):
        row = _about(name, [outcomes[name, seed] for seed in seeds], entries, entrants) | NO_SIZES
        if not row["failed"] and sums:
            numbers = {rules: of[place] for rules, of in sums.items()}
            drawn[name] = _values(numbers, draws)
            row |= _sizes(numbers)
        rows.append(row)
    native = drawn.get(NATIVE)
    for row in rows:
        values = drawn.get(row["setting"])
        for column in NUMBERS:
            row[column] = values[column][0] if values else math.nan
        for column in INTERVALS:
            row |= _ends(column, values and values[column], redrawn)
        for column in GAINS:
            paired = values and native and values is not native
            gain = values[column] - native[column] if paired else None
            row[f"{column}_gain"] = math.nan if gain is None else gain[0]
            row |= _ends(f"{column}_gain", gain, redrawn)
            row[f"{column}_paper"] = _paper(row).get(column, math.nan)
    return pd.DataFrame(rows)


def _values(counts: Mapping[str, np.ndarray], draws: Draws) -> dict[str, np.ndarray]:
    """NUMBERS in percent, (R,) each; those without an interval have the first draw alone."""
    first = draws[0][:1], draws[1][:1]
    return {
        column: 100
        * _mean_precision(counts[shard.rules], shard, draws if column in INTERVALS else first)
        for column, shard in NUMBERS.items()
    }


def _sums(counts: pd.DataFrame, names: list[str], seeds: list[int]) -> dict[str, np.ndarray]:
    """(settings, seeds, scenes, S, L, C, F) counts of each rules, all over the same scenes."""
    found = {}
    all_scenes = sorted(counts["scene"].unique())
    for rules, rows in counts.groupby("rules", sort=False):
        shape = (len(names), len(seeds), len(all_scenes), len(shards_of(RULES[rules])))
        shape += (len(RULES[rules].levels), len(CUTOFFS), len(FIELDS))
        sums = np.zeros(shape)
        for (name, seed), mine in rows.groupby(["setting", "seed"], sort=False):
            if name in names and seed in seeds:
                there = np.isin(all_scenes, mine["scene"].unique())
                sums[names.index(name), seeds.index(seed), there] = scene_sums(mine)
        found[rules] = sums
    return found


def _mean_precision(
    counts: np.ndarray,  # [K, N, S, L, C, F]
    shard: Shard,
    draws: Draws,
) -> np.ndarray:
    """(R,) a precision at every draw: of each seed over summed counts, then the mean over seeds."""
    rules = RULES[shard.rules]
    shards, level = shards_of(rules), rules.levels.index(shard.level)
    places = [shards.index((shard.breakdown, label, shard.bin)) for label in shard.classes]
    scenes, seeds = draws
    means = []
    for of_seed in counts:
        values = np.stack(
            [
                average_precisions(np.tensordot(scenes, of_seed[:, place, level], 1))[shard.weight]
                for place in places
            ]
        )
        known = ~np.isnan(values)
        total = np.where(known, values, 0).sum(axis=0)
        nothing = np.full(len(total), np.nan)
        means.append(np.divide(total, known.sum(axis=0), out=nothing, where=known.any(axis=0)))
    return (seeds * np.stack(means, axis=1)).sum(axis=1) / seeds.sum(axis=1)


def _ends(name: str, values: np.ndarray | None, settings: TableSettings | None) -> dict[str, float]:
    """The ends of an interval of redrawn values, NaN where there are none."""
    known = np.zeros(0) if values is None or settings is None else values[1:]
    known = known[~np.isnan(known)]
    ends = (math.nan, math.nan)
    if settings is not None and len(known):
        ends = np.quantile(known, settings.tails, method="inverted_cdf")
    return {f"{name}_low": float(ends[0]), f"{name}_high": float(ends[1])}


def _about(
    name: str, outcomes: Sequence[Outcome], entries: Entries, entrants: Entrants
) -> dict[str, Any]:
    """What a row says of its setting besides numbers."""
    row = {"setting": name, "group": "recorded", "method": "", "variant": "", "needs": ""}
    notes = [outcome.reason for outcome in outcomes if outcome.reason]
    failed = len(notes)
    if failed:
        notes = [f"{failed} of {len(outcomes)} seeds failed: {notes[0]}"]
    label = views_label(name)
    if label is not None:
        about, note = about_entrant(*entries[label], entrants)
        row |= about | {"name": f"recorded + {about['name']}"}
        notes += [note] if note else []
    else:
        row["name"] = NAMES[name]
    row |= {
        "views": max(outcome.views for outcome in outcomes),
        "seeds": len(outcomes) - failed,
        "frames": max(outcome.frames for outcome in outcomes),
    }
    for seconds in ("training_seconds", "detect_seconds", "render_seconds"):
        row[seconds] = float(np.mean([getattr(outcome, seconds) for outcome in outcomes]))
    row["frame_seconds"] = row["detect_seconds"] + row["render_seconds"]
    return row | {"failed": failed, "note": "; ".join(notes)}


def about_entrant(method: str, variant: str, entrants: Entrants) -> tuple[dict[str, str], str]:
    """`name`, `group`, `method`, `variant` and `needs` of who rendered, and what to note of it.

    Boxes are the labels, so that nobody was given them.
    """
    about = entrants.columns(method, variant)
    needs = about["needs"].split()
    note = f"its {TRACKS} were withheld" if TRACKS in needs else ""
    group = "control" if entrants.is_control(method, variant) else "generated"
    cells = {"name": about["name"], "group": group, "method": method, "variant": variant}
    return {**cells, "needs": " ".join(need for need in needs if need != TRACKS)}, note


def _sizes(counts: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Truths of a frame's all classes, predictions of a seed, and the share turned round.

    Args:
        counts: (K, N, S, L, C, F) of each rules.
    """
    shards = shards_of(CENTRE)
    types = [place for place, shard in enumerate(shards) if shard.breakdown == TYPE]
    total = counts[CENTRE.name][:, :, types, 0, 0].sum(axis=(1, 2))  # [K, F], of all predictions
    field = dict(zip(FIELDS, total.T, strict=True))
    hits = field["true_positives"].sum()
    return {
        "truths": int(field["truths"][0]),
        "predictions": float(field["predictions"].mean()),
        "flipped": 100 * field["flipped"].sum() / hits if hits else math.nan,
    }


NO_SIZES = {"truths": 0, "predictions": math.nan, "flipped": math.nan}
"""Of a setting that failed."""


def _paper(row: Mapping[str, Any]) -> dict[str, float]:
    """What the paper prints of a setting: of the recorded views, and of its own method's."""
    plain = row["variant"] in ("", DEFAULT)
    return paper_values("detection").get(row["method"] or row["setting"], {}) if plain else {}
