"""What a setting's accuracy costs: LET metrics against the seconds that a frame takes."""

from pathlib import Path

import altair as alt
import pandas as pd

from geoevs.core.files import write_text
from geoevs.results.chart_pages import write_page
from geoevs.results.escaping import csv_text

PANELS = {
    "let_mapl": "LET-mAPL, percent",
    "ap_2m_vehicle": "AP at 2 m, vehicles, percent",
}
COLUMNS = ["setting", "name", "group", "frame_seconds"]
LEAST_SECONDS = 1e-3
"""What a frame takes at least on the chart's logarithmic axis."""


def write_detection_chart(stem: Path, table: pd.DataFrame) -> None:
    """Draw the table of the detection stage as CSV, PNG and a page that needs no network.

    Args:
        stem: the path without suffix.
        table: what `detection_stage_table` made.
    """
    points = chart_points(table)
    write_text(stem.with_suffix(".csv"), csv_text(points))
    write_page(stem, detection_chart(points))


def chart_points(table: pd.DataFrame) -> pd.DataFrame:
    """COLUMNS, `metric`, `value`, `low` and `high` of every setting that has numbers."""
    parts = [
        table[COLUMNS].assign(
            metric=metric,
            value=table[metric],
            low=table[f"{metric}_low"],
            high=table[f"{metric}_high"],
        )
        for metric in PANELS
    ]
    points = pd.concat(parts, ignore_index=True)
    points["frame_seconds"] = points["frame_seconds"].clip(lower=LEAST_SECONDS)
    return points[points["value"].notna()]


def detection_chart(points: pd.DataFrame) -> alt.VConcatChart:
    """A panel for every metric: seconds a frame against accuracy, bars for intervals."""
    panels = []
    for metric, title in PANELS.items():
        base = alt.Chart(points[points["metric"] == metric]).encode(
            x=alt.X("frame_seconds:Q", title="seconds a frame, rendering and fit included").scale(
                type="log"
            ),
            color=alt.Color("name:N", title=None).legend(symbolOpacity=1),
        )
        dots = base.mark_point(filled=True, size=70).encode(
            y=alt.Y("value:Q", title=title),
            shape=alt.Shape("group:N", title="pictures"),
            tooltip=["name", "frame_seconds", "value", "low", "high"],
        )
        bars = base.mark_rule(opacity=0.4).encode(y="low:Q", y2="high:Q")
        panels.append((bars + dots).properties(width=560, height=260))
    return alt.vconcat(*panels).configure_view(stroke=None)
