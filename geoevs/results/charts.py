"""Speed against accuracy: what each entrant's pictures cost, and which entrants are worth it."""

import io
from typing import Any

import altair as alt
import pandas as pd

from geoevs.protocol.entries import ORACLES
from geoevs.results.costs import make_cost_table
from geoevs.results.summary import summarise
from geoevs.results.tables import display_name, is_control

SPLIT = "extrapolation"
METRICS = {"sparse_psnr": "sparse PSNR, dB", "psnr": "PSNR over all pixels, dB"}
COST = "render_seconds"
ENTRANT = ["dataset", "method", "variant"]


def speed_accuracy(
    scores: pd.DataFrame, costs: pd.DataFrame, settings: dict[str, Any]
) -> pd.DataFrame:
    """What an extrapolated view of every entrant costs, and how good it is.

    Args:
        scores: score rows.
        costs: cost rows.
        settings: the config's `tables` section.

    Returns:
        A row for every data set, entrant and metric of METRICS that has a value: `name`, `control`,
        `render_seconds`, `mean` with its interval `low` and `high`, and `frontier`: whether no
        entrant of the data set is both faster and better. Oracles, which render nothing, are left
        out.
    """
    rows = scores[
        (scores["split"] == SPLIT) & scores["metric"].isin(METRICS) & (scores["stressor"] == "")
    ]
    rows = rows[~rows["method"].isin(ORACLES)]
    by = [*ENTRANT, "metric"]
    summary = summarise(rows, by, settings["resamples"], settings["confidence"])
    cost = make_cost_table(costs)[[*ENTRANT, COST]]
    table = summary.merge(cost, on=ENTRANT).dropna(subset=["mean", COST])
    table["name"] = [display_name(*pair) for pair in zip(table.method, table.variant, strict=True)]
    table["control"] = table["method"].map(is_control)
    table["frontier"] = False
    for _, group in table.groupby(["dataset", "metric"]):
        table.loc[group.index, "frontier"] = _frontier(group)
    return table


def _frontier(rows: pd.DataFrame) -> pd.Series:
    """Which rows no other beats in both cost and mean."""
    ordered = rows.sort_values([COST, "mean"], ascending=[True, False])
    best = ordered["mean"].cummax().shift(fill_value=float("-inf"))
    return (ordered["mean"] > best).reindex(rows.index)


def speed_accuracy_chart(table: pd.DataFrame) -> alt.VConcatChart:
    """One panel for every data set and metric: log seconds against accuracy, and the frontier."""
    panels = [
        _panel(rows, dataset, METRICS[metric])
        for (dataset, metric), rows in table.groupby(["dataset", "metric"], sort=False)
    ]
    return alt.vconcat(*panels).configure_view(stroke=None)


def _panel(rows: pd.DataFrame, dataset: str, title: str) -> alt.LayerChart:
    base = alt.Chart(rows).encode(
        x=alt.X(f"{COST}:Q", title="seconds a view").scale(type="log"),
        y=alt.Y("mean:Q", title=title).scale(zero=False),
    )
    shape = alt.Shape("control:N", title="control").scale(range=["circle", "triangle-up"])
    points = base.mark_point(filled=True, size=70).encode(
        shape=shape,
        color=alt.Color("name:N", title=None, legend=None),
        tooltip=["name", COST, "mean", "low", "high", "frontier"],
    )
    bars = base.mark_rule(opacity=0.5).encode(y="low:Q", y2="high:Q", color="name:N")
    names = base.mark_text(align="left", dx=8, fontSize=11).encode(text="name:N")
    line = (
        base.transform_filter("datum.frontier")
        .mark_line(interpolate="step-after", strokeDash=[4, 3], color="#888")
        .encode(order=f"{COST}:Q")
    )
    heading = f"{dataset}: extrapolated views; dashed, the frontier"
    return (line + bars + points + names).properties(width=620, height=320, title=heading)


def chart_png(chart: alt.VConcatChart) -> bytes:
    """A chart as PNG bytes."""
    buffer = io.BytesIO()
    chart.save(buffer, format="png", scale_factor=1.5)
    return buffer.getvalue()


def chart_html(chart: alt.VConcatChart) -> str:
    """A chart as one page that needs no network."""
    buffer = io.StringIO()
    chart.save(buffer, format="html", inline=True)
    return buffer.getvalue()
