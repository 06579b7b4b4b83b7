"""What a run grows to at 1, 10, 100 and 1000 times the default, and what breaks first.

    python -m benchmarks.growth               # measures up to 10 times the default
    python -m benchmarks.growth --largest 100 # and up to 100 times: 10 million score rows

The run grows by scenes as large as the default's. Jobs are counted by a dry run; files and bytes
follow from one frame of a street, made as the config says, and from the targets of its protocol.
Each aggregation is a process of its own, with rows and arrays that are drawn; its seconds are those
of CPU. Sizes beyond the
largest one are not measured: they follow from the last two by a line, or by a parabola where work
grows with pairs of views, and bear a tilde.
"""

import argparse
import functools
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from benchmarks.results import ENTRANTS, SETTINGS, cost_rows, score_rows
from geoevs.config.entrants import method_entries
from geoevs.config.partitions import partition_scenes
from geoevs.core.mapped import write_mapped
from geoevs.core.parquet import GROUP_ROWS, write_parquet
from geoevs.protocol.targets import make_targets
from geoevs.scenes.store import Scene

SIZES = (1, 10, 100, 1000)
MEMORY_MB = 24_000
"""Memory of the machine that is to hold out."""
MOST_FILES = 10_000_000
"""Files that a file system is taken to hold."""
LONGEST = 3_600
"""Seconds that one aggregation may take."""
ROWS = 100_000
"""Score rows of the default run, rounded up from 86,000: 100 times the default is 10 million."""
PARTS = 48
"""Files of rows of the default run: one for each of 16 entrants on three scenes."""
SCENES = 3
FEATURES = 54
"""Numbers that describe a view for `texture_energy`, at the default's resolution."""


@dataclass(frozen=True)
class Measured:
    """Seconds of CPU, and the peak of memory in MB, at some sizes."""

    power: int = 1
    at: dict[int, tuple[float, float]] = field(default_factory=dict)

    def expected(self, size: int) -> tuple[float, float]:
        """What was measured, or what follows from the last two sizes."""
        if size in self.at:
            return self.at[size]
        (low, first), (high, last) = sorted(self.at.items())[-2:]
        steps = (size**self.power - high**self.power) / (high**self.power - low**self.power)
        return tuple(b + max(0.0, b - a) * steps for a, b in zip(first, last, strict=True))


def score_file(path: Path, size: int) -> None:
    """Score rows of a run, of its own scenes in each copy of the default's."""
    base = score_rows(ROWS)
    writer = None
    for copy in range(size):
        scene = (base["scene"] + f"-{copy}").astype("string")
        table = pa.Table.from_pandas(base.assign(scene=scene), preserve_index=False)
        writer = writer or pq.ParquetWriter(path, table.schema)
        writer.write_table(table, GROUP_ROWS)
    writer.close()


def part_list(folder: Path, size: int) -> None:
    """A list of as many files of rows as a run has; they are the same few."""
    folder.mkdir(exist_ok=True)
    parts = [folder / f"{number}.parquet" for number in range(PARTS)]
    if not parts[-1].exists():
        rows = score_rows(ROWS)
        for part, some in zip(parts, np.array_split(np.arange(len(rows)), PARTS), strict=True):
            write_parquet(part, rows.iloc[some])
    names = "".join(f"{part}\n" for part in parts * size)
    (folder / f"{size}.txt").write_text(names, encoding="utf-8")


def prepared_file(path: Path, views: int, height: int, width: int) -> None:
    """Training pairs and artifact masks of one scene, of random pixels."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (2, views, height, width, 3), np.uint8)
    bits = rng.integers(0, 256, (views, height * width // 8), np.uint8)
    names = {name: np.full(views, name) for name in ("scene", "camera")}
    pairs = {"rgb": images[0], "target": images[1], "valid": bits, **names}
    pairs["frame"] = np.arange(views)
    masks = {"size": np.array([height, width]), "masks": np.repeat(bits, 12, axis=0)}
    masks |= {"scene": np.full(12 * views, "s"), "frame": np.arange(12 * views)}
    masks |= {name: np.zeros(12 * views) for name in ("yaw", "lateral", "support")}
    write_mapped(
        path,
        {f"pairs/{name}": array for name, array in pairs.items()}
        | {f"masks/{name}": array for name, array in masks.items()},
    )


# What runs in a process of its own, besides commands.


def compare_sets(size: int) -> None:
    """The distance of one split's views from the truth, and its floor."""
    from geoevs.protocol.set_metrics import SET_METRICS, real_floor

    views = 8 * SCENES * 5 * size
    x, y = np.random.default_rng(0).standard_normal((2, views, FEATURES))
    frames = np.arange(views) // 5
    metric = SET_METRICS["texture_energy"]
    metric.distance(x, y, frames, 0.95)
    real_floor(metric, y, frames)


