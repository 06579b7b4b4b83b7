"""What a run says, in words made from its numbers."""

from collections.abc import Iterator, Sequence

import pandas as pd

from geoevs.methods.contract import ORACLES
from geoevs.protocol.entries import FAILED, FLOOR
from geoevs.protocol.weights import UNAVAILABLE
from geoevs.results.bootstrap import PairedDifference
from geoevs.results.charts import speed_accuracy
from geoevs.results.entrants import Entrants
from geoevs.results.failures import Failure
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import bin_names, table_rows, table_spec
from geoevs.results.tables import make_table
from geoevs.results.views import paired_of, rows_of

METRIC_NAMES = {"sparse_psnr": "sparse PSNR", "psnr": "PSNR over all pixels"}


def summarise_run(
    scores: pd.DataFrame, costs: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> list[str]:
    """Sentences about who is best, what it costs, and what it loses far from the sources.

    Args:
        scores: score rows.
        costs: cost rows.
        settings: the config's `tables` section.
        entrants: who plays.
    """
    points = speed_accuracy("extrapolation", scores, costs, settings, entrants)
    curves = speed_accuracy("pose_offset", scores, costs, settings, entrants)
    table = make_table("extrapolation", scores, settings, entrants)
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
    failures: Sequence[Failure], scores: pd.DataFrame, sets: pd.DataFrame, entrants: Entrants
) -> list[str]:
    """Sentences about what failed, and what could not be measured.

    Args:
        failures: of the run and its stability suite.
        scores: score rows.
        sets: rows of distances between sets of images.
        entrants: who plays.
    """
    return [*_failures(failures, entrants), *_unmeasured(scores, sets)]


def _extent(rows: pd.DataFrame) -> str:
    entrants = rows[["method", "variant"]].drop_duplicates()
    frames = rows[["scene", "frame"]].drop_duplicates()
    views = rows[["scene", "frame", "target"]].drop_duplicates()
    failed = rows.loc[rows["status"] == FAILED, ["method", "variant"]].drop_duplicates()
    but = f"; {len(failed)} of them failed on some or all" if len(failed) else ""
    return (
        f"On {rows['dataset'].iloc[0]}, {_count(len(entrants), 'entrant')} rendered "
        f"{_count(len(views), 'view')} of {_count(len(frames), 'frame')} in "
        f"{_count(rows['scene'].nunique(), 'scene')}{but}."
    )


def _best(points: pd.DataFrame, rows: pd.DataFrame, settings: TableSettings) -> Iterator[str]:
    """The best method, and how it compares with the best control on the same views.

    Best is nobody who lacks a view that others have.
    """
    if points["control"].all():
        return
    ordered = points.sort_values(["mean", "name"], ascending=[False, True])
    ranked, others = (ordered[ordered["lacking"] == 0], ordered[ordered["lacking"] > 0])
    methods, controls = ranked[~ranked["control"]], ranked[ranked["control"]]
    views = f"{METRIC_NAMES[points['metric'].iloc[0]]} of extrapolated views"
    if methods.empty:
        sentences = [f"By {views} no method is the best, as none delivered all of them."]
    else:
        best = methods.iloc[0]
        sentences = [f"By {views} the best method is {_scored(best)}."]
    if len(controls):
        control = controls.iloc[0]
        sentences.append(f"The best control is {_scored(control)}.")
    if len(methods) and len(controls):
        both = (rows_of(rows, row["method"], row["variant"]) for row in (best, control))
        sentences += _gain(best["name"], control["name"], paired_of(*both, settings))
    if len(others):
        sentences.append(f"Not ranked, as views are missing: {', '.join(_partial(others))}.")
    yield " ".join(sentences)


def _gain(best: str, control: str, gap: PairedDifference) -> Iterator[str]:
    """What the best method gains or loses view by view, and whether that is certain."""
    if not gap.pairs:
        return
    verb, preposition, sign = ("gains", "on", 1) if gap.mean >= 0 else ("loses", "to", -1)
    ends = sorted((sign * gap.low, sign * gap.high))
    interval = "" if pd.isna(gap.low) else f" [{ends[0]:.2f}, {ends[1]:.2f}]"
    yield f"View by view {best} {verb} {abs(gap.mean):.2f} dB{interval} {preposition} {control}."
    if pd.isna(gap.low):
        yield "One frame a scene gives no interval."
    elif gap.low <= 0 <= gap.high:
        yield "Which of the two is better is not certain."


def _partial(points: pd.DataFrame) -> Iterator[str]:
    """Means of fewer views than others', with how many they are of."""
    for _, row in points.iterrows():
        count = f"{row['n']} of {row['n'] + row['lacking']} views"
        yield f"{row['name']} ({row['mean']:.2f} dB on {count})"


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
        whole = (points["lacking"] == 0) & (points["lacking_fits"] == 0)
        those = "Nothing" if whole.all() else "Of those that delivered every view, nothing"
        yield f"{those} is both faster and better, by sparse PSNR, than each of these: {steps}."


def _decline(curves: pd.DataFrame, bins: list[str]) -> Iterator[str]:
    """How much each method loses as the target turns away from the front camera.

    One that lacks a view of either end is left out: what it did deliver may be the easy ones.
    """
    rows = curves[(curves["metric"] == "sparse_psnr") & ~curves["control"]]
    present = [label for label in bins if label in set(rows["bin"])]
    if len(present) < 2:
        return
    ends = rows[rows["bin"].isin((present[0], present[-1]))]
    both = ends.groupby("name")["bin"].transform("nunique") == 2
    partial = ends.loc[(ends["lacking"] > 0) | ~both, "name"].unique()
    ends = ends[~ends["name"].isin(partial)]
    first, last = (
        ends[ends["bin"] == label].set_index("name")["mean"] for label in (present[0], present[-1])
    )
    change = (last - first).dropna().sort_values(ascending=False)
    if len(change):
        losses = ", ".join(f"{name} {value:+.2f} dB" for name, value in change.items())
        left_out = f" Left out, as views are missing: {', '.join(partial)}." if len(partial) else ""
        yield (
            f"From {present[0]} to {present[-1]} degrees off the front camera, sparse PSNR "
            f"changes by: {losses}.{left_out}"
        )


def _below_floor(table: pd.DataFrame) -> Iterator[str]:
    worse = table[(table["below_floor"] != "") & ~table["method"].isin(ORACLES)]
    if len(worse):
        named = "; ".join(
            f"{row.name} on {row.below_floor.replace(' ', ', ')}"
            + (" (on the views that it delivered)" if row.partial else "")
            for row in worse.itertuples()
        )
        yield f"Worse than one colour ({FLOOR}) on extrapolated views: {named}."


def _failures(failures: Sequence[Failure], entrants: Entrants) -> Iterator[str]:
    if not failures:
        yield "Nothing failed."
    for stressed, where in ((False, "on at least one scene"), (True, "under stress")):
        some = [failure for failure in failures if failure.stressed == stressed]
        names = dict.fromkeys(entrants.name(failure.method, failure.variant) for failure in some)
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
