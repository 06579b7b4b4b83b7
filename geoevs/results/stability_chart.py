"""Curves over the levels of a stressor, one line for every method."""

from pathlib import Path

import altair as alt
import numpy as np
import pandas as pd

from geoevs.core.files import write_text
from geoevs.protocol.stressors import STRESSORS
from geoevs.results.chart_pages import HOLLOW, write_page
from geoevs.results.escaping import csv_text

PANELS = {
    "sparse_psnr": "sparse PSNR, dB",
    "psnr": "PSNR over all pixels, dB",
    "psnr_moving": "PSNR inside boxes of moving cars, dB",
    "psnr_still": "PSNR outside of them, dB",
    "psnr_supported": "PSNR where reprojection has support, dB",
    "psnr_new": "PSNR where it has none, dB",
}
COLUMNS = ["dataset", "name", "control", "level", "metric", "mean", "low", "high", "lacking"]


def write_stability_chart(stem: Path, table: pd.DataFrame, stressor: str) -> None:
    """Draw every entrant over a stressor's levels as CSV, PNG and a page that needs no network.

    Args:
        stem: the path without suffix.
        table: what `make_stability_table` made.
        stressor: one of STRESSORS.
    """
    rows = curves(table, stressor)
    page = stability_curves(rows, stressor)
    write_text(stem.with_suffix(".csv"), csv_text(rows))
    write_page(stem, page)


def curves(table: pd.DataFrame, stressor: str) -> pd.DataFrame:
    """The rows of the stability table that a stressor's chart shows, in order of severity.

    Returns:
        COLUMNS, and `severity`: the level as text, `clean` for no stress.
    """
    rows = table[(table["stressor"] == stressor) & table["metric"].isin(PANELS)][COLUMNS]
    rows = rows.sort_values(
        "level", ascending=not STRESSORS[stressor].falling, na_position="first", kind="stable"
    )
    names = ["clean" if np.isnan(level) else f"{level:g}" for level in rows["level"]]
    return rows.assign(severity=names)


def stability_curves(rows: pd.DataFrame, stressor: str) -> alt.VConcatChart:
    """One panel for every data set and metric: severity against score, bands for intervals."""
    order = list(dict.fromkeys(rows["severity"]))
    panels = []
    for (dataset, metric), points in rows.groupby(["dataset", "metric"], sort=False):
        base = alt.Chart(points).encode(
            x=alt.X("severity:N", title=STRESSORS[stressor].title, sort=order).axis(labelAngle=0),
            color=alt.Color("name:N", title=None).legend(symbolOpacity=1),
        )
        line = base.mark_line(point=True).encode(
            y=alt.Y("mean:Q", title=PANELS[metric]).scale(zero=False),
            strokeDash=alt.StrokeDash("control:N", title="control"),
            tooltip=["name", "severity", "mean", "low", "high", "lacking"],
        )
        title: str | alt.TitleParams = str(dataset)
        if (points["lacking"] > 0).any():
            title = alt.TitleParams(title, subtitle=HOLLOW)
            hollow = base.transform_filter("datum.lacking > 0")
            mark = hollow.mark_point(filled=False, fill="white", opacity=1, size=60)
            line += mark.encode(y="mean:Q")
        band = base.mark_area(opacity=0.12).encode(y="low:Q", y2="high:Q")
        panels.append((band + line).properties(width=620, height=280, title=title))
    return alt.vconcat(*panels).configure_view(stroke=None)
