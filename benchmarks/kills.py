"""Whether a run that is killed again and again ends with the same bytes as one that is not.

    python -m benchmarks.kills                       # 50 kills of the run at smoke scale
    python -m benchmarks.kills --kills 5 --overlay workflow/scales/pandaset.yaml

One run goes through; a second is killed with SIGKILL, with everything that it started, at random
moments, some of them while a temporary file is there to be renamed, and started again until it
ends. Both are compared as benchmarks/same_run.py does, and nothing half-written may be left. The
runs lie in a temporary copy of the project.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.same_run import differences, digest_of

SHARE_WHILE_WRITING = 0.25
"""Share of the kills that wait for a temporary file."""

LONGEST_WAIT = 40.0
"""Most seconds that a run lives before it is killed."""


def copy_project(folder: Path) -> Path:
    """A copy of the checkout, without results and environment."""
    left_out = shutil.ignore_patterns("results", ".venv", ".git", ".snakemake", "__pycache__")
    return Path(shutil.copytree(Path.cwd(), folder / "project", ignore=left_out))


def start(project: Path, overlay: str, target: str) -> subprocess.Popen[bytes]:
    """Snakemake in a session of its own, its output in `snakemake.log`."""
    command = [sys.executable, "-m", "snakemake", "--cores", "2", "--configfile", "config.yaml"]
    with (project / "snakemake.log").open("ab") as log:
        return subprocess.Popen(
            [*command, overlay, "--", target],
            cwd=project,
            env=os.environ | {"PYTHONPATH": str(project)},
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def kill_all(process: subprocess.Popen[bytes]) -> None:
    """SIGKILL to a process and all that it started, the oldest first."""
    try:
        started = psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        started = []
    process.kill()
    for child in started:
        try:
            child.send_signal(signal.SIGKILL)
        except psutil.NoSuchProcess:
            continue
    process.wait()


def temporaries(results: Path) -> list[Path]:
    """Temporary files and folders, of which a run that has ended leaves none."""
    return [path for path in results.rglob(".*~*") if path.name != ".snakemake"]


def kill_at_random(process: subprocess.Popen[bytes], results: Path, rng: random.Random) -> str:
    """Kill a run at some moment; what it was doing, or nothing if it ended before."""
    end = time.monotonic() + rng.uniform(2.0, LONGEST_WAIT)
    writing = rng.random() < SHARE_WHILE_WRITING
    while process.poll() is None:
        if time.monotonic() > end and (
            not writing or any(path.is_file() for path in temporaries(results))
        ):
            kill_all(process)
            return "writing" if writing else "anything"
        time.sleep(0.001 if writing and time.monotonic() > end else 0.05)
    return ""


def main() -> int:
    """Run once undisturbed and then killed; exit code 1 where they differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--overlay", default="workflow/scales/smoke.yaml")
    parser.add_argument("--target", default="tables")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        project = copy_project(Path(folder))
        run = start(project, arguments.overlay, arguments.target)
        if run.wait() != 0:
            print((project / "snakemake.log").read_text()[-3000:])
            return 1
        (results,) = (project / "results").glob("[!.]*/")
        expected = digest_of(results)
        kills: list[str] = []
        lines: list[str] = []
        rounds = 0
        while len(kills) < arguments.kills:
            shutil.rmtree(project / "results")
            shutil.rmtree(project / ".snakemake")
            rounds += 1
            while True:
                run = start(project, arguments.overlay, arguments.target)
                moment = ""
                if len(kills) < arguments.kills:
                    moment = kill_at_random(run, project / "results", rng)
                elif run.wait() != 0:
                    lines.append(f"round {rounds} ended with exit code {run.returncode}")
                if not moment:
                    break
                kills.append(moment)
            if run.returncode != 0:
                lines.append(f"round {rounds} ended with exit code {run.returncode}")
            lines += differences(expected, digest_of(results))
            lines += [f"left over: {path}" for path in temporaries(project / "results")]
            print(f"round {rounds}: {len(kills)} kills so far, {len(lines)} faults", flush=True)
        print("\n".join(lines))
        print(
            f"{len(kills)} kills, {kills.count('writing')} of them while a file was written, in "
            f"{rounds} runs; {len(expected)} hashes each; {len(lines)} faults"
        )
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
