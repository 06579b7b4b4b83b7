"""Tables for people: Markdown and LaTeX, with intervals, flags and the paper's numbers."""

import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pandas as pd

from geoevs.core.files import write_text
from geoevs.protocol.entries import FLOOR
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.set_metrics import SET_METRICS
from geoevs.results.entrants import Entrants
from geoevs.results.escaping import csv_text, latex_text, markdown_cell, markdown_text
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import TableSpec, table_spec
from geoevs.results.tables import make_table
from geoevs.results.views import MARK, MARKED

LEGEND = f"""Mean [bootstrap interval over frames within scenes]; n = scored views; *controls* in
italics. `paradigm` and `extra prior` are what a method says of itself; of methods that were not
run, what the paper says. `paper` = printed in the paper, measured there on Waymo (its SSIM may
score borders too, which adds up to 0.005: docs/protocol.md). ▼ = worse than
the floor, the control {FLOOR}. ∞ = exact in some frame. `floor` = the same distance between true
images of other instants. Empty = not run, not measurable here, or not said.
{MARKED}
"""


Text = Callable[[pd.DataFrame], str]
"""From a table to how people read it."""


def write_table(
    stem: Path,
    name: str,
    scores: pd.DataFrame,
    settings: TableSettings,
    entrants: Entrants,
    sets: pd.DataFrame | None = None,
) -> None:
    """Write one of TABLES as CSV, Markdown and LaTeX.

    Args:
        stem: the path without suffix.
        name: one of TABLES.
        scores: score rows.
        settings: the config's `tables` section.
        entrants: who plays.
        sets: rows of distances between sets, if there are any.

    Raises:
        GeoEvsError: there is no such table, or rows come from different protocols.
    """
    spec = table_spec(name)
    table = make_table(name, scores, settings, entrants, sets)
    write_formats(stem, table, partial(to_markdown, spec), partial(to_latex, spec))


def write_formats(
    stem: Path, table: pd.DataFrame, markdown: Text, latex: Text | None = None
) -> None:
    """Write a table as CSV, Markdown and, where it has that form, LaTeX.

    Args:
        stem: the path without suffix.
        table: what the CSV holds.
        markdown: makes text of it.
        latex: likewise, or None.
    """
    write_text(stem.with_suffix(".csv"), csv_text(table))
    write_text(stem.with_suffix(".md"), markdown(table))
    if latex is not None:
        write_text(stem.with_suffix(".tex"), latex(table))


def to_markdown(spec: TableSpec, table: pd.DataFrame) -> str:
    """A heading, one table for every data set, and a legend."""
    parts = [f"# {spec.title}\n"]
    for dataset, rows in table.groupby("dataset", sort=False):
        header, body = _grid(spec, rows)
        parts.append(f"## {dataset}\n\n{markdown_grid(header, body)}\n")
        parts += [f"{text.capitalize()}.\n" for text in _outside(rows)]
    parts.append(LEGEND)
    parts += [f"Not measured: {markdown_text(why)}.\n" for why in sorted(_unmeasured(table))]
    return "\n".join(parts)


def _unmeasured(rows: pd.DataFrame) -> set[str]:
    """Metrics without weights on this machine, each with the reason."""
    return {why for cell in rows["unmeasured"] for why in cell.split("; ") if why}


def _outside(rows: pd.DataFrame) -> list[str]:
    """What is said of views in no bin; nothing where all are in one."""
    return [text for text in rows.get("outside", pd.Series(dtype=str)).unique() if text]


