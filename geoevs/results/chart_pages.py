"""Charts of speed against accuracy: pages that need no network, and pictures of them."""

import math
import textwrap
from pathlib import Path
from typing import Any

import altair as alt
import numpy as np
import pandas as pd
import vl_convert

from geoevs.core.files import write_bytes, write_text
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.set_metrics import SET_METRICS
from geoevs.results.charts import COSTS, SPEED, higher_is_better, speed_accuracy
from geoevs.results.entrants import Entrants
from geoevs.results.escaping import csv_text
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import bin_names, table_spec

WIDTH, HEIGHT = 300, 230
LABEL_SIZE = 11
NARROW, WIDE = set("fijlrt-() "), set("mwABCDEFGHKMNOPQRSUVWXYZ")
"""Letters about 0.3 and 0.75 times as wide as they are high, in a plain font; others are 0.56."""

MOST_ROOM = 0.55
"""The largest share of a panel's width, at its cheap end, that is kept free for labels."""

ROOMS_ABOVE = np.arange(0.15, 3.0, 0.1)
"""Free space above the best point, as shares of the way from the worst: the first that does."""

SUBTITLE_WIDTH = 55
"""Characters of a panel's subtitle in a line."""

LINEAR_TO = {
    "fid": 1.0,
    "kid": 0.01,
    "efficientnet_kd": 0.01,
    "efficientnet_fd": 1.0,
    "texture_energy": 0.1,
}
"""Distances of sets span decades, so that they have logarithmic axes; unbiased ones may be
negative, so that those are linear (Vega's symlog) up to this."""

TICKS = (0, 1, 3, 10, 30, 100, 300, 1000, 3000)
"""Where a symlog axis has them, in multiples of LINEAR_TO."""

HOLLOW = "Hollow: views are missing, and the mean is of the others"
"""What a page says where it ranks nobody."""

UNRANKED = "Hollow, not ranked, as views or fits are missing"
"""What a panel says of those whose means are of fewer than others' are."""

KINDS = {"method": "circle", "control": "triangle-up"}
COLOR = (
    alt.Color("name:N", title="Entrant (click one to see it alone)", sort=None)
    .scale(scheme="tableau20")
    .legend(symbolLimit=0, columns=6, orient="top")
)
SHAPE = (
    alt.Shape("kind:N", title="Kind")
    .scale(domain=list(KINDS), range=list(KINDS.values()))
    .legend(orient="top")
)
CHOSEN = alt.selection_point(fields=["name"], bind="legend")
FADED = alt.when(CHOSEN).then(alt.value(0.9)).otherwise(alt.value(0.08))


def write_chart(
    stem: Path,
    name: str,
    scores: pd.DataFrame,
    costs: pd.DataFrame,
    settings: TableSettings,
    entrants: Entrants,
    sets: pd.DataFrame | None = None,
) -> None:
    """Draw speed against accuracy as CSV, PNG and a page that needs no network.

    Args:
        stem: the path without suffix.
        name: the table whose views to chart, one of TABLES.
        scores: the run's score rows.
        costs: its cost rows.
        settings: the config's `tables` section.
        entrants: who plays.
        sets: rows of distances between sets, if there are any.
    """
    table = speed_accuracy(name, scores, costs, settings, entrants, sets)
    page = draw_page(name, table, settings)
    write_text(stem.with_suffix(".csv"), csv_text(table))
    write_page(stem, page)


def draw_page(name: str, table: pd.DataFrame, settings: TableSettings) -> alt.VConcatChart:
    """A page of panels: for every data set and metric a row of what accuracy costs.

    Where a table is divided by edges, rows go over its bins, with the curve over them before.

    Args:
        name: the table, one of TABLES.
        table: what `speed_accuracy` made of it.
        settings: the config's `tables` section.
    """
    spec = table_spec(name)
    bins = [label for label in bin_names(spec, settings) if label in set(table["bin"])]
    rows = []
    for dataset, of_dataset in table.groupby("dataset", sort=False):
        for metric, points in of_dataset.groupby("metric", sort=False):
            of_bin = {label: points[points["bin"] == label] for label in bins}
            if spec.edges:
                panels = [_curve(points, bins, f"{dataset}: {metric}", spec.bins)]
                panels += [
                    _panel(points_of_bin, SPEED, metric, f"{spec.bins} {label}")
                    for label, points_of_bin in of_bin.items()
                ]
                rows.append(alt.hconcat(*panels))
            else:
                rows += [
                    alt.hconcat(*_costs(points_of_bin, metric, f"{dataset} {label}".strip()))
                    for label, points_of_bin in of_bin.items()
                    if len(points_of_bin)
                ]
    if rows:  # one panel holds the selection that all share
        rows[0].hconcat[0] = rows[0].hconcat[0].add_params(CHOSEN)
    title = f"{spec.title}. Dashed: the frontier, what nothing beats in both; bars: intervals."
    title += " Fit seconds are without the training of networks (see tables/costs)."
    return stacked(rows, title)


