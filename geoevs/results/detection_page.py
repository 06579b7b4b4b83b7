"""Table 3 and the task metrics as people read them."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs.results.detection_stage import DETAILS, GAINS
from geoevs.results.formats import latex_tabular, markdown_grid, with_interval, write_formats

TITLES = {
    "let_mapl": "LET-mAPL ↑",
    "let_map": "LET-mAP ↑",
    "let_maph": "LET-mAPH ↑",
    "l1_aph_vehicle": "L1 APH vehicle ↑",
    "ap_2m_vehicle": "AP 2 m vehicle ↑",
}
"""Headings of metrics that people are shown; the CSV has more."""

LEGEND = """Percent [bootstrap interval over test scenes and seeds]. `gain` = over the recorded
views, paired over the same scenes and seeds: more than chance only where its interval leaves out 0.
LET-m... = mean over classes that have truths; L1 APH is Waymo's plain one; AP 2 m = centres within
2 m; `flipped` = matches within 2 m whose heading is off by more than 90 degrees. `paper` = printed
in the paper, measured there on Waymo. `views` = pictures of a frame. `s a frame` = detection,
rendering and the fit's share. *Controls* in italics. No value = something failed, see `note`.
"""


def write_detection_stage(stem: Path, table: pd.DataFrame) -> None:
    """Write what `detection_stage_table` made as CSV, Markdown and LaTeX."""
    write_formats(stem, table, _markdown, _latex)


def _markdown(table: pd.DataFrame) -> str:
    title, numbers = "# Detection with generated views", markdown_grid(*_grid(table))
    details = markdown_grid(*_details(table))
    return f"{title}\n\n{numbers}\n\n{LEGEND}\n## By class and range\n\n{details}\n"


def _details(table: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Numbers of classes and ranges that have truths."""
    shown = [name for name in DETAILS if table[name].notna().any()]
    header = ["setting", *(name.replace("let_", "LET-").replace("_", " ") for name in shown)]
    body = [
        [row["name"], *(_cell("{:.1f}", row, name) for name in shown)]
        for row in table.to_dict("records")
    ]
    return header, body


def _latex(table: pd.DataFrame) -> str:
    return latex_tabular(*_grid(table), table["group"].tolist()) + "\n"


def _grid(table: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    header = ["setting", "views", "needs"]
    for metric, title in TITLES.items():
        header += [f"{title} paper"] if _has_paper(table, metric) else []
        header += [title, "gain"] if metric in GAINS else [title]
    header += ["flipped", "truths", "predictions", "frames", "seeds"]
    header += ["training s", "s a frame", "note"]
    return header, [_line(row, table) for row in table.to_dict("records")]


def _has_paper(table: pd.DataFrame, metric: str) -> bool:
    return metric in GAINS and bool(table[f"{metric}_paper"].notna().any())


def _line(row: Mapping[str, Any], table: pd.DataFrame) -> list[str]:
    name = f"*{row['name']}*" if row["group"] == "control" else row["name"]
    line = [name, str(row["views"]) if row["views"] else "", row["needs"]]
    for metric in TITLES:
        if _has_paper(table, metric):
            line.append(with_interval("{:.1f}", row[f"{metric}_paper"], math.nan, math.nan))
        line.append(_cell("{:.1f}", row, metric))
        if metric in GAINS:
            line.append(_cell("{:+.1f}", row, f"{metric}_gain"))
    line += [_cell("{:.0f} %", row, "flipped"), str(row["truths"] or "")]
    line += [_cell("{:.0f}", row, "predictions"), str(row["frames"] or ""), str(row["seeds"])]
    line += [f"{row['training_seconds']:.0f}", f"{row['frame_seconds']:.2f}"]
    return [*line, row["note"]]


def _cell(form: str, row: Mapping[str, Any], name: str) -> str:
    ends = (row.get(f"{name}{end}", math.nan) for end in ("_low", "_high"))
    return with_interval(form, row[name], *ends)


TASK_LEGEND = """NTA-IoU in percent [bootstrap interval over scenes and seeds]: the mean, over
labelled vehicles that a camera shows, of the best IoU in the image of a box that the detector of
the recorded views predicts. The rig stands so many metres to the left of where it was recorded; at
0 it sees the recorded pictures. *Controls* in italics. No value = something failed, see `note`.
"""


def write_task_offsets(stem: Path, table: pd.DataFrame) -> None:
    """Write what `task_table` made as CSV, Markdown and LaTeX."""
    write_formats(stem, table, _task_markdown, _task_latex)


def _task_markdown(table: pd.DataFrame) -> str:
    grid = markdown_grid(*_task_grid(table))
    return f"# Detection from a rig that moved aside\n\n{grid}\n\n{TASK_LEGEND}"


def _task_latex(table: pd.DataFrame) -> str:
    groups = table.drop_duplicates("label")["group"].tolist()
    return latex_tabular(*_task_grid(table), groups) + "\n"


def _task_grid(table: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    offsets = sorted(table["offset"].dropna().unique())
    body = []
    for _, rows in table.groupby("label", sort=False):
        first = rows.iloc[0]
        cells = {row["offset"]: _cell("{:.1f}", row, "nta_iou") for row in rows.to_dict("records")}
        name = f"*{first['name']}*" if first["group"] == "control" else first["name"]
        line = [name, first["needs"], *(cells.get(offset, "") for offset in offsets)]
        body.append([*line, str(first["vehicles"] or ""), str(first["seeds"]), first["note"]])
    header = ["pictures", "needs", *(f"{offset:+g} m" if offset else "0" for offset in offsets)]
    return [*header, "vehicles", "seeds", "note"], body