def markdown_grid(header: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """Cells as a Markdown table; all in them is text, but for stars around a whole cell."""
    lines = (header, ["---"] * len(header), *body)
    return "\n".join(f"| {' | '.join(map(_markdown_cell, line))} |" for line in lines)


def _markdown_cell(cell: str) -> str:
    stars, text = _parted(cell)
    return f"{stars}{markdown_cell(text)}{stars}"


def _parted(cell: str) -> tuple[str, str]:
    """The stars around a whole cell, which set a control in italics, and the text within them."""
    found = re.fullmatch(r"(\*{1,2})([^*].*)\1", cell, re.DOTALL)
    return (found[1], found[2]) if found else ("", cell)


def to_latex(spec: TableSpec, table: pd.DataFrame) -> str:
    """A booktabs tabular for every data set, controls set apart by a rule."""
    parts = [f"% {spec.title}"]
    for dataset, rows in table.groupby("dataset", sort=False):
        parts.append(f"% {dataset}\n{latex_tabular(*_grid(spec, rows), rows['group'].tolist())}")
        parts += [f"% {text}" for text in _outside(rows)]
    return "\n\n".join(parts) + "\n"


def latex_tabular(
    header: Sequence[str], body: Sequence[Sequence[str]], groups: Sequence[str]
) -> str:
    """Cells as a booktabs tabular, with a rule wherever the lines' group changes."""
    lines = [
        r"\begin{tabular}{l" + "c" * (len(header) - 1) + "}",
        r"\toprule",
        _latex_line(header),
        r"\midrule",
    ]
    for position, line in enumerate(body):
        if position and groups[position] != groups[position - 1]:
            lines.append(r"\midrule")
        lines.append(_latex_line(line))
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])


def _grid(spec: TableSpec, rows: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    lacking = {why.partition(":")[0] for why in _unmeasured(rows)}
    metrics = [
        metric
        for metric in (*spec.metrics, *spec.set_metrics)
        if metric in lacking or _has_content(rows, metric)
    ]
    about = {"bin": "bin"} if spec.bins else {"paradigm": "paradigm", "extra_prior": "extra prior"}
    header = ["method", *about.values()]
    for metric in metrics:
        if f"{metric}_paper" in rows:
            header.append(f"{metric} {arrow(metric)} paper")
        header.append(f"{metric} {arrow(metric)}")
        if metric in spec.set_metrics and rows[f"{metric}_floor"].notna().any():
            header.append(f"{metric} floor")
    body = []
    for row in rows.to_dict("records"):
        name = row["name"]
        line = [f"*{name}*" if row["group"] == "control" else name]
        line += [row[column] for column in about]
        for metric in metrics:
            if f"{metric}_paper" in rows:
                line.append(number(metric, row[f"{metric}_paper"]))
            without = metric in lacking and row["unmeasured"]
            line.append("no weights" if without else _measured(metric, row))
            if f"{metric} floor" in header:
                line.append(number(metric, row[f"{metric}_floor"]))
        body.append([*line, str(row["n"]) if row["n"] else "", row["note"]])
    return [*header, "n", "note"], body


def _has_content(rows: pd.DataFrame, metric: str) -> bool:
    return f"{metric}_paper" in rows or rows[metric].notna().any()


def arrow(metric: str) -> str:
    """Which way a metric is better."""
    return "↑" if metric not in SET_METRICS and METRICS[metric].higher_is_better else "↓"


def number(metric: str, value: float) -> str:
    """A metric's value as tables write it; nothing for NaN."""
    if math.isnan(value):
        return ""
    if math.isinf(value):
        return "∞"
    return f"{value:.{decimals(metric)}f}"


def decimals(metric: str) -> int:
    """How many of them tables write of a metric."""
    return 2 if "psnr" in metric or metric in ("fid", "efficientnet_fd") else 3


def with_interval(form: str, value: float, low: float, high: float) -> str:
    """A value and the ends of its interval, if it has one; nothing for NaN.

    >>> with_interval("{:+.1f}", 0.5, 0.2, 0.8), with_interval("{:+.1f}", -1, math.nan, math.nan)
    ('+0.5 [+0.2, +0.8]', '-1.0')
    """
    if math.isnan(value):
        return ""
    text = form.format(value)
    return text if math.isnan(low) else f"{text} [{form.format(low)}, {form.format(high)}]"


def _measured(metric: str, row: dict) -> str:
    text = number(metric, row[metric])
    if text and not math.isnan(row[f"{metric}_low"]) and not math.isinf(row[metric]):
        text += (
            f" [{number(metric, row[f'{metric}_low'])}, {number(metric, row[f'{metric}_high'])}]"
        )
    text += f" {MARK}" if metric in row["partial"].split() else ""
    return text + (" ▼" if metric in row["below_floor"].split() else "")


def _latex_line(cells: Sequence[str]) -> str:
    return " & ".join(latex_text(_parted(cell)[1]) for cell in cells) + r" \\"
