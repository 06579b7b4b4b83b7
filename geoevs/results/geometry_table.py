"""Depth of recorded views before and after fine-tuning, with what it costs (paper section 3.2)."""

import math
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs.protocol.depth_scoring import CONTROL, COVERAGE, FINE_TUNED, PRETRAINED
from geoevs.results.bootstrap import summarise
from geoevs.results.formats import latex_tabular, markdown_grid, write_formats
from geoevs.results.settings import TableSettings

METRICS = {"abs_rel": "↓", "rmse": "↓", "delta_1.25": "↑", COVERAGE: "↑"}
TITLE = "Depth of recorded views (paper section 3.2)"
LEGEND = """Mean [bootstrap interval over frames within scenes]; n = scored views, up to 80 m;
`truth` = dense depth, or LiDAR points that no model saw; `coverage` = the share of the truth's
pixels that the model gives a depth, which alone the other metrics compare; `scale` = fitted to the
other LiDAR points, or not at all. Changes are fine-tuned minus pretrained, of the same views, and
left out where nothing changed. `lidar`, the completed points themselves, is a *control*. Seconds a
frame are medians.
"""
_ENTRANT = ["dataset", "model", "stage", "scale"]


def make_geometry_table(scores: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """A row for every data set, model, stage and scale.

    Args:
        scores: rows of `depth_scores`.
        settings: the config's tables section.

    Returns:
        For every metric its mean over frames and the ends of its interval (`_low`, `_high`), and
        on fine-tuned rows the paired `_change` from the pretrained network with its own; `n` scored
        views, `truth`, `seconds` a frame and `parameters`.
    """
    measured = summarise(scores, [*_ENTRANT, "metric"], *settings.bootstrap)
    changed = summarise(_changes(scores), [*_ENTRANT, "metric"], *settings.bootstrap)
    table = []
    for key, rows in scores.groupby(_ENTRANT, sort=False):
        row: dict[str, Any] = dict(zip(_ENTRANT, key, strict=True))
        for suffix, summary in (("", measured), ("_change", changed)):
            cells = summary[(summary[_ENTRANT] == list(key)).all(axis=1)].set_index("metric")
            for metric in METRICS:
                for column, end in (("mean", ""), ("low", "_low"), ("high", "_high")):
                    row[metric + suffix + end] = cells[column].get(metric, math.nan)
        once = rows[rows["metric"] == next(iter(METRICS))]
        row["n"] = int(once["value"].notna().sum())
        row["truth"] = " ".join(once["truth"].unique())
        row["seconds"] = once.drop_duplicates(["scene", "frame"])["seconds"].median()
        row["parameters"] = int(once["parameters"].iloc[0])
        table.append(row)
    return pd.DataFrame(table)


def write_geometry_table(stem: Path, scores: pd.DataFrame, settings: TableSettings) -> None:
    """Write `make_geometry_table` as CSV, Markdown and LaTeX; `stem` is the path without suffix."""
    table = make_geometry_table(scores, settings)
    write_formats(stem, table, geometry_markdown, geometry_latex)


def geometry_markdown(table: pd.DataFrame) -> str:
    """A heading, one table for every data set, and a legend."""
    parts = [f"# {TITLE}\n"]
    for dataset, rows in table.groupby("dataset", sort=False):
        parts.append(f"## {dataset}\n\n{markdown_grid(*_grid(rows))}\n")
    parts.append(LEGEND)
    return "\n".join(parts)


def geometry_latex(table: pd.DataFrame) -> str:
    """A booktabs tabular for every data set, the control set apart by a rule."""
    parts = [f"% {TITLE}"]
    for dataset, rows in table.groupby("dataset", sort=False):
        groups = rows["stage"].eq(CONTROL).tolist()
        parts.append(f"% {dataset}\n{latex_tabular(*_grid(rows), groups)}")
    return "\n\n".join(parts) + "\n"


def _changes(scores: pd.DataFrame) -> pd.DataFrame:
    """Rows of the fine-tuned network whose values are what fine-tuning added to each."""
    view = ["dataset", "scene", "frame", "camera", "model", "scale", "metric"]
    before = scores.loc[scores["stage"] == PRETRAINED, [*view, "value"]]
    after = scores[scores["stage"] == FINE_TUNED]
    paired = after.merge(before, on=view, suffixes=("", "_before"), validate="one_to_one")
    return paired.assign(value=paired["value"] - paired["value_before"])


def _grid(rows: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    columns = [
        (metric + suffix, f"{metric} {'change' if suffix else arrow}")
        for metric, arrow in METRICS.items()
        for suffix in ("", "_change")
        if (rows[f"{metric}_change"].any() if suffix else rows[metric].notna().any())
    ]
    header = ["model", "stage", "scale", *(title for _, title in columns)]
    body = []
    for row in rows.to_dict("records"):
        name = f"*{row['model']}*" if row["stage"] == CONTROL else row["model"]
        line = [name, row["stage"], row["scale"]]
        line += [_cell(row, column) for column, _ in columns]
        line += [row["truth"], str(row["n"]), f"{row['seconds']:.3g}", f"{row['parameters']:,}"]
        body.append(line)
    return [*header, "truth", "n", "s / frame", "parameters"], body


def _cell(row: dict[str, Any], column: str) -> str:
    """The mean with its interval; changes have their sign."""
    form = "{:+z.3f}" if column.endswith("_change") else "{:.3f}"
    if math.isnan(row[column]):
        return ""
    text = form.format(row[column])
    if not math.isnan(row[f"{column}_low"]):
        text += f" [{form.format(row[f'{column}_low'])}, {form.format(row[f'{column}_high'])}]"
    return text
