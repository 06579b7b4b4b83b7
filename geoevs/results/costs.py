"""What every method cost: time, memory and size, beside the tables that say how good it is."""

from pathlib import Path

import pandas as pd

from geoevs.methods.contract import CONTROL
from geoevs.protocol.entries import FAILED
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.results.entrants import ENTRANT, Entrants
from geoevs.results.escaping import markdown_text
from geoevs.results.formats import markdown_grid, write_formats
from geoevs.results.machines import machines_of, timed_on

COLUMNS = {
    "fit_seconds": "fit s",
    "training_seconds": "training s, once a run",
    "load_seconds": "load s",
    "warm_up_seconds": "first view s",
    "render_seconds": "render s / view",
    "peak_memory_mb": "peak memory MB",
    "gpu_memory_mb": "GPU memory MB",
    "primitives": "primitives",
    "parameters": "parameters",
    "size_mb": "on disk MB",
}
LEGEND = """Means over n fits; *controls* in italics. `fit s` = seconds for one scene, with networks
that were trained before; `training s` = seconds that the run trained those networks for, the depth
network's fine-tuning among them: once for all scenes, and in no `fit s`. Empty = nothing is
trained, or nobody timed it; what starting weights took before the run does not count. `load` =
opening a fitted scene; `first view` = a view rendered before those that `render` is the median of.
Memory = the peak of fitting and rendering, workers among it; of GPU memory that of the main process
alone. `primitives` = Gaussians, or what the row's note says; 0 = none.
`parameters` = learned values, those of networks among them. `on disk` = a fitted scene, with all
that rendering it needs. `failed` = fits without a result; no mean holds them.
"""


def make_cost_table(costs: pd.DataFrame, entrants: Entrants) -> pd.DataFrame:
    """Means over scenes (and seeds) of the cost of fitting and rendering from all cameras.

    Args:
        costs: cost rows.
        entrants: who plays.

    Returns:
        A row for every data set, method and variant, in the rows' order: the keys of COLUMNS,
        `n` fits, `failed` fits, `device`, `threads`, `note`, what the methods said of the fits,
        `machines`, those of the fits, `timed_on`, a sentence on those of the data set where they
        are several, and the entrant's `name`, `paradigm`, `extra_prior`, `needs` and `sees`.
    """
    rows = costs[costs["sources"] == ALL_CAMERAS].assign(
        peak_memory_mb=costs["peak_memory"] / 1e6,
        gpu_memory_mb=costs["gpu_memory"] / 1e6,
        size_mb=costs["bytes"] / 1e6,
    )
    sentences = timed_on(rows)
    table = []
    for key, group in rows.groupby(ENTRANT, sort=False):
        fine = group[group["status"] != FAILED]
        table.append(
            {
                **dict(zip(ENTRANT, key, strict=True)),
                **fine[list(COLUMNS)].mean(),
                "n": len(fine),
                "failed": len(group) - len(fine),
                "device": " ".join(sorted(fine["device"].unique())),
                "threads": group["threads"].max(),
                "note": _joined_notes(fine),
                "machines": machines_of(fine),
                "timed_on": sentences[key[0]],
            }
        )
    return entrants.describe(pd.DataFrame(table))


def write_cost_table(stem: Path, costs: pd.DataFrame, entrants: Entrants) -> None:
    """Write `make_cost_table` as CSV and Markdown; `stem` is the path without suffix."""
    write_formats(stem, make_cost_table(costs, entrants), cost_markdown)


def _joined_notes(fits: pd.DataFrame) -> str:
    """The one note of all fits; where they differ, each distinct one behind its scenes."""
    scenes = fits.groupby("note", sort=False)["scene"].unique()
    if len(scenes) == 1:
        return scenes.index[0]
    return " | ".join(f"{', '.join(where)}: {note}" for note, where in scenes.items() if note)


def cost_markdown(table: pd.DataFrame) -> str:
    """The cost table for people: controls in italics, notes below it, and a legend."""
    header = ["method", *COLUMNS.values(), "device", "threads", "n", "failed"]
    parts = ["# Costs (mean over scenes, all cameras as sources)\n"]
    for dataset, rows in table.groupby("dataset", sort=False):
        body, noted = [], {}
        for row in rows.to_dict("records"):
            name = row["name"]
            cells = [f"*{name}*" if row["paradigm"] == CONTROL else name]
            cells += ["" if pd.isna(row[key]) else f"{row[key]:.4g}" for key in COLUMNS]
            cells += [str(row[key]) for key in ("device", "threads", "n", "failed")]
            body.append(cells)
            stars = "*" if row["paradigm"] == CONTROL else ""
            noted.setdefault(row["note"], []).append(f"{stars}{markdown_text(name)}{stars}")
        parts.append(f"## {dataset}\n\n{markdown_grid(header, body)}\n")
        if said := rows["timed_on"].iloc[0]:
            parts.append(f"**{markdown_text(said)}**\n")
        notes = [
            f"- {', '.join(names)}: {markdown_text(note)}\n"
            for note, names in noted.items()
            if note
        ]
        parts += ["".join(notes)] if notes else []
    return "\n".join([*parts, LEGEND])
