"""Tables of 3-D detection metrics, from rows of counts alone."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pandas as pd

from geoevs.core.parquet import write_parquet
from geoevs.detection.metrics import WEIGHTS, metrics_table
from geoevs.detection.rules import RULES
from geoevs.results.escaping import markdown_text
from geoevs.results.formats import markdown_grid, with_interval, write_formats

RESAMPLES, CONFIDENCE = 1000, 0.95
"""Of intervals."""

COUNTS, TABLE = "counts.parquet", "detection"
"""What is left in a folder: rows of counts, and the tables' name without suffix."""

LEGEND = """Value [bootstrap interval over scenes], from 0 to 1. AP counts a match as 1, APH by its
heading, APL by its longitudinal affinity. Empty = no truth. No interval = truths in one scene
alone. `mean` = over vehicles, pedestrians and cyclists that have truths. `flipped` = matches whose
heading is off by more than 90 degrees.
"""


def detection_table(counts: pd.DataFrame) -> pd.DataFrame:
    """`metrics_table` of counts, without APL where no longitudinal error is tolerated."""
    table = metrics_table(counts, RESAMPLES, CONFIDENCE)
    if RULES[counts["rules"].iloc[0]].tolerance is None:
        table = table.drop(columns=["apl", "apl_low", "apl_high"])
    return table


def detection_text(table: pd.DataFrame) -> str:
    """A table of `detection_table` for the terminal, in aligned columns."""
    header, body = _grid(table)
    return pd.DataFrame(body, columns=header).to_string(index=False)


def write_detection(
    folder: Path, counts: pd.DataFrame, table: pd.DataFrame, remarks: Sequence[str]
) -> None:
    """Write counts as COUNTS, and their table as CSV and Markdown.

    Args:
        folder: where; other files in it stay.
        counts: rows of COUNT_TYPES.
        table: `detection_table` of them.
        remarks: sentences to put below the table.
    """
    write_parquet(folder / COUNTS, counts)
    rules = counts["rules"].iloc[0]
    write_formats(folder / TABLE, table, partial(_markdown, rules=rules, remarks=remarks))


def _markdown(table: pd.DataFrame, rules: str, remarks: Sequence[str]) -> str:
    said = "".join(f"{markdown_text(remark)}\n\n" for remark in remarks)
    return f"# 3-D detection, {rules} rules\n\n{markdown_grid(*_grid(table))}\n\n{said}{LEGEND}"


def _grid(table: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    shown = [name for name in WEIGHTS if name in table]
    header = ["breakdown", "class", "bin", "level", *(name.upper() for name in shown)]
    body = []
    for row in table.to_dict("records"):
        line = [row["breakdown"], row["class"], row["bin"], str(row["level"])]
        line += [
            with_interval("{:.4f}", *(row[name + end] for end in ("", "_low", "_high")))
            for name in shown
        ]
        flipped = with_interval("{:.0%}", row["flipped"], math.nan, math.nan)
        body.append([*line, str(row["truths"]), str(row["predictions"]), flipped])
    return [*header, "truths", "predictions", "flipped"], body
