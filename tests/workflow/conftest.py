import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]


class Workspace:
    """A folder in which snakemake runs the project's workflow, its results apart.

    At smoke scale it starts from a copy of the suite's own networks, which it may overwrite.
    """

    EVERYTHING = ("tables", "breakdowns", "conditions", "stability", "audit")
    RESUMED = (
        *(
            f"results/smoke/parts/street/junction-201/{label}.scores.parquet"
            for label in ("mean-colour", "freevs", "external")
        ),
    )
    """What is killed and resumed: a control, a training, a failure, and what they need."""
    STORAGE = ("--default-storage-provider", "folder", "--default-storage-prefix", "bucket")
    """Files of the run lie in the folder `bucket`, which jobs know nothing of."""
    SMOKE = ("--configfile", "config.yaml", "workflow/scales/smoke.yaml", "networks.yaml")

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(PROJECT / "geoevs/weights", folder / "weights")
        (folder / "networks.yaml").write_text("weights: weights\n")
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

    def kill_at_work(self, moment: float, *arguments: str) -> set[Path]:
        """Start a run and kill it while a job's folder is half-made; gives such folders.

        Args:
            moment: seconds after the first folder was begun, at least.
            arguments: of Snakemake.
        """
        before, begun = self.half_made(), None
        process = self.start(*arguments)
        deadline = time.monotonic() + moment + 300
        try:
            while time.monotonic() < deadline:
                assert process.poll() is None, "the run ended before it could be killed"
                os.killpg(process.pid, signal.SIGSTOP)  # so that nothing ends between look and kill
                if left := self.half_made() - before:
                    begun = begun or time.monotonic()
                    if time.monotonic() - begun >= moment:
                        return left
                os.killpg(process.pid, signal.SIGCONT)
                time.sleep(0.05)
            raise AssertionError("no job began to write a folder")
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def half_made(self) -> set[Path]:
        """Folders that jobs are writing (see `new_folder`), or that killed ones have left."""
        return {
            Path(parent) / name
            for parent, folders, _ in os.walk(self.folder / "results")
            for name in folders
            if name.startswith(".") and "~" in name
        }


@pytest.fixture(scope="session")
def plugins():
    """The PYTHONPATH of a Snakemake that has the tests' plugins."""
    paths = [str(Path(__file__).parent / "plugins"), str(PROJECT), os.environ.get("PYTHONPATH", "")]
    return os.pathsep.join(filter(None, paths))


@pytest.fixture
def workspace(tmp_path):
    return Workspace(tmp_path)


@pytest.fixture(scope="session")
def smoke_run(tmp_path_factory):
    """The smoke DAG, run once, with one entrant that fails."""
    workspace = Workspace(tmp_path_factory.mktemp("smoke"))
    overlay = workspace.folder / "failing.yaml"
    overlay.write_text("methods: {external: {options: {folder: nowhere}}}\n")
    run = workspace.snakemake(*workspace.SMOKE, "failing.yaml", "--", *workspace.EVERYTHING)
    # Last, as the README says: it shows what other calls have left in the run.
    workspace.snakemake(*workspace.SMOKE, "failing.yaml", "--", "report")
    return workspace, run
