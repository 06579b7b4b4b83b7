"""The smoke scale through Slurm: `bash tests/workflow/slurm_node.sh`, then `pytest -m slurm`."""

import os
import shutil
import signal
import subprocess
import time

import pandas as pd
import pytest

from benchmarks.same_run import differences, digest_of

pytestmark = pytest.mark.slurm

SLURM = (
    *("--workflow-profile", "profiles/slurm", "--max-threads", "2", "--resources", "mem_mb=16000"),
    *("--default-resources", "mem_mb=2000", "runtime=60"),
    *("--groups", "score_sets=sets", "set_scores=sets"),
)
"""What the profile says, for a node of two cores."""

WHOLE = ("--", "tables", "charts", "conditions", "report")
PATIENCE = 3600
"""Seconds for a step of the run to come, on a machine that does other things too."""


def slurm(*command: str) -> list[str]:
    """The lines that a command of Slurm's prints."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def queue(state: str = "all") -> list[str]:
    """The jobs that wait or run."""
    return slurm("squeue", "--noheader", "--format=%i", f"--states={state}", "--me")


@pytest.fixture(autouse=True)
def cluster(request):
    """Skips where no Slurm takes jobs, and leaves none in its queue."""
    if request.config.option.markexpr != "slurm":
        pytest.skip("the run through Slurm is by itself, with `pytest -m slurm`")
    if shutil.which("sinfo") is None or subprocess.run(["sinfo"], check=False).returncode:
        pytest.skip("no Slurm takes jobs here; tests/workflow/slurm_node.sh sets one up")
    pytest.importorskip("snakemake_executor_plugin_slurm", reason="install geoevs[slurm]")
    yield
    if left := queue("pending,running"):
        slurm("scancel", *left)


def wait_for(process: subprocess.Popen, what: str, seen) -> None:
    """Wait until something is seen of a run that is under way."""
    deadline = time.monotonic() + PATIENCE
    while not seen():
        assert process.poll() is None, f"the run ended before {what}"
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(1)


def test_a_killed_run_goes_on_and_its_tables_are_those_of_a_local_one(workspace):
    given = (*SLURM, *workspace.SMOKE, *WHOLE)
    results = workspace.folder / "results/smoke"

    process = workspace.start(*given)
    wait_for(process, "it rendered", lambda: any(results.glob("renders/*/*/*/render.json")))
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    slurm("scancel", *queue("pending,running"))  # as docs/cluster.md says

    process = workspace.start(*given)
    wait_for(process, "a job ran", lambda: queue("running"))
    slurm("scancel", "--signal=KILL", "--full", queue("running")[0])  # as when its node dies
    assert process.wait(PATIENCE) == 0

    costs = pd.read_csv(results / "tables/costs.csv")
    assert (costs["failed"] == 0).all()
    assert costs["machines"].nunique() == 1
    assert "Nothing to be done" in workspace.snakemake("-n", *workspace.SMOKE, *WHOLE).stdout

    through_slurm = digest_of(results)
    results.rename(workspace.folder / "through-slurm")
    shutil.rmtree(workspace.folder / ".snakemake")
    alone = workspace.snakemake(*workspace.SMOKE, *WHOLE)
    assert alone.returncode == 0, alone.stderr[-5000:]
    assert differences(through_slurm, digest_of(results)) == []
