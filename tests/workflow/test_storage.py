"""Without a shared file system: jobs read and write what Snakemake says, wherever that lies."""

import os
import re
import subprocess
from pathlib import Path

import pandas as pd
import pytest
import yaml

PROJECT = Path(__file__).parents[2]
OVERLAY = """\
run: stored
resolution: [48, 72]
weights: weights
datasets:
  street: {options: {frames: 1, samples: 1}, partitions: {test: [junction-201]}}
  street-stability: {options: {frames: 1, samples: 1, lidar_azimuths: 400}}
  street-train: {options: {frames: 1, samples: 1}, partitions: {geometry: [], train: [curve-301]}}
geometry: {model: lidar, finetune: null}
trainings: {geo-evs: {steps: 2, batch: 2, sampling: {steps: 1}}}
protocol: {pose_sweep: {angles: []}}
methods: {reference: {}, mean-colour: {}, geo-evs: {training: v3}}
stability: {seeds: 1, levels: {lateral: [0, 1]}, methods: {mean-colour: {}}}
"""
STORAGE = ("--default-storage-provider", "folder", "--default-storage-prefix", "bucket")
COPIES = ".snakemake/storage/folder/bucket"
"""Where jobs find their copies of what lies in the storage."""

RUN = "results/stored"
SOME = [
    f"{RUN}/{file}"
    for file in (
        *("tables/extrapolation.csv", "tables/costs.csv", "charts/extrapolation.png"),
        *("figures/extrapolation.png", "figures/artifact-masks.png", "stability/lateral.html"),
    )
]
"""Results of rules that read much else than their one input."""


@pytest.fixture
def snakemake(workspace, monkeypatch):
    """Runs Snakemake with a folder as storage, on a config whose entrants take seconds."""
    whole, overlay = yaml.safe_load((PROJECT / "config.yaml").read_text()), yaml.safe_load(OVERLAY)
    for section, given in ((whole, overlay), (whole["stability"], overlay["stability"])):
        given["methods"] = dict.fromkeys(section["methods"]) | given["methods"]
    unstressed = {name: [] for name in whole["stability"]["levels"]}
    overlay["stability"]["levels"] = unstressed | overlay["stability"]["levels"]
    (workspace.folder / "small.yaml").write_text(yaml.safe_dump(overlay))
    paths = [str(Path(__file__).parent / "plugins"), str(PROJECT), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))

    def run(*arguments: str) -> subprocess.CompletedProcess:
        return workspace.snakemake(*STORAGE, "--configfile", "config.yaml", *arguments)

    return run


def test_no_command_names_a_file_that_snakemake_did_not_give_it(snakemake):
    """A path of the run outside the copies is neither an input nor an output of its job.

    The folders of trainings are none: killed ones go on from them.
    """
    scale = ("workflow/scales/smoke.yaml", "networks.yaml")
    whole = ("tables", "charts", "report", "conditions", "stability", "audit", "pretrain")
    dry = snakemake(*scale, "-n", "-p", "--", *whole)
    assert dry.returncode == 0, (dry.stdout + dry.stderr)[-3000:]
    commands = re.findall(r"geoevs --log .*", dry.stdout)
    named = {command.split()[3] for command in commands}
    assert named >= {"scene", "fit", "render", "train", "table", "chart", "report", "audit-scene"}
    for command in commands:
        assert set(re.findall(r"--run (\S+)", command)) <= {f"{COPIES}/results/smoke"}
        rest = re.sub(r"--work \S+", "", command).replace(f"{COPIES}/results/smoke", "")
        assert "results/smoke" not in rest, command


def test_a_run_whose_files_lie_in_a_storage(snakemake, workspace):
    done = snakemake("small.yaml", "--", *SOME)
    assert done.returncode == 0, (done.stdout + done.stderr)[-5000:]
    stored = workspace.folder / "bucket"
    assert all((stored / file).stat().st_size for file in SOME)
    rows = pd.read_parquet(stored / RUN / "scores.parquet")
    assert "failed" not in set(rows["status"])
    assert set(rows["method"]) == {"reference", "mean-colour", "geo-evs"}
    # Beside the storage: the lock, and the folder from which a killed training would go on.
    here = {path.relative_to(workspace.folder / RUN).parts[0] for path in left(workspace.folder)}
    assert here == {".lock", "training"}
    assert "Nothing to be done" in snakemake("small.yaml", "-n", "--", *SOME).stdout


def left(folder: Path) -> list[Path]:
    return [path for path in (folder / RUN).rglob("*") if path.is_file()]
