"""What a run was made with is known without Snakemake's records, and so are data outside it."""

import os
import shutil
from pathlib import Path

import pytest

from geoevs.core.locks import lock_folder

TARGETS = "results/small/targets/pandaset/002@62-62.json"
CONFIG = """
run: small
resolution: [48, 72]
evaluate: [pandaset]
datasets:
  pandaset:
    source: pandaset
    options: {{folder: {folder}}}
    partitions: {{test: ["002@62-62"]}}
geometry: {{model: lidar, finetune: null}}
protocol: {{lateral: [{shift}]}}
methods: {{geo-evs: null, geo-evs.v1: null, geo-evs.v2: null, geo-evs-support: null, freevs: null}}
"""
NOTHING = "Nothing to be done"


def write_config(workspace, name: str, folder: Path, shift: float = 1.0) -> tuple[str, ...]:
    (workspace.folder / name).write_text(CONFIG.format(folder=folder, shift=shift))
    return ("--configfile", "config.yaml", name, "--", TARGETS)


@pytest.mark.skipif(
    "GEOEVS_PANDASET" not in os.environ,
    reason="set GEOEVS_PANDASET to the folder that holds PandaSet sequences such as 002",
)
def test_what_a_run_was_made_with_is_known(workspace):
    data = workspace.folder / "data"
    shutil.copytree(Path(os.environ["GEOEVS_PANDASET"]) / "002", data / "002")
    small = write_config(workspace, "small.yaml", data)

    release = lock_folder(workspace.folder / "results/small")
    refused = workspace.snakemake(*small)
    assert refused.returncode != 0
    said = refused.stderr + refused.stdout
    assert f"results/small is being written by process {os.getpid()}" in said
    release()

    run = workspace.snakemake(*small)
    assert run.returncode == 0, run.stderr[-3000:]
    assert NOTHING in workspace.snakemake("-n", *small).stdout

    image = data / "002/camera/front_camera/62.jpg"
    os.utime(image, (1, 1))
    changed = workspace.snakemake("-n", *small)
    assert "rule scene:" in changed.stdout

    data.rename(workspace.folder / "elsewhere")
    assert NOTHING in workspace.snakemake("-n", *small).stdout, "a run goes on without its data"

    shutil.rmtree(workspace.folder / ".snakemake")
    assert NOTHING in workspace.snakemake("-n", *small).stdout
    stale = workspace.snakemake("-n", *write_config(workspace, "other.yaml", data, 2.0))
    assert stale.returncode != 0
    said = stale.stderr + stale.stdout
    assert f"{TARGETS} was made with other settings than this run has now" in said
