"""Time and peak memory from stored rows to tables, charts and their collection, by rows.

python -m benchmarks.results

The rows are drawn, not measured: they have a run's columns, entrants and splits. Each step is a
process of its own, as in the workflow.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from geoevs.core.parquet import write_parquet
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.rows import SCORE_TYPES, cost_frame

ROWS = (10_000, 100_000, 1_000_000)
ENTRANTS = [
    "reference",
    "mean-colour",
    "nearest-view",
    "reproject",
    "reproject-inpaint",
    "emernerf",
    "geo-evs",
    "geo-evs.v1",
    "geo-evs.v2",
    "geo-evs-support",
    "three-dgs",
    "freevs",
]
SPLITS = {"observed": 5, "interpolation": 1, "extrapolation": 4, "pose-sweep": 20}
SETTINGS = (
    '{"pose_bins": [0, 5, 10, 15, 20, 30], "support_bins": [0, 0.02, 0.05, 0.1],'
    ' "resamples": 1000, "confidence": 0.95, "ablation": "geo-evs"}'
)


def score_rows(count: int, entrants: list[str] = ENTRANTS) -> pd.DataFrame:
    """About as many score rows, of as many frames as it takes."""
    rng = np.random.default_rng(0)
    targets = [(split, f"{split}-{k}") for split, views in SPLITS.items() for k in range(views)]
    metrics = [*METRICS]
    per_frame = len(targets) * len(metrics) * len(entrants)
    frames = max(6, round(count / per_frame))
    grid = pd.MultiIndex.from_product([range(frames), targets, range(len(entrants)), metrics])
    table = grid.to_frame(index=False, name=["frame", "target", "entrant", "metric"])
    quality = np.linspace(12, 24, len(entrants))[table["entrant"]]
    psnr = table["metric"].str.contains("psnr").to_numpy()
    noise = rng.standard_normal(len(table))
    view = np.arange(len(table)) // (len(entrants) * len(metrics))
    offset, support = rng.uniform(0, 1, (2, view[-1] + 1))[:, view] * [[30], [0.1]]
    value = np.where(psnr, quality + noise - 0.1 * offset, 0.5 + quality / 50 + 0.02 * noise)
    names = pd.Series(entrants).str.partition(".")[[0, 2]].replace({2: {"": "default"}})
    blank = {"string": "", "int64": 0, "float64": np.nan}
    columns = {name: blank[kind] for name, kind in SCORE_TYPES.items()} | {
        "dataset": "street",
        "scene": "scene-" + (table["frame"] % 3).astype(str),
        "frame": table["frame"],
        "split": table["target"].str[0],
        "target": table["target"].str[1],
        "method": names[0].to_numpy()[table["entrant"]],
        "variant": names[2].to_numpy()[table["entrant"]],
        "metric": table["metric"],
        "value": value,
        "valid_pixels": 500,
        "support_ratio": support,
        "pose_offset": offset,
        "lateral_shift": 0.0,
        "status": "ok",
        "fingerprint": "f",
    }
    return pd.DataFrame(columns, index=table.index).astype(SCORE_TYPES)


def cost_rows(entrants: list[str] = ENTRANTS) -> pd.DataFrame:
    """Cost rows of the same entrants, of three scenes and both sets of sources."""
    rng = np.random.default_rng(1)
    rows = []
    for number, entrant in enumerate(entrants):
        method, _, variant = entrant.partition(".")
        for scene in range(3):
            for sources in ("all-cameras", "front-side"):
                cost = 10 ** (number / 3 - 2) * rng.uniform(0.8, 1.25)
                sizes = {"peak_memory": int(cost * 1e8), "bytes": int(cost * 1e5)}
                rows.append(
                    {
                        "dataset": "street",
                        "scene": f"scene-{scene}",
                        "sources": sources,
                        "method": method,
                        "variant": variant or "default",
                        "seed": 0,
                        "fit_seconds": cost,
                        "render_seconds": cost / 20,
                        **sizes,
                        "gpu_memory": 0,
                        "primitives": 0,
                        "parameters": 0,
                        "device": "cpu",
                        "host": "host",
                        "cpu": "a processor",
                        "threads": 2,
                        "note": "",
                        "status": "ok",
                        "stage": "",
                        "reason": "",
                        "log": "",
                    }
                )
    return cost_frame(rows)


def write_rows(count: int, parts: Path, costs: Path) -> None:
    """Score rows as jobs leave them, one file a method, and cost rows."""
    parts.mkdir()
    for method, rows in score_rows(count).groupby("method"):
        write_parquet(parts / f"{method}.parquet", rows)
    cost_rows().to_parquet(costs, index=False)


def measure(*arguments: str) -> tuple[float, float]:
    """Seconds and peak MB of a `geoevs` command."""
    command = [sys.executable, "-m", "geoevs.cli.main", *arguments]
    start = time.perf_counter()
    process = subprocess.Popen(command)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"failed: {' '.join(arguments)}")
    return time.perf_counter() - start, usage.ru_maxrss / 1e3


def main() -> None:
    """Print one line a step, with a pair of columns for every number of rows."""
    table = Table(title="seconds, peak MB")
    table.add_column("step")
    lines: dict[str, list[str]] = {}
    for count in ROWS:
        table.add_column(f"{count:,} rows", justify="right")
        with tempfile.TemporaryDirectory() as folder:
            parts, scores, costs = (Path(folder) / name for name in ("parts", "s", "c"))
            # In another process: Linux counts what this one held to its children's peak.
            writer = get_context("spawn").Process(target=write_rows, args=(count, parts, costs))
            writer.start()
            writer.join()
            who = f"{folder}/entrants.json"
            measure(
                "entrants", "--options", json.dumps({name: {} for name in ENTRANTS}), "--out", who
            )
            files = [str(path) for path in sorted(parts.iterdir())]
            options = ("--scores", str(scores), "--settings", SETTINGS, "--entrants", who)
            options += ("--out", f"{folder}/out")
            steps = {
                "collect": ("collect", *files, "--out", str(scores)),
                "table extrapolation": ("table", "extrapolation", *options),
                "table pose_offset": ("table", "pose_offset", *options),
                "table ablation": ("ablation-table", *options),
                "chart extrapolation": ("chart", "extrapolation", "--costs", str(costs), *options),
                "chart pose_offset": ("chart", "pose_offset", "--costs", str(costs), *options),
            }
            for step, arguments in steps.items():
                seconds, megabytes = measure(*arguments)
                lines.setdefault(step, []).append(f"{seconds:.1f}, {megabytes:.0f}")
    for step, cells in lines.items():
        table.add_row(step, *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
