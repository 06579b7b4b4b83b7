"""Pictures of accuracy over size: what each scene needs, and what was chosen for it."""

from pathlib import Path

import altair as alt
import numpy as np
import pandas as pd

from geoevs.core.files import write_text
from geoevs.results.chart_pages import HOLLOW, WIDTH, layered, stacked, write_page
from geoevs.results.complexity import ADDS_SIZES, CHARTED, CHOSEN, TITLE, size_curves
from geoevs.results.entrants import Entrants
from geoevs.results.escaping import csv_text
from geoevs.results.settings import TableSettings

COLUMNS = 4
"""Panels side by side."""

NOTHING = (
    "No fixed size was run.",
    ADDS_SIZES,
    "adds some.",
)
SHAPES = {"fixed": "circle", "chosen": "diamond"}


def write_size_chart(
    stem: Path,
    scores: pd.DataFrame,
    costs: pd.DataFrame,
    settings: TableSettings,
    entrants: Entrants,
) -> None:
    """Draw accuracy over size as CSV, PNG and a page that needs no network.

    Args:
        stem: the path without suffix.
        scores: the run's score rows.
        costs: its cost rows.
        settings: the config's `tables` section.
        entrants: who plays.
    """
    table = size_curves(scores, costs, settings, entrants)
    page = size_chart(table)
    write_text(stem.with_suffix(".csv"), csv_text(table))
    write_page(stem, page)


def size_chart(table: pd.DataFrame) -> alt.VConcatChart:
    """A panel for every scene, those of a method together, smallest chosen size first.

    Args:
        table: what `size_curves` made; where it is empty, the page says so.
    """
    if table.empty:
        note = alt.Chart(pd.DataFrame({"note": [list(NOTHING)]})).mark_text(fontSize=13)
        return alt.vconcat(note.encode(text="note:N").properties(width=2 * WIDTH, height=80))
    rows = []
    for (dataset, _), fits in table.groupby(["dataset", "method"], sort=False):
        scenes = fits.groupby("scene", sort=False)
        panels = [_panel(of_scene, str(scene)) for scene, of_scene in scenes]
        title = f"{dataset}: {fits['name'].iloc[0]}"
        rows.append(alt.concat(*panels, columns=COLUMNS, title=title))
    title = f"{TITLE}. Scenes by the size chosen there (dashed); bars: intervals."
    title += f" {HOLLOW}." if table["lacking"].any() else ""
    return stacked(rows, title)


def _panel(fits: pd.DataFrame, scene: str) -> alt.LayerChart:
    """The metrics of one scene over size: a line through fixed sizes, and the chosen one."""
    data = fits.assign(kind=np.where(fits["variant"] == CHOSEN, "chosen", "fixed"))
    data = data.drop(columns=["dataset", "method", "name"])
    x = alt.X("primitives:Q", title="primitives")
    x = x.scale(type="log", nice=False, padding=15).axis(tickCount=5, format="~s")
    y = alt.Y("mean:Q", title="dB ↑").scale(zero=False)
    color = alt.Color("metric:N", title="Metric").scale(domain=list(CHARTED)).legend(orient="top")
    base = alt.Chart(data).encode(x=x, color=color)
    shape = alt.Shape("kind:N", title="Size").scale(
        domain=list(SHAPES), range=list(SHAPES.values())
    )
    tips = [
        alt.Tooltip("variant:N", title="size"),
        alt.Tooltip("primitives:Q", format=",.0f"),
        alt.Tooltip("fit_seconds:Q", title="fit, seconds", format=".4g"),
        "metric:N",
        *(alt.Tooltip(f"{end}:Q", format=".4g") for end in ("mean", "low", "high")),
        alt.Tooltip("n:Q", title="views"),
        alt.Tooltip("lacking:Q", title="views that it lacks"),
    ]
    fixed = base.transform_filter("datum.kind == 'fixed' && datum.lacking == 0")
    lines = fixed.mark_line().encode(y=y)
    bars = base.mark_rule().encode(y=alt.Y("low:Q", title="dB ↑"), y2="high:Q")
    size = alt.condition("datum.kind == 'chosen'", alt.value(150), alt.value(45))
    layers = [lines, bars]
    for filled in (True, False) if (data["lacking"] > 0).any() else (True,):
        some = base.transform_filter(f"datum.lacking {'==' if filled else '>'} 0")
        dots = some.mark_point(filled=filled, opacity=1)
        layers.append(dots.encode(y=y, shape=shape.legend(orient="top"), size=size, tooltip=tips))
    chosen = fits["chosen"].iloc[0]
    title = f"{scene}: no chosen size"
    if np.isfinite(chosen):
        mark = alt.Chart(pd.DataFrame({"primitives": [chosen]}))
        layers.insert(0, mark.mark_rule(strokeDash=[4, 3], color="#888").encode(x=x))
        title = f"{scene}: {chosen:,.0f} chosen"
    return layered(layers, title)
