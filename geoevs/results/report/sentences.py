"""What a run says, in words made from its numbers."""

from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

from geoevs.protocol.entries import ORACLES
from geoevs.protocol.weights import UNAVAILABLE
from geoevs.results.bootstrap import PairedDifference
from geoevs.results.charts import speed_accuracy
from geoevs.results.compare import paired_of, rows_of
from geoevs.results.failures import Failure
from geoevs.results.tables import (
    FLOOR,
    bin_names,
    display_name,
    make_table,
    table_rows,
    table_spec,
)

METRIC_NAMES = {"sparse_psnr": "sparse PSNR", "psnr": "PSNR over all pixels"}


def summarise_run(scores: pd.DataFrame, costs: pd.DataFrame, settings: dict[str, Any]) -> list[str]:
    """Sentences about who is best, what it costs, and what it loses far from the sources.

    Args:
        scores: score rows.
        costs: cost rows.
        settings: the config's `tables` section.
    """
    points = speed_accuracy("extrapolation", scores, costs, settings)
    curves = speed_accuracy("pose_offset", scores, costs, settings)
    table = make_table("extrapolation", scores, settings)
    rows = table_rows(table_spec("extrapolation"), scores, settings)
    sentences = []
    for dataset in scores["dataset"].unique():
        here = points[points["dataset"] == dataset]
        sentences.append(_extent(scores[scores["dataset"] == dataset]))
        for metric in METRIC_NAMES:
            mine = rows[(rows["dataset"] == dataset) & (rows["metric"] == metric)]
            sentences += _best(here[here["metric"] == metric], mine, settings)
        sentences += _frontier(here[here["metric"] == "sparse_psnr"])
        bins = bin_names(table_spec("pose_offset"), settings)
        sentences += _decline(curves[curves["dataset"] == dataset], bins)
        sentences += _below_floor(table[table["dataset"] == dataset])
    return sentences


def summarise_gaps(
    failures: Sequence[Failure], scores: pd.DataFrame, sets: pd.DataFrame
) -> list[str]:
    """Sentences about what failed, and what could not be measured.

    Args:
        failures: of the run and its stability suite.
        scores: score rows.
        sets: rows of distances between sets of images.
    """
    return [*_failures(failures), *_unmeasured(scores, sets)]


def _extent(rows: pd.DataFrame) -> str:
    entrants = rows[["method", "variant"]].drop_duplicates()
    frames = rows[["scene", "frame"]].drop_duplicates()
    views = rows[["scene", "frame", "target"]].drop_duplicates()
    return (
        f"On {rows['dataset'].iloc[0]}, {_count(len(entrants), 'entrant')} rendered "
        f"{_count(len(views), 'view')} of {_count(len(frames), 'frame')} in "
        f"{_count(rows['scene'].nunique(), 'scene')}."
    )


def _best(points: pd.DataFrame, rows: pd.DataFrame, settings: dict[str, Any]) -> Iterator[str]:
    """The best method, and how it compares with the best control on the same views."""
    ranked = points.sort_values("mean", ascending=False)
    methods, controls = ranked[~ranked["control"]], ranked[ranked["control"]]
    if methods.empty:
        return
    best = methods.iloc[0]
    views = f"{METRIC_NAMES[best['metric']]} of extrapolated views"
    sentence = f"By {views} {_scored(best)} is the best method"
    if len(controls):
        control = controls.iloc[0]
        both = (rows_of(rows, row["method"], row["variant"]) for row in (best, control))
        sentence += f"; the best control is {_scored(control)}{_gain(paired_of(*both, settings))}"
    yield f"{sentence}."


def _gain(gap: PairedDifference) -> str:
    """What is gained view by view, and whether that is certain."""
    if not gap.pairs:
        return ""
    gain = f", on which it gains {gap.mean:+.2f} dB view by view"
    if pd.isna(gap.low):
        return f"{gain}; one frame a scene gives no interval"
    doubt = ", so that which of them is better is not certain" if gap.low <= 0 <= gap.high else ""
    return f"{gain} [{gap.low:+.2f}, {gap.high:+.2f}]{doubt}"


def _scored(row: pd.Series) -> str:
    interval = "" if pd.isna(row["low"]) else f" [{row['low']:.2f}, {row['high']:.2f}]"
    return f"{row['name']} ({row['mean']:.2f}{interval} dB)"


def _frontier(points: pd.DataFrame) -> Iterator[str]:
    worth = points[points["render_seconds_frontier"]].sort_values("render_seconds")
    if len(worth):
        steps = ", ".join(
            f"{row['name']} ({row['render_seconds']:.2g} s a view, {row['mean']:.2f} dB)"
            for _, row in worth.iterrows()
        )
        yield f"Nothing is both faster and better, by sparse PSNR, than each of these: {steps}."


def _decline(curves: pd.DataFrame, bins: list[str]) -> Iterator[str]:
    """How much each method loses as the target turns away from the front camera."""
    rows = curves[(curves["metric"] == "sparse_psnr") & ~curves["control"]]
    present = [label for label in bins if label in set(rows["bin"])]
    if len(present) < 2:
        return
    first, last = (
        rows[rows["bin"] == label].set_index("name")["mean"] for label in (present[0], present[-1])
    )
    change = (last - first).dropna().sort_values(ascending=False)
    if len(change):
        losses = ", ".join(f"{name} {value:+.2f} dB" for name, value in change.items())
        yield (
            f"From {present[0]} to {present[-1]} degrees off the front camera, sparse PSNR "
            f"changes by: {losses}."
        )


def _below_floor(table: pd.DataFrame) -> Iterator[str]:
    worse = table[(table["below_floor"] != "") & ~table["method"].isin(ORACLES)]
    if len(worse):
        named = "; ".join(
            f"{display_name(row.method, row.variant)} on {row.below_floor.replace(' ', ', ')}"
            for row in worse.itertuples()
        )
        yield f"Worse than one colour ({FLOOR}) on extrapolated views: {named}."


def _failures(failures: Sequence[Failure]) -> Iterator[str]:
    if not failures:
        yield "Nothing failed."
    for stressed, where in ((False, "on at least one scene"), (True, "under stress")):
        some = [failure for failure in failures if failure.stressed == stressed]
        names = dict.fromkeys(display_name(failure.method, failure.variant) for failure in some)
        if names:
            yield f"Failed, {where}: {', '.join(names)}; see Failures."


def _unmeasured(scores: pd.DataFrame, sets: pd.DataFrame) -> Iterator[str]:
    for frame in (scores, sets):
        lacking = frame[frame["status"] == UNAVAILABLE].drop_duplicates("metric")
        for row in lacking.itertuples():
            yield f"Not measured: {row.metric}, as {row.reason}."


def _count(number: int, thing: str) -> str:
    """A number of things.

    >>> _count(1, "view"), _count(2000, "view")
    ('1 view', '2,000 views')
    """
    return f"{number:,} {thing}{'' if number == 1 else 's'}"
