"""The page of the stability suite in words: where methods break, what stress costs, seed spread."""

from collections.abc import Callable
from operator import itemgetter
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs.core.files import write_text
from geoevs.protocol.entries import FLOOR
from geoevs.protocol.stability_scoring import SPREADS
from geoevs.results.entrants import ENTRANT, Entrants
from geoevs.results.escaping import csv_text
from geoevs.results.formats import markdown_grid, with_interval
from geoevs.results.settings import TableSettings
from geoevs.results.stability import (
    JUDGED_BY,
    breaking_points,
    make_stability_table,
    seed_spread,
)
from geoevs.results.views import MARK, MARKED

BREAKING_LEGEND = f"""The first level at which a method's mean is below that of the best control
under the same stress [over resamples of frames and draws: from the mildest to the hardest].
*clean*: it is below before any stress. *none*: it stays above up to the hardest level. {MARK} = it
breaks there because it lacks views that others delivered.
"""

LEFT_LEGEND = f"""Mean at a stressor's hardest level in dB, and that minus the mean at its mildest
[over resamples of frames and draws]. *Controls* in italics. ▼ = below the floor, the control
{FLOOR}, under the same stress. A yaw that ends at a recorded camera is easy again.
{MARKED}
"""

SPREAD_LEGEND = f"""Standard deviation over draws without stress, in 8-bit levels, where raw
reprojection supports a pixel and where not.
{MARKED}
"""


def write_stability(
    folder: Path, scores: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> None:
    """Write the curves, the breaking points and the seed spread as CSV, and the page in words.

    Args:
        folder: where `stability.csv`, `breaking_points.csv`, `seed_spread.csv` and
            `breaking_points.md` go.
        scores: the suite's score rows.
        settings: the config's `tables` section.
        entrants: who plays.

    Raises:
        GeoEvsError: the rows come from different protocols.
    """
    tables = {
        "stability": make_stability_table(scores, settings, entrants),
        "breaking_points": breaking_points(scores, settings, entrants),
        "seed_spread": seed_spread(scores, settings, entrants),
    }
    for name, table in tables.items():
        write_text(folder / f"{name}.csv", csv_text(table))
    write_text(folder / "breaking_points.md", stability_markdown(*tables.values()))


def stability_markdown(curves: pd.DataFrame, broken: pd.DataFrame, spread: pd.DataFrame) -> str:
    """Breaking points and what is left, by data set and metric; then the seed spread.

    Args:
        curves: what `make_stability_table` gave.
        broken: what `breaking_points` gave.
        spread: what `seed_spread` gave.
    """
    parts = ["# Breaking points\n", BREAKING_LEGEND]
    for (dataset, metric), rows in broken.groupby(["dataset", "metric"], sort=False):
        grid = _grid(rows, _breaking_point, itemgetter("stressor"))
        parts.append(f"## {dataset}, {metric}\n\n{grid}\n")
    parts += ["# What the hardest level leaves\n", LEFT_LEGEND]
    hardest = hardest_levels(curves)
    names, controls = hardest["name"], hardest["control"].astype(bool)
    hardest = hardest.assign(name=names.mask(controls, "*" + names + "*"))
    for (dataset, metric), rows in hardest.groupby(["dataset", "metric"], sort=False):
        parts.append(f"## {dataset}, {metric}\n\n{_grid(rows, _left, _with_level)}\n")
    parts += ["# Seed spread\n", SPREAD_LEGEND]
    body = []
    for _, rows in spread.groupby(ENTRANT, sort=False):
        means = rows.set_index("metric")["mean"]
        mark = f" {MARK}" if rows["lacking"].any() else ""
        body.append([rows["name"].iloc[0], *(f"{means[name]:.2f}{mark}" for name in SPREADS)])
    parts.append(markdown_grid(["method", "supported", "not supported"], body) + "\n")
    return "\n".join(parts)


def hardest_levels(curves: pd.DataFrame) -> pd.DataFrame:
    """The last row of every curve that is judged, with `floor`, the floor's mean there.

    A floor that lacks views has none.
    """
    place = ["dataset", "stressor", "metric"]
    judged = curves[curves["metric"].isin(JUDGED_BY)]
    last = judged.groupby([*ENTRANT, *place[1:]], sort=False).tail(1)
    floor = last[(last["method"] == FLOOR) & (last["lacking"] == 0)].set_index(place)["mean"]
    return last.join(floor.rename("floor"), on=place)


Cell = Callable[[dict[str, Any]], str]


def _grid(rows: pd.DataFrame, cell: Cell, heading: Cell) -> str:
    """A line for every entrant, a column for every stressor."""
    columns = {row["stressor"]: heading(row) for row in rows.to_dict("records")}
    body = []
    for _, stressed in rows.groupby(["method", "variant"], sort=False):
        cells = {row["stressor"]: cell(row) for row in stressed.to_dict("records")}
        name = stressed["name"].iloc[0]
        body.append([name, *(cells.get(stressor, "") for stressor in columns)])
    return markdown_grid(["method", *columns.values()], body)


def _breaking_point(row: dict[str, Any]) -> str:
    interval = "" if row["low"] == row["high"] else f" [{row['low']}, {row['high']}]"
    return row["level"] + interval + (f" {MARK}" if row["lacking"] else "")


def _left(row: dict[str, Any]) -> str:
    if pd.isna(row["mean"]):
        return ""
    if row["lacking"]:
        return f"{row['mean']:.1f} {MARK}"
    change = with_interval("{:+.1f}", row["change"], row["change_low"], row["change_high"])
    worse = " ▼" if row["mean"] < row["floor"] else ""
    return f"{row['mean']:.1f}{worse}" + (f", {change}" if change else "")


def _with_level(row: dict[str, Any]) -> str:
    return f"{row['stressor']} {row['level']:g}"
