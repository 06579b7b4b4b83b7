"""Charts of speed against accuracy: pages that need no network, and pictures of them."""

import io
import math
from pathlib import Path
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from geoevs.io import write_bytes, write_text
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.set_metrics import SET_METRICS
from geoevs.results.charts import COSTS, SPEED, higher_is_better
from geoevs.results.tables import bin_names, table_spec

WIDTH, HEIGHT = 300, 230
LABEL_SIZE = 11
LABEL_ROOM = 0.4
"""The share of a panel's width, at its cheap end, that is kept free for labels."""

LINEAR_TO = {"fid": 1.0, "kid": 0.01, "texture_energy": 0.1}
"""Distances of sets span decades, so that they have logarithmic axes; unbiased ones may be
negative, so that those are linear (Vega's symlog) up to this."""

TICKS = (0, 1, 3, 10, 30, 100, 300, 1000, 3000)
"""Where a symlog axis has them, in multiples of LINEAR_TO."""

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


def draw_page(name: str, table: pd.DataFrame, settings: dict[str, Any]) -> alt.VConcatChart:
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
    for dataset, found in table.groupby("dataset", sort=False):
        for metric, points in found.groupby("metric", sort=False):
            of_bin = {label: points[points["bin"] == label] for label in bins}
            if spec.edges:
                panels = [_curve(points, bins, f"{dataset}: {metric}", spec.bins)]
                panels += [
                    _panel(some, SPEED, metric, f"{spec.bins} {label}")
                    for label, some in of_bin.items()
                ]
                rows.append(alt.hconcat(*panels))
            else:
                rows += [
                    alt.hconcat(*_costs(some, metric, f"{dataset} {label}".strip()))
                    for label, some in of_bin.items()
                    if len(some)
                ]
    if rows:  # one panel holds the selection that all share
        rows[0].hconcat[0] = rows[0].hconcat[0].add_params(CHOSEN)
    title = f"{spec.title}. Dashed: the frontier, what nothing beats in both; bars: intervals."
    title += " Fit seconds are without the training of networks (see tables/costs)."
    page = alt.vconcat(*rows, title=title).resolve_scale(color="shared", shape="shared")
    return page.configure_view(stroke="#ddd").configure_axis(gridColor="#eee")


def _costs(points: pd.DataFrame, metric: str, place: str) -> list[alt.LayerChart]:
    return [_panel(points, cost, metric, f"{place}: {metric}") for cost in COSTS]


def _panel(points: pd.DataFrame, cost: str, metric: str, title: str) -> alt.LayerChart:
    """One cost against one metric: points with both intervals, and the frontier with its names."""
    data = _plotted(points, cost)
    across, up = _domains(data, metric)
    drawn = data.assign(y=_stretch(data["y"], metric))
    labels = _label_heights(drawn, across, _stretch(np.array(up), metric))
    data = data.assign(label=_shrink(labels, metric))
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
    ]
    line = (
        base.transform_filter("datum.frontier")
        .mark_line(interpolate="step-after", strokeDash=[4, 3], color="#888")
        .encode(order="x:Q")
    )
    bars = base.mark_rule(strokeWidth=1.5).encode(color=COLOR, opacity=FADED)
    names = (
        base.transform_filter("datum.frontier")
        .mark_text(align="right", baseline="bottom", dx=-4, fontSize=LABEL_SIZE)
        .encode(y=alt.Y("label:Q"), text="name:N")
    )
    dots = base.mark_point(filled=True, size=75).encode(
        color=COLOR, shape=SHAPE, opacity=FADED, tooltip=tips
    )
    layers = line + bars.encode(y2="high:Q", y="low:Q") + bars.encode(x2="x_high:Q", x="x_low:Q")
    return (layers + dots + names).properties(width=WIDTH, height=HEIGHT, title=title)


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
            "n": points["n"],
        }
    ).dropna(subset=["x"])
    for name, low, high in (("interval", "low", "high"), ("cost_interval", "x_low", "x_high")):
        data[name] = [f"{a:.4g} to {b:.4g}" for a, b in zip(data[low], data[high], strict=True)]
    return data


