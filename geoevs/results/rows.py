"""The one reader of a run's rows, which may be a stranger's: columns, types and names."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.names import check_name
from geoevs.core.parquet import read_parquet
from geoevs.core.text import clean
from geoevs.protocol.audit import AUDIT_TYPES
from geoevs.protocol.depth_scoring import DEPTH_SCORE_TYPES
from geoevs.protocol.rows import COST_TYPES, SCORE_TYPES
from geoevs.protocol.set_scoring import SET_TYPES

ROW_FILES = {
    layout.SCORES: SCORE_TYPES,
    layout.COSTS: COST_TYPES,
    layout.SET_SCORES: SET_TYPES,
    layout.DEPTH_SCORES: DEPTH_SCORE_TYPES,
    layout.STABILITY_SCORES: SCORE_TYPES,
    layout.AUDIT_ROWS: AUDIT_TYPES,
}
"""The columns and types of each of a run's files of rows."""

NEVER_EMPTY = (layout.SCORES, layout.COSTS)
"""Files without which there is nothing to say."""

FIT = ("dataset", "scene", "method", "variant", "seed", "stressor", "fingerprint")
"""Columns of score rows that tell fits apart, and what each was scored under."""

TABLE_COLUMNS = (
    *FIT,
    *("frame", "target", "split", "metric", "value", "support_ratio", "pose_offset", "level"),
    *("status", "reason"),
)
"""Columns of score rows that tables and charts are made from."""

NAMES = ("dataset", "target", "camera", "method", "variant", "split", "metric", "model", "sources")
"""Columns whose texts become parts of paths, or words that commands take, as scenes do."""

KNOWN = ("support_ratio", "pose_offset", "lateral_shift")
"""Columns of numbers that every view has, whatever became of it."""

FREE = ("reason", "note", "host", "cpu")
"""Columns of what methods, errors and machines said."""

LONGEST = 1000
"""Most characters of such a text that are kept; what the suite itself writes is shorter."""


def read_rows(
    path: Path,
    name: str,
    columns: Sequence[str] | None = None,
    where: Mapping[str, Collection[str]] | None = None,
    and_first_of: Sequence[str] = (),
) -> pd.DataFrame:
    """Rows of a run, checked; names are safe in paths, and what others wrote is one line.

    Args:
        path: the file.
        name: which of ROW_FILES it is; texts of score rows are categories, in the alphabet's order.
        columns: those to read; all of them by default.
        where: columns of text, and the values of which rows must have one to be kept.
        and_first_of: the first row of every combination of these columns' values is kept too.

    Raises:
        GeoEvsError: the file is missing, damaged, empty where none may be, or has a wrong column,
            type or name; the sentence names the file and the column.
    """
    categories = name == layout.SCORES
    rows = read_parquet(path, ROW_FILES[name], columns, where, and_first_of, categories)
    if rows.empty and (where is None or and_first_of) and name in NEVER_EMPTY:
        raise GeoEvsError(f"{path} has no rows; make it again")
    for column in rows.columns.intersection(NAMES):
        for text in rows[column].unique():
            if text or name != layout.AUDIT_ROWS:  # some of its rows are of no entrant
                check_name(text, column, path)
    for text in rows["scene"].unique() if "scene" in rows else ():
        check_scene(text, path)
    for column in rows.columns.intersection(KNOWN):
        if name != layout.AUDIT_ROWS and not np.isfinite(rows[column]).all():
            raise GeoEvsError(
                f"{path}: column '{column}' has values that are no numbers; make the file again"
            )
    for column in rows.columns.intersection(FREE):
        said = {text: clean(text, LONGEST) for text in rows[column].unique()}
        if any(text != line for text, line in said.items()):
            lines = rows[column].astype("string").map(said)
            rows[column] = lines.astype("category" if categories else "string")
    return rows


def read_scores(path: Path, where: Mapping[str, Collection[str]]) -> pd.DataFrame:
    """The score rows that a table is made from, with TABLE_COLUMNS, and the first row of every fit.

    The first rows say who took part, whatever the table shows; those that make tables leave them
    out of means, as they leave out all rows of other splits and metrics.

    Args:
        path: the run's score rows.
        where: columns of text, and the values that the table's rows have there.

    Raises:
        GeoEvsError: see `read_rows`.
    """
    return read_rows(path, layout.SCORES, TABLE_COLUMNS, where, FIT)


def check_scene(name: str, path: Path) -> None:
    """Refuse a scene's name that could leave its folder.

    Args:
        name: NAME, or NAME@FIRST-LAST, and the options of its world.
        path: where it stands, for errors.

    Raises:
        GeoEvsError: it could.
    """
    for part in name.split("@", 1):
        check_name(part, "scene", path)
