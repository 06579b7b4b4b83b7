"""What every method cost: time, memory and size, beside the tables that say how good it is."""

import pandas as pd

from geoevs.protocol.entries import FAILED
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.results.formats import markdown_grid
from geoevs.results.tables import display_name, is_control

COLUMNS = {
    "fit_seconds": "fit s",
    "render_seconds": "render s / view",
    "peak_memory_mb": "peak memory MB",
    "gpu_memory_mb": "GPU memory MB",
    "primitives": "primitives",
    "parameters": "parameters",
    "size_mb": "on disk MB",
}


def make_cost_table(costs: pd.DataFrame) -> pd.DataFrame:
    """Means over scenes (and seeds) of the cost of fitting and rendering from all cameras.

    Returns:
        A row for every data set, method and variant, in the rows' order: the keys of COLUMNS,
        `n` fits, `failed` fits, `device` and `threads`.
    """
    rows = costs[costs["sources"] == ALL_CAMERAS].assign(
        peak_memory_mb=costs["peak_memory"] / 1e6,
        gpu_memory_mb=costs["gpu_memory"] / 1e6,
        size_mb=costs["bytes"] / 1e6,
    )
    table = []
    for key, group in rows.groupby(["dataset", "method", "variant"], sort=False):
        fine = group[group["status"] != FAILED]
        table.append(
            {
                **dict(zip(("dataset", "method", "variant"), key, strict=True)),
                **fine[list(COLUMNS)].mean(),
                "n": len(fine),
                "failed": len(group) - len(fine),
                "device": " ".join(sorted(fine["device"].unique())),
                "threads": group["threads"].max(),
            }
        )
    return pd.DataFrame(table)


def cost_markdown(table: pd.DataFrame) -> str:
    """The cost table for people; controls in italics."""
    header = ["method", *COLUMNS.values(), "device", "threads", "n", "failed"]
    parts = ["# Costs (mean over scenes, all cameras as sources)\n"]
    for dataset, rows in table.groupby("dataset", sort=False):
        body = []
        for row in rows.to_dict("records"):
            name = display_name(row["method"], row["variant"])
            cells = [f"*{name}*" if is_control(row["method"]) else name]
            cells += ["" if pd.isna(row[key]) else f"{row[key]:.4g}" for key in COLUMNS]
            cells += [str(row[key]) for key in ("device", "threads", "n", "failed")]
            body.append(cells)
        parts.append(f"## {dataset}\n\n{markdown_grid(header, body)}\n")
    return "\n".join(parts)