def stacked(rows: list[Any], title: str) -> alt.VConcatChart:
    """Rows of panels as one page, with one legend."""
    # In one step, as every method of a chart copies it with all that it holds.
    return alt.vconcat(
        *rows,
        title=title,
        resolve=alt.Resolve(scale=alt.LegendResolveMap(color="shared", shape="shared")),
        config={"view": {"stroke": "#ddd"}, "axis": {"gridColor": "#eee"}},
    )


def _costs(points: pd.DataFrame, metric: str, place: str) -> list[alt.LayerChart]:
    return [_panel(points, cost, metric, f"{place}: {metric}") for cost in COSTS]


def _panel(points: pd.DataFrame, cost: str, metric: str, title: str) -> alt.LayerChart:
    """One cost against one metric: points with both intervals, and the frontier with its names."""
    every = _plotted(points, cost)
    data, across, up = _laid_out(every, metric)
    # Up to the edge where an exact copy, beyond the axis, ends it.
    frontier = every.loc[every["frontier"], ["x", "y"]].assign(
        y=lambda some: some["y"].clip(upper=max(up))
    )
    x = alt.X("x:Q", title=COSTS[cost]).scale(type="log", domain=across, nice=False)
    x = x.axis(tickCount=5, format="~g", labelOverlap=True)
    y = _upward(metric, up)
    base = alt.Chart(data).encode(x=x, y=y)
    tips = [
        alt.Tooltip("name:N", title="entrant"),
        alt.Tooltip("y:Q", title=metric, format=".4g"),
        alt.Tooltip("interval:N"),
        alt.Tooltip("x:Q", title=COSTS[cost], format=".4g"),
        alt.Tooltip("cost_interval:N", title="its interval"),
        alt.Tooltip("n:Q", title="views"),
        alt.Tooltip("lacking:Q", title="views that it lacks"),
        alt.Tooltip("lacking_fits:Q", title="fits that it lacks"),
    ]
    line = (
        alt.Chart(frontier)
        .mark_line(interpolate="step-after", strokeDash=[4, 3], color="#888")
        .encode(x=x, y=y, order="x:Q")
    )
    bars = base.mark_rule(strokeWidth=1.5).encode(color=COLOR, opacity=FADED)
    names = (
        base.transform_filter("datum.frontier")
        .mark_text(align="right", baseline="bottom", fontSize=LABEL_SIZE)
        .encode(x="label_x:Q", y="label_y:Q", text="name:N")
    )
    dots = [
        some.encode(color=COLOR, shape=SHAPE, opacity=FADED, tooltip=tips)
        for some in _dots(base, data, 75)
    ]
    upright, level = bars.encode(y="low:Q", y2="high:Q"), bars.encode(x="x_low:Q", x2="x_high:Q")
    titled = _titled(title, points, points["timed_on"].iloc[0])
    return layered([line, upright, level, *dots, names], titled)


def _dots(base: alt.Chart, data: pd.DataFrame, size: int) -> list[alt.Chart]:
    """Points of who is ranked, filled; of who is not, hollow."""
    missing = data["lacking"] + data["lacking_fits"] > 0
    if not missing.any():
        return [base.mark_point(filled=True, size=size)]
    lacks = "datum.lacking + datum.lacking_fits > 0"
    return [
        base.transform_filter(f"!({lacks})").mark_point(filled=True, size=size),
        base.transform_filter(lacks).mark_point(filled=False, size=size, strokeWidth=2),
    ]


def layered(layers: list[alt.Chart], title: alt.TitleParams | str) -> alt.LayerChart:
    """Layers, the lowest first, as a panel of the size that all have."""
    return alt.layer(*layers, width=WIDTH, height=HEIGHT, title=title)


