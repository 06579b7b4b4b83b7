"""Pictures of the audit: bias and rank correlation as support shrinks."""

import altair as alt
import pandas as pd

UNITS = {"dB": "psnr", "SSIM": "ssim", "colour from 0 to 1": "mae|rmse"}
"""Axes of bias, by the pattern that metrics of a unit match."""


def agreement_chart(table: pd.DataFrame) -> alt.VConcatChart:
    """Bias against dense twins, and Kendall's tau, over the reference's support."""
    if table.empty:
        return _nothing()
    bias = _bias(table, "sparse minus dense")
    tau = _lines(table, "tau", "Kendall's tau of methods, sparse against dense")
    return alt.vconcat(*bias, tau).configure_view(stroke=None)


def support_chart(table: pd.DataFrame) -> alt.VConcatChart:
    """Bias over random pixels of the truth: what support alone does to a metric."""
    if table.empty:
        return _nothing()
    shown = table.rename(columns={"share": "support", "mean": "bias"})
    shown = shown.rename(columns={"low": "bias_low", "high": "bias_high"})
    return alt.vconcat(*_bias(shown, "bias of support")).configure_view(stroke=None)


def _bias(table: pd.DataFrame, title: str) -> list[alt.LayerChart]:
    """A panel for every unit that the table's metrics have."""
    found = {unit: table[table["metric"].str.contains(some)] for unit, some in UNITS.items()}
    return [_lines(rows, "bias", f"{title}, {unit}") for unit, rows in found.items() if len(rows)]


def _nothing() -> alt.VConcatChart:
    note = alt.Chart(pd.DataFrame({"note": ["nobody knows dense truth here"]}))
    return alt.vconcat(note.mark_text().encode(text="note:N").properties(width=560, height=60))


def _lines(rows: pd.DataFrame, what: str, title: str) -> alt.LayerChart:
    base = alt.Chart(rows).encode(
        x=alt.X("support:Q", title="support ratio (valid pixels / all pixels)").scale(type="log"),
        color=alt.Color("metric:N", title=None).legend(symbolOpacity=1),
        detail="dataset:N",
    )
    line = base.mark_line(point=True).encode(
        y=alt.Y(f"{what}:Q", title=title),
        tooltip=["dataset", "metric", "support", what, f"{what}_low", f"{what}_high"],
    )
    band = base.mark_area(opacity=0.12).encode(y=f"{what}_low:Q", y2=f"{what}_high:Q")
    return (band + line).properties(width=560, height=230)