def draw_batches(path: Path, scenes: int) -> None:
    """Twenty batches of a training's pairs and masks."""
    from geoevs.conditions.artifact_masks import join_artifact_masks, read_artifact_masks
    from geoevs.conditions.pairs import read_pairs

    pairs = read_pairs([path] * scenes)
    library = join_artifact_masks([read_artifact_masks(path)] * scenes)
    rng = np.random.default_rng(0)
    for _ in range(20):
        picked = rng.integers(len(pairs), size=16)
        condition = pairs.rgb[picked] * pairs.valid[picked][..., None]
        assert condition.shape == pairs.target[picked].shape
        library.draw(rng, 16)


def measure(command: Sequence[str]) -> tuple[float, float]:
    """Seconds of CPU, which other work lengthens little, and peak MB of a command."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"failed: {' '.join(command)}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3


def geoevs(*arguments: Any) -> tuple[float, float]:
    """Seconds and peak MB of a `geoevs` command."""
    return measure([sys.executable, "-m", "geoevs.cli.main", *map(str, arguments)])


def function(call: str) -> tuple[float, float]:
    """Seconds and peak MB of a function of this module."""
    return measure([sys.executable, "-c", f"from benchmarks.growth import *; {call}"])


def steps(folder: Path, shape: Sequence[int]) -> dict[str, tuple[int, Callable[[int], Any]]]:
    """Every aggregation: the power its work grows with, and what measures it at a size."""
    who, costs, pairs = folder / "who.json", folder / "costs.parquet", folder / "pairs.npz"
    geoevs("entrants", "--options", json.dumps({name: {} for name in ENTRANTS}), "--out", who)
    cost_rows().to_parquet(costs, index=False)
    function(f"prepared_file(Path({str(pairs)!r}), 20, *{shape})")

    # Made in other processes: Linux counts what this one held to its children's memory.
    @functools.cache
    def scores(size: int) -> Path:
        path = folder / f"scores-{size}.parquet"
        function(f"score_file(Path({str(path)!r}), {size})")
        return path

    @functools.cache
    def parts(size: int) -> Path:
        function(f"part_list(Path({str(folder / 'parts')!r}), {size})")
        return folder / f"parts/{size}.txt"

    def of_scores(*command: str) -> Callable[[int], Any]:
        more = ("--entrants", who, "--out", folder / "out")
        more += ("--costs", costs) if command[0] == "chart" else ()
        settings = ("--settings", SETTINGS)
        return lambda size: geoevs(*command, "--scores", scores(size), *settings, *more)

    return {
        "collect": (
            1,
            lambda size: geoevs(
                *("collect", "--list", parts(size)),
                *("--out", folder / "all.parquet"),
            ),
        ),
        "table extrapolation": (1, of_scores("table", "extrapolation")),
        "table pose_offset": (1, of_scores("table", "pose_offset")),
        "table observed": (1, of_scores("table", "observed")),
        "table ablation": (1, of_scores("ablation-table")),
        "rank agreement": (
            1,
            lambda size: geoevs(
                *("rank-agreement", "--scores", scores(size)),
                *("--settings", SETTINGS, "--out", folder / "out"),
            ),
        ),
        "chart pose_offset": (1, of_scores("chart", "pose_offset")),
        "set scores of a split": (2, lambda size: function(f"compare_sets({size})")),
        "twenty batches": (
            1,
            lambda size: function(f"draw_batches(Path({str(pairs)!r}), {15 * size})"),
        ),
    }


def dry_run(folder: Path, size: int) -> tuple[int, tuple[float, float]]:
    """Jobs of a run, and the seconds and peak MB of planning them."""
    scenes = [f"curve-{10_000 + number}" for number in range(SCENES * size)]
    overlay = folder / f"growth-{size}.yaml"
    partitions = {"street": {"partitions": {"test": scenes}}}
    overlay.write_text(yaml.safe_dump({"run": "growth", "datasets": partitions}), encoding="utf-8")
    told = folder / "dry-run.txt"
    snakemake = [sys.executable, "-m", "snakemake", "--cores", "1", "--nolock"]
    files = f"--configfile config.yaml {overlay} -- tables charts report > {told} 2>&1"
    found = measure(["bash", "-c", f"{' '.join(snakemake)} -n --quiet rules {files}"])
    return int(re.search(r"^total\s+(\d+)", told.read_text(encoding="utf-8"), re.M)[1]), found


def inventory(folder: Path, config: dict[str, Any]) -> tuple[float, float]:
    """Files and bytes of a scene's store, truth and renders, without models."""
    options = config["datasets"]["street"]["options"]
    height, width = config["resolution"]
    store = folder / "scene"
    geoevs(
        *("scene", "--source", "street", "--name", "curve-102"),
        *("--height", height, "--width", width),
        *("--options", json.dumps({**options, "frames": 1})),
        *("--out", store, "--depths", folder / "depths"),
    )
    protocol = config["protocol"]
    often = {"pose-sweep": protocol["pose_sweep"]["every"]}
    often |= {f"masked-{split}": protocol["masked"]["every"] for split in ("observed",)}
    often["masked-extrapolation"] = protocol["masked"]["every"]
    targets = make_targets(Scene(store), protocol, 0)
    views = sum(1 / often.get(target.split, 1) for target in targets)
    virtual = sum(1 / often.get(t.split, 1) for t in targets if not t.recorded and not t.masked)
    held = [path for path in store.rglob("*") if path.is_file() and path.suffix in (".png", ".npz")]
    picture = np.mean([path.stat().st_size for path in held if path.suffix == ".png"])
    depth = sum(path.stat().st_size for path in (folder / "depths").rglob("*.npz"))
    entrants = len(method_entries(config))
    files = len(held) + 1 + 2 * virtual + views * entrants
    size = sum(path.stat().st_size for path in held) + depth
    size += virtual * (picture + depth / 5) + views * entrants * picture
    return options["frames"] * files, options["frames"] * size