def _titled(title: str, points: pd.DataFrame, said_too: str = "") -> alt.TitleParams:
    """A panel's title, and below it what its points do not say.

    That is whose mean is infinite, which no axis can show, and who lacks views or fits.
    """
    said = {
        "Beyond the axis (∞, some views are exact)": np.isinf(points["mean"]),
        UNRANKED: points["lacking"] + points["lacking_fits"] > 0,
    }
    texts = [
        f"{text}: {', '.join(points.loc[those, 'name'].unique())}"
        for text, those in said.items()
        if those.any()
    ]
    lines = [
        line
        for text in [*texts, said_too]
        for line in textwrap.wrap(text, SUBTITLE_WIDTH, break_on_hyphens=False)
    ]
    return alt.TitleParams(title, subtitle=lines) if lines else alt.TitleParams(title)


def _upward(metric: str, up: list[float]) -> alt.Y:
    """The axis of a metric from its worse end to its better one, which is up, with its unit."""
    unit = METRICS[metric].unit if metric in METRICS else ""
    title = f"{metric}{f', {unit}' if unit else ''} "
    title += "↑" if higher_is_better(metric) else "↓ (reversed: up is better)"
    y = alt.Y("y:Q", title=title)
    if metric not in SET_METRICS:
        return y.scale(domain=up, nice=False, zero=False)
    ticks = [step * LINEAR_TO[metric] for step in TICKS]
    ticks = [tick for tick in ticks if min(up) <= tick <= max(up)]
    y = y.scale(type="symlog", constant=LINEAR_TO[metric], domain=up, nice=False, zero=False)
    return y.axis(values=ticks, format="~r")


def _stretch(values: Any, metric: str) -> Any:
    """Values as far apart as their axis draws them."""
    if metric not in SET_METRICS:
        return values
    return np.sign(values) * np.log1p(np.abs(values) / LINEAR_TO[metric])


def _shrink(heights: Any, metric: str) -> Any:
    """The inverse of `_stretch`."""
    if metric not in SET_METRICS:
        return heights
    return np.sign(heights) * np.expm1(np.abs(heights)) * LINEAR_TO[metric]


def _plotted(points: pd.DataFrame, cost: str) -> pd.DataFrame:
    """What one panel shows; an interval that is not known has no length."""
    data = pd.DataFrame(
        {
            "name": points["name"],
            "kind": np.where(points["control"], "control", "method"),
            "x": points[cost],
            "x_low": points[f"{cost}_low"].fillna(points[cost]),
            "x_high": points[f"{cost}_high"].fillna(points[cost]),
            "y": points["mean"],
            "low": points["low"].fillna(points["mean"]),
            "high": points["high"].fillna(points["mean"]),
            "frontier": points[f"{cost}_frontier"],
            **{name: points[name] for name in ("n", "lacking", "lacking_fits")},
        }
    ).dropna(subset=["x"])
    for name, low, high in (("interval", "low", "high"), ("cost_interval", "x_low", "x_high")):
        data[name] = [f"{a:.4g} to {b:.4g}" for a, b in zip(data[low], data[high], strict=True)]
    return data


def _laid_out(data: pd.DataFrame, metric: str) -> tuple[pd.DataFrame, list[float], list[float]]:
    """What can be drawn, with the places of its names, and the ranges of both axes.

    There is as much room above the best point as it takes to keep all names in the panel.
    """
    finite = data[np.isfinite(data["y"])]
    drawn = finite.assign(y=_stretch(finite["y"], metric))
    across = _cost_range(data, finite[finite["frontier"]])
    for room in ROOMS_ABOVE:
        up = _metric_range(finite, metric, room)
        bottom, top = _stretch(np.array(up), metric)
        places = _label_places(drawn, across, [bottom, top])
        if (places["bottom"] + LABEL_SIZE + 2 <= HEIGHT).all():
            break
    low, high = np.log10(across)
    label_x = 10 ** (low + places["right"] / WIDTH * (high - low))
    label_y = _shrink(bottom + places["bottom"] / HEIGHT * (top - bottom), metric)
    return finite.assign(label_x=label_x, label_y=label_y), across, up


def _cost_range(data: pd.DataFrame, named: pd.DataFrame) -> list[float]:
    """All intervals, and room at the cheap end for the names, which end at their points."""
    if data.empty:
        return [0.1, 1.0]
    low, high = math.log10(data["x_low"].min()), math.log10(data["x_high"].max())
    span = max(high - low, 0.5)
    lengths = np.array([_length(name) + 8 for name in named["name"]])
    back = (high - np.log10(named["x"])) / span
    rooms = (lengths / WIDTH - 0.95 * (1 - back)) / back
    width = span / (0.95 - min(max([0.05, *rooms]), MOST_ROOM))
    return [10 ** (high - width * 0.95), 10 ** (high + width * 0.05)]


