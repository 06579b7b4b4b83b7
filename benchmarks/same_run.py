"""Whether two runs of one config have the same numbers and pictures, bit for bit.

    python -m benchmarks.same_run results/default /elsewhere/results/default

compares every value of scores.parquet, set-scores.parquet and depth-scores.parquet, joined by who
and what they are of; every table's CSV; every render and every trained network. Seconds, memory,
sizes on disk, fingerprints, shown names and columns that one run lacks are left out. It ends with
exit code 1 where something differs.

    python -m benchmarks.same_run results/default --digest default.json

writes hashes of the same, a line an entrant and scene, which later runs elsewhere compare with:
`python -m benchmarks.same_run default.json results/default`.
"""

import argparse
import hashlib
import json
import sys
from pathlib import Path

import pandas as pd

ROWS = {
    "scores.parquet": (
        *("dataset", "scene", "frame", "target", "split", "method", "variant", "seed"),
        *("stressor", "level", "metric", "lateral_shift"),
    ),
    "set-scores.parquet": ("dataset", "split", "method", "variant", "seed", "metric"),
    "depth-scores.parquet": (
        *("dataset", "scene", "frame", "camera", "model", "stage", "scale", "metric"),
    ),
}
"""Files of rows, and the columns that say what a row is of."""

TIMED = (
    *("seconds", "memory", "bytes", "fingerprint", "log", "note", "threads", "device"),
    "timed_on",
)
"""Parts of the names of columns that no two runs share, or that say how and not what."""

NAMES = ("name", "paradigm", "extra_prior", "needs", "citation", "group")
TIMED_TABLES = ("costs",)
NETWORKS = "*.safetensors"
COLUMN = ".csv column "


def digest_of(run: Path) -> dict[str, str]:
    """Hashes of a run's rows, tables, renders and networks, by what they are of.

    Args:
        run: `results/<run>`.
    """
    found: dict[str, str] = {}
    for file, keys in ROWS.items():
        if (run / file).exists():
            found |= _row_hashes(pd.read_parquet(run / file), file, keys)
    for table in sorted((run / "tables").glob("*.csv")):
        if table.stem not in TIMED_TABLES:
            columns = _comparable(pd.read_csv(table))
            found |= {_column_key(table, name): _hash(columns[name].to_csv()) for name in columns}
    for folder in sorted((run / "renders").glob("*/*/*/")):
        pictures = sorted(folder.rglob("*.png"))
        text = "".join(f"{p.relative_to(folder)} {_hash(p.read_bytes())}\n" for p in pictures)
        found[str(folder.relative_to(run))] = _hash(text)
    for network in sorted((run / "trained").rglob(NETWORKS)):
        found[_network_key(network.relative_to(run))] = _hash(network.read_bytes())
    return found


def differences(first: dict[str, str], second: dict[str, str]) -> list[str]:
    """What only one of two digests has, or what differs between them: a line each."""
    alone = [f"only in the first: {key}" for key in first if key not in second]
    alone += [f"only in the second: {key}" for key in second if key not in first]
    lines = [line for line in alone if COLUMN not in line]
    return lines + [f"differs: {key}" for key in first if second.get(key, first[key]) != first[key]]


def _row_hashes(rows: pd.DataFrame, file: str, keys: tuple[str, ...]) -> dict[str, str]:
    """A hash for every entrant and scene of a file of rows."""
    owners = [name for name in ("dataset", "scene", "method", "variant", "seed") if name in keys]
    owners += [name for name in ("model", "stage") if name in keys]
    kept = _comparable(rows).sort_values(list(keys), kind="stable")
    return {
        f"{file} {'/'.join(map(str, owner))}": _hash(part.to_csv(index=False))
        for owner, part in kept.groupby(owners)
    }


def _comparable(table: pd.DataFrame) -> pd.DataFrame:
    """A table without what no two runs share; numbers are written exactly by `to_csv`."""
    dropped = [
        column for column in table if column in NAMES or any(part in str(column) for part in TIMED)
    ]
    return table.drop(columns=dropped)


def _column_key(table: Path, name: str) -> str:
    return f"tables/{table.stem}{COLUMN}{name}"


def _network_key(path: Path) -> str:
    """trained/<method>/<variant>.seed<n>, or trained/<training>.seed<n> as version 0.1 wrote it."""
    variant, _, seed = path.parent.name.partition(".")
    return f"networks {path.parts[1] if variant == 'default' else variant}.{seed}/{path.name}"


def _hash(content: str | bytes) -> str:
    data = content.encode() if isinstance(content, str) else content
    return hashlib.sha256(data).hexdigest()[:16]


def _read(path: Path) -> dict[str, str]:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else digest_of(path)


def main() -> int:
    """Compare two runs or digests, or write one's digest."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=Path, help="results/<run>, or a digest")
    parser.add_argument("second", type=Path, nargs="?", help="the other one")
    parser.add_argument("--digest", type=Path, help="where to write the first one's digest")
    arguments = parser.parse_args()
    first = _read(arguments.first)
    if arguments.digest:
        text = json.dumps(first, indent=1, sort_keys=True) + "\n"
        arguments.digest.write_text(text, encoding="utf-8")
    if arguments.second is None:
        print(f"{len(first)} hashes of {arguments.first}")
        return 0
    lines = differences(first, _read(arguments.second))
    print("\n".join([*lines, f"{len(first)} compared, {len(lines)} differ"]))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
