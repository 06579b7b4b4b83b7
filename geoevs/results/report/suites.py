"""What a run's audit, stability and detection stages say, in words, where they were run."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd

from geoevs import layout
from geoevs.core.files import whole_file
from geoevs.detection.training_settings import BLIND, NATIVE
from geoevs.results.audit_page import RANKS_WELL
from geoevs.results.formats import with_interval
from geoevs.results.report.sentences import METRIC_NAMES


def summarise_suites(run: Path) -> list[str]:
    """Sentences about when to trust sparse PSNR, who breaks first, and whose views help detectors.

    Raises:
        GeoEvsError: a table that is there is damaged.
    """
    sentences = []
    agreement = run / layout.AUDIT_TABLE.format(table="agreement")
    if agreement.exists():
        with whole_file(agreement):
            sentences += _trust(_csv(agreement))
    points, curves = (
        run / path for path in (f"{layout.BREAKING_POINTS}.csv", layout.STABILITY_TABLE)
    )
    if points.exists() and curves.exists():
        with whole_file(points):
            sentences += _breaking(_csv(points, {"level": "str"}), _csv(curves))
    detection, task = (run / f"{name}.csv" for name in (layout.DETECTION_TABLE, layout.TASK_TABLE))
    if detection.exists() and task.exists():
        with whole_file(detection):
            sentences += _detection(_csv(detection), _csv(task))
    return sentences


def _csv(path: Path, types: Mapping[str, str] | None = None) -> pd.DataFrame:
    with whole_file(path):  # a variant may be called null
        return pd.read_csv(path, dtype=types, keep_default_na=False, na_values=[""])


def _trust(agreement: pd.DataFrame) -> Iterator[str]:
    """When sparse PSNR can be trusted, by data set, at the whole reference's support."""
    measured = agreement[(agreement["metric"] == "sparse_psnr") & agreement["tau"].notna()]
    for dataset, rows in measured.groupby("dataset", sort=False):
        row = rows.loc[rows["share"].idxmax()]
        order = "in the order of dense PSNR 19 times in 20"
        if math.isnan(row["gap"]):
            yield f"On {dataset}, no difference in sparse PSNR in one frame is surely {order}."
        else:
            yield (
                f"On {dataset}, entrants whose sparse PSNR in one frame differs by "
                f"{row['gap']:.1f} dB or more are {order}."
            )
        surely = "ranks" if row["tau_low"] >= RANKS_WELL else "does not surely rank"
        interval = f"{row['tau']:.2f} [{row['tau_low']:.2f}, {row['tau_high']:.2f}]"
        yield (
            f"Over all its views, sparse PSNR {surely} {row['entrants']:.0f} entrants as dense "
            f"PSNR does (Kendall's tau {interval}), and its level is {row['bias']:+.2f} dB from "
            "dense PSNR's; see Audit."
        )


def _breaking(points: pd.DataFrame, curves: pd.DataFrame) -> Iterator[str]:
    """Who first falls below the best control, and who last, by data set and metric."""
    points = points[points["level"].notna()]  # without one no control could judge
    held = points.assign(held=[_held(row, curves) for row in points.to_dict("records")])
    for (dataset, metric), rows in held.groupby(["dataset", "metric"], sort=False):
        if metric not in METRIC_NAMES:
            continue
        shares = rows.groupby("name", sort=False)["held"].mean()
        last, first = (shares[shares == end].index for end in (shares.max(), shares.min()))
        sentence = (
            f"Under stress on {dataset}, by {METRIC_NAMES[metric]}, the last to fail or fall below "
            f"the best control: {', '.join(last)}, after {100 * shares.max():.0f} % of the levels "
            f"(mean of {rows['stressor'].nunique()} stressors)"
        )
        mine = rows[rows["name"].isin(last)]
        never = mine.groupby("stressor", sort=False)["level"].agg(lambda some: set(some))
        unbroken = [name for name, levels in never.items() if levels == {"none"}]
        if unbroken:
            sentence += f", and never under {', '.join(unbroken)}"
        if len(first) < len(shares):
            sentence += f"; the first: {', '.join(first)}, after {100 * shares.min():.0f} %"
        yield f"{sentence}; see Stability for intervals."


def _held(point: Mapping[str, str], curves: pd.DataFrame) -> float:
    """The share of a curve's levels, no stress among them, that are milder than where it breaks."""
    key = ["dataset", "method", "variant", "stressor", "metric"]
    mine = curves[(curves[key] == [point[name] for name in key]).all(axis=1)]
    levels = ["clean" if math.isnan(level) else f"{level:g}" for level in mine["level"]]
    return 1.0 if point["level"] == "none" else levels.index(point["level"]) / len(levels)


def _detection(table: pd.DataFrame, task: pd.DataFrame) -> Iterator[str]:
    """Whether generated views help a detector, and how it does on a rig that moved aside."""
    rows = table.set_index("setting")
    native = rows.loc[NATIVE]
    if native["failed"]:
        reason = native["note"]
        yield f"No detector of the recorded views could be trained: {reason}; see Detection."
        return
    blind = rows.loc[BLIND]
    floor = "" if blind["failed"] else f", {blind['let_mapl']:.1f} if it sees grey pictures alone"
    yield (
        f"A detector of the {native['views']:.0f} recorded views has LET-mAPL "
        f"{_between(native, 'let_mapl')} percent{floor} ({native['truths']:.0f} labels, "
        f"{native['seeds']:.0f} seeds)."
    )
    others = rows[(rows["failed"] == 0) & (rows["group"] != "recorded")]
    for row in others.to_dict("records"):
        low, high = (row[f"let_mapl_gain_{end}"] for end in ("low", "high"))
        chance = "more than chance" if low > 0 or high < 0 else "no more than chance"
        chance = "without an interval" if math.isnan(low) else chance
        who, more = row["name"].removeprefix("recorded + "), row["views"] - native["views"]
        gain = _between(row, "let_mapl_gain", "+")
        yield f"With {who} in {more:.0f} more views it changes by {gain}: {chance}."
    yield from _moved(task)


def _moved(task: pd.DataFrame) -> Iterator[str]:
    """NTA-IoU where the rig moved furthest, whoever rendered."""
    measured = task[task["nta_iou"].notna()]
    if not (measured["offset"] == 0).any():
        return
    recorded = measured.loc[measured["offset"] == 0, "nta_iou"].iloc[0]
    furthest = measured["offset"].abs().max()
    aside = measured[(measured["offset"].abs() == furthest) & (furthest > 0)]
    means = aside.groupby("name", sort=False)["nta_iou"].mean()
    said = ", ".join(f"{value:.1f} on pictures of {name}" for name, value in means.items())
    if said:
        yield (
            f"Its boxes have an NTA-IoU of {recorded:.1f} percent on recorded pictures; from "
            f"{furthest:g} m aside, {said}."
        )


def _between(row: Mapping[str, float], name: str, sign: str = "") -> str:
    form = f"{{:{sign}.1f}}"
    return with_interval(form, *(row[name + end] for end in ("", "_low", "_high")))