def _metric_range(data: pd.DataFrame, metric: str, above: float) -> list[float]:
    """All intervals from the worse end to the better one, and a share of that way above them."""
    if data.empty:
        return [0.0, 1.0]
    ends = [data["low"].min(), data["high"].max()]
    bottom, top = _stretch(np.array(ends if higher_is_better(metric) else ends[::-1]), metric)
    span = max(abs(top - bottom), 1e-6 * abs(top), 1e-9) * (1 if higher_is_better(metric) else -1)
    return _shrink(np.array([bottom - 0.05 * span, top + above * span]), metric).tolist()


def _label_places(data: pd.DataFrame, across: list[float], up: list[float]) -> pd.DataFrame:
    """Where each frontier entrant's name stands: left above its point, where nothing can be.

    Left above the frontier lies no entrant; only other names do, above which a name then moves.
    One that would leave the panel to the left starts at its edge.

    Returns:
        `right` end and `bottom` of the names, in pixels from the panel's lower left corner.
    """
    low, high = (math.log10(end) for end in across)
    placed = pd.DataFrame(columns=["left", "right", "bottom"], dtype=np.float64)
    worst_first = data[data["frontier"]].sort_values("y", ascending=bool(up[0] < up[1]))
    for index, row in worst_first.iterrows():
        length = _length(row["name"])
        right = max((math.log10(row["x"]) - low) / (high - low) * WIDTH - 4, length + 2)
        left = right - length
        bottom = (row["y"] - up[0]) / (up[1] - up[0]) * HEIGHT + 3
        for other in placed.itertuples():
            meets = left < other.right and other.left < right
            if meets and abs(bottom - other.bottom) < LABEL_SIZE + 1:
                bottom = other.bottom + LABEL_SIZE + 1
        placed.loc[index] = (left, right, bottom)
    return placed[["right", "bottom"]]


def _length(name: str) -> float:
    """About how many pixels a name takes in a line."""
    widths = [0.3 if letter in NARROW else 0.75 if letter in WIDE else 0.56 for letter in name]
    return LABEL_SIZE * sum(widths)


def _curve(points: pd.DataFrame, bins: list[str], title: str, over: str) -> alt.LayerChart:
    """A metric over a table's bins, one line with its intervals for every entrant."""
    data = points.assign(kind=np.where(points["control"], "control", "method"))
    columns = ["name", "kind", "bin", "mean", "low", "high", "n", "lacking", "lacking_fits"]
    data = data.loc[np.isfinite(data["mean"]), columns]
    x = alt.X("bin:O", sort=bins, title=over).axis(labelAngle=0)
    base = alt.Chart(data).encode(x=x, color=COLOR, opacity=FADED)
    y = alt.Y("mean:Q", title=None).scale(zero=False)
    tips = ["name", "bin", "mean", "low", "high", "n", "lacking"]
    dots = [some.encode(y=y, shape=SHAPE, tooltip=tips) for some in _dots(base, data, 45)]
    bars = base.mark_rule().encode(y=alt.Y("low:Q", title=None), y2="high:Q")
    titled = _titled(title, points, points["outside"].iloc[0])
    return layered([base.mark_line().encode(y=y), bars, *dots], titled)


def page_png(page: dict[str, Any]) -> bytes:
    """A page, as `to_dict` gives it, as PNG bytes."""
    return vl_convert.vegalite_to_png(page, scale=1.5)


def page_html(page: dict[str, Any]) -> str:
    """A page, as `to_dict` gives it, as HTML that needs no network; no text in it is markup."""
    start = "\n    const spec = "
    before, _, after = vl_convert.vegalite_to_html(page, bundle=True).rpartition(start)
    spec, end, rest = after.partition("\n")  # JSON is one line
    return before + start + spec.replace("<", r"\u003c") + end + rest


def write_page(stem: Path, page: alt.VConcatChart) -> None:
    """Write a page as `<stem>.png` and `<stem>.html`, each whole or not at all."""
    converted = page.to_dict()  # once, as it takes about as long as the picture
    write_bytes(stem.with_suffix(".png"), page_png(converted))
    write_text(stem.with_suffix(".html"), page_html(converted))
