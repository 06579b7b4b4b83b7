"""A method that trains is one folder beside the others: no file of the suite knows its name.

Its run is on no shared file system.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml

from tests.workflow.conftest import Workspace

PROJECT = Path(__file__).parents[2]
OVERLAY = """\
run: mine
resolution: [48, 72]
datasets:
  street: {options: {frames: 1, samples: 1}, partitions: {test: [junction-201]}}
  street-train: {options: {frames: 1, samples: 1}, partitions: {geometry: [], train: [curve-301]}}
geometry: {model: lidar, finetune: null}
trainings:
  mine:
    steps: 20
    variants: {quick: {steps: 10}, broken: {learning_rate: 1.0e+14}}
protocol: {pose_sweep: {angles: []}}
tables: {ablation: mine}
stability: {datasets: []}
methods:
  mean-colour: {}
  mine: {seeds: [0, 1]}
  mine.quick: {training: quick}
  mine.broken: {training: broken}
"""


RUN = "results/mine"
WANTED = [
    f"{RUN}/{file}"
    for file in (
        *("scores.parquet", "tables/extrapolation.csv", "tables/costs.csv"),
        *("charts/extrapolation.png", "figures/extrapolation.png"),
    )
]
"""Results of rules that read much else than their one input."""


def files(folder: Path) -> set[str]:
    paths = (path for path in folder.rglob("*") if "__pycache__" not in path.parts)
    return {str(path.relative_to(folder)) for path in paths if path.is_file()}


@pytest.fixture(scope="module")
def project(tmp_path_factory, plugins):
    """A copy of the project with one method more, what that added, and a way to run it there.

    Its run's files lie in a storage, whence each job gets what it reads.
    """
    folder = tmp_path_factory.mktemp("project")
    for name in ("geoevs", "baselines", "workflow", "profiles"):
        shutil.copytree(PROJECT / name, folder / name)
    for name in ("Snakefile", "config.yaml"):
        shutil.copy(PROJECT / name, folder / name)

    def run(*arguments: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            [sys.executable, "-m", *arguments],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": os.pathsep.join((str(folder), plugins))},
            capture_output=True,
            text=True,
            check=False,
        )

    before = files(folder)
    made = run("geoevs.cli.main", "new-adapter", "mine", "--training")
    assert made.returncode == 0, made.stderr
    added = files(folder) - before
    everybody = yaml.safe_load((folder / "config.yaml").read_text())["methods"]
    nobody = dict.fromkeys(everybody)
    overlay = yaml.safe_load(OVERLAY)
    overlay["methods"] = nobody | overlay["methods"]
    overlay["stability"]["methods"] = nobody
    (folder / "mine.yaml").write_text(yaml.safe_dump(overlay))

    def snakemake(*arguments: str) -> subprocess.CompletedProcess:
        scale = ("--configfile", "config.yaml", "mine.yaml")
        given = (*Workspace.STORAGE, *scale, *arguments)
        return run("snakemake", "--cores", "2", *given, "--", *WANTED)

    done = snakemake()
    assert done.returncode == 0, (done.stdout + done.stderr)[-5000:]
    return folder, added, snakemake


def test_one_folder_adds_a_trained_method_with_variants_seeds_and_failures(project):
    folder, added, _ = project
    parts = ("__init__", "adapter", "training", "network")
    own = {f"baselines/mine/{part}.py" for part in parts}
    assert added == own | {"tests/baselines/test_mine.py"}

    stored = folder / "bucket"
    rows = pd.read_parquet(stored / RUN / "scores.parquet")
    assert set(rows["method"]) == {"mean-colour", "mine"}
    rows = rows[rows["method"] == "mine"]
    status = {entrant: set(part["status"]) for entrant, part in rows.groupby(["variant", "seed"])}
    fine = {("default", 0), ("default", 1), ("quick", 0)}
    assert status.keys() == fine | {("broken", 0)}
    assert all("ok" in status[entrant] and "failed" not in status[entrant] for entrant in fine)
    assert status["broken", 0] == {"failed"}
    assert rows[rows["variant"] == "broken"]["reason"].str.startswith("its training failed: ").all()
    trained = stored / RUN / "trained/mine"
    seeds = [(trained / f"default.seed{n}/correction.npz").read_bytes() for n in (0, 1)]
    assert seeds[0] != seeds[1]


def test_a_run_whose_files_lie_in_a_storage(project):
    """Jobs read and write what Snakemake says, wherever that lies."""
    folder, _, snakemake = project
    assert all((folder / "bucket" / file).stat().st_size for file in WANTED)
    # Beside the storage: the lock, and the folder from which a killed training would go on.
    assert {Path(file).parts[0] for file in files(folder / RUN)} == {".lock", "training"}
    assert "Nothing to be done" in snakemake("-n").stdout
