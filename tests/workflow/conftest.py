import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from geoevs.geometry.vggt import VggtConfig, new_vggt, save_vggt

PROJECT = Path(__file__).parents[2]


class Workspace:
    """A folder in which snakemake runs the project's workflow, its results apart.

    At smoke scale it starts from the networks in the folder `weights`.
    """

    SMOKE = ("--configfile", "config.yaml", "workflow/scales/smoke.yaml", "networks.yaml")

    def __init__(self, folder: Path, weights: Path) -> None:
        self.folder = folder
        (folder / "weights").symlink_to(weights)
        (folder / "networks.yaml").write_text("weights: weights\ngeometry: {model: vggt-nano}\n")
        for name in ("Snakefile", "workflow", "profiles", "config.yaml"):
            (folder / name).symlink_to(PROJECT / name)

    def command(self, *arguments: str) -> list[str]:
        return [sys.executable, "-m", "snakemake", "--cores", "2", *arguments]

    def snakemake(self, *arguments: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            self.command(*arguments), cwd=self.folder, capture_output=True, text=True, check=False
        )

    def start(self, *arguments: str) -> subprocess.Popen:
        """Run in a process group of its own, so that all of it can be killed."""
        return subprocess.Popen(
            self.command(*arguments),
            cwd=self.folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            process_group=0,
            env=os.environ,
        )


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """A folder with small networks in place of this suite's own."""
    folder = tmp_path_factory.mktemp("weights")
    config = VggtConfig(8, 16, 4, 2, (0, 1, 2, 3), (4, 4, 4, 4), 8, layer_scale=0.1)
    save_vggt(new_vggt(config, torch.Generator().manual_seed(0)), folder / "vggt-nano.safetensors")
    return folder


@pytest.fixture
def workspace(tmp_path, weights):
    return Workspace(tmp_path, weights)


@pytest.fixture(scope="session")
def smoke_run(tmp_path_factory, weights):
    """The smoke DAG, run once, with one entrant that fails."""
    workspace = Workspace(tmp_path_factory.mktemp("smoke"), weights)
    overlay = workspace.folder / "failing.yaml"
    overlay.write_text("methods: {external: {options: {folder: nowhere}}}\n")
    run = workspace.snakemake(*workspace.SMOKE, "failing.yaml", "--", "tables", "breakdowns")
    return workspace, run