def first_breaks(found: dict[str, Measured], files: dict[int, float]) -> list[str]:
    """What passes a limit at which size, the first first."""
    broken: dict[str, str] = {}
    for size in SIZES:
        when = f"{size} times the default"
        if files[size] > MOST_FILES:
            broken.setdefault("files", f"{when}: {files[size]:,.0f} files")
        for name, step in found.items():
            seconds, megabytes = step.expected(size)
            if megabytes > MEMORY_MB:
                broken.setdefault(name, f"{when}: {name}, {megabytes / 1e3:,.0f} GB of memory")
            if seconds > LONGEST:
                broken.setdefault(name, f"{when}: {name}, {seconds / 3600:,.1f} hours")
    return list(broken.values())


def main() -> None:
    """Print the table, and what breaks first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--largest", type=int, choices=(10, 100), default=10)
    measured = [size for size in SIZES if size <= parser.parse_args().largest]
    config = yaml.safe_load(Path("config.yaml").read_text(encoding="utf-8"))
    assert len(partition_scenes(config, "test", ["street"])) == SCENES
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = {}
        for step, (power, run) in steps(folder, config["resolution"]).items():
            found[step] = Measured(power, {size: run(size) for size in measured})
        # Not beyond 10 times: a plan is of jobs alone, whose number is a line in that of scenes.
        plans = {size: dry_run(folder, size) for size in (1, 10)}
        found["dry run"] = Measured(1, {size: plan for size, (_, plan) in plans.items()})
        files_of_scene, bytes_of_scene = inventory(folder, config)
    jobs = Measured(1, {size: (count, 0.0) for size, (count, _) in plans.items()})
    print(table(found, jobs, files_of_scene, bytes_of_scene))
    files = {size: files_of_scene * SCENES * size for size in SIZES}
    breaks = first_breaks(found, files)
    print("\nWhat breaks first, on 24 GB and within an hour a step:")
    print("\n".join(f"- {line}" for line in breaks) or "- nothing up to 1000 times the default")


def table(
    found: dict[str, Measured], jobs: Measured, files_of_scene: float, bytes_of_scene: float
) -> str:
    """Markdown: a line a quantity, a column a size; a tilde says that it was not measured."""
    lines = [f"| | {' | '.join(f'{size}x' for size in SIZES)} |", "|---" * (len(SIZES) + 1) + "|"]

    def line(name: str, cells: Sequence[str]) -> None:
        lines.append(f"| {name} | {' | '.join(cells)} |")

    line("scenes", [f"{SCENES * size:,}" for size in SIZES])
    line("score rows", [f"{ROWS * size:,}" for size in SIZES])
    counts = [f"{tilde(jobs, size)}{jobs.expected(size)[0]:,.0f}" for size in SIZES]
    line("jobs", counts)
    line("files of scenes and renders", [f"~{files_of_scene * SCENES * k:,.0f}" for k in SIZES])
    line("their GB", [f"~{bytes_of_scene * SCENES * k / 1e9:,.1f}" for k in SIZES])
    for name, step in found.items():
        cells = []
        for size in SIZES:
            seconds, megabytes = step.expected(size)
            cells.append(f"{tilde(step, size)}{seconds:,.1f} s, {megabytes:,.0f} MB")
        line(name, cells)
    return "\n".join(lines)


def tilde(step: Measured, size: int) -> str:
    """What stands before a number that was not measured."""
    return "" if size in step.at else "~"


if __name__ == "__main__":
    main()