def _domains(data: pd.DataFrame, metric: str) -> tuple[list[float], list[float]]:
    """The ranges of both axes: all intervals, and room for labels at the cheap end and above.

    That of the metric goes from its worse end to its better one.
    """
    if data.empty:
        return [0.1, 1.0], [0.0, 1.0]
    low, high = math.log10(data["x_low"].min()), math.log10(data["x_high"].max())
    width = max(high - low, 0.5) / (1 - LABEL_ROOM)
    across = [10 ** (high - width * 0.95), 10 ** (high + width * 0.05)]
    ends = [data["low"].min(), data["high"].max()]
    bottom, top = _stretch(np.array(ends if higher_is_better(metric) else ends[::-1]), metric)
    span = max(abs(top - bottom), 1e-6 * abs(top), 1e-9) * (1 if higher_is_better(metric) else -1)
    return across, _shrink(np.array([bottom - 0.05 * span, top + 0.15 * span]), metric).tolist()


def _label_heights(data: pd.DataFrame, across: list[float], up: list[float]) -> pd.Series:
    """Where each frontier entrant's name stands: left above its point, where nothing can be.

    Left above the frontier lies no entrant; only other names do, above which a name then moves.
    """
    low, high = (math.log10(end) for end in across)
    heights, placed = pd.Series(np.nan, data.index), []
    worst_first = data[data["frontier"]].sort_values("y", ascending=up[0] < up[1])
    for index, row in worst_first.iterrows():
        right = (math.log10(row["x"]) - low) / (high - low) * WIDTH
        left = right - 0.56 * LABEL_SIZE * len(row["name"])
        bottom = (row["y"] - up[0]) / (up[1] - up[0]) * HEIGHT + 3
        for other_left, other_right, other_bottom in placed:
            meets = left < other_right and other_left < right
            if meets and abs(bottom - other_bottom) < LABEL_SIZE + 1:
                bottom = other_bottom + LABEL_SIZE + 1
        placed.append((left, right, bottom))
        heights[index] = up[0] + bottom / HEIGHT * (up[1] - up[0])
    return heights


def _curve(points: pd.DataFrame, bins: list[str], title: str, over: str) -> alt.LayerChart:
    """A metric over a table's bins, one line with its intervals for every entrant."""
    data = points.assign(kind=np.where(points["control"], "control", "method"))
    data = data[["name", "kind", "bin", "mean", "low", "high", "n"]]
    x = alt.X("bin:O", sort=bins, title=over).axis(labelAngle=0)
    base = alt.Chart(data).encode(x=x, color=COLOR, opacity=FADED)
    y = alt.Y("mean:Q", title=None).scale(zero=False)
    dots = base.mark_point(filled=True, size=45).encode(
        y=y, shape=SHAPE, tooltip=["name", "bin", "mean", "low", "high", "n"]
    )
    bars = base.mark_rule().encode(y=alt.Y("low:Q", title=None), y2="high:Q")
    layers = base.mark_line().encode(y=y) + bars + dots
    return layers.properties(width=WIDTH, height=HEIGHT, title=title)


def page_png(page: alt.VConcatChart) -> bytes:
    """A page as PNG bytes."""
    buffer = io.BytesIO()
    page.save(buffer, format="png", scale_factor=1.5)
    return buffer.getvalue()


def page_html(page: alt.VConcatChart) -> str:
    """A page that needs no network."""
    buffer = io.StringIO()
    page.save(buffer, format="html", inline=True)
    return buffer.getvalue()


def write_page(stem: Path, page: alt.VConcatChart) -> None:
    """Write a page as `<stem>.png` and `<stem>.html`, each whole or not at all."""
    write_bytes(stem.with_suffix(".png"), page_png(page))
    write_text(stem.with_suffix(".html"), page_html(page))
