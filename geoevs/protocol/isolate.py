"""Running one step of a method in a process of its own, so that nothing it does ends the run.

The child's output goes to a log. A crash, even of the interpreter, becomes a `MethodFailedError`
with its reason; the peak memory it reports is the method's own.
"""

import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geoevs.core.errors import reason_of
from geoevs.core.files import write_json


class MethodFailedError(Exception):
    """A method's step failed; its text is the reason in one line."""


@dataclass(frozen=True)
class Usage:
    """The memory that a child process used: peak resident and peak GPU memory, in bytes."""

    peak_memory: int
    gpu_memory: int


THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
"""Variables that bound threads. PyTorch and NumPy's linear algebra read the first three, Numba and
OpenCV one each."""


def run_isolated(
    function: str, arguments: dict[str, Any], threads: int, log: Path
) -> tuple[Any, Usage]:
    """Call `module:function` with JSON-able keyword arguments in a fresh Python process.

    Args:
        function: where it is, such as `geoevs.protocol.fit_step:fit_step`.
        arguments: its keyword arguments.
        threads: how many its numerical libraries may start.
        log: where the child's output and traceback are appended.

    Returns:
        The function's JSON-able result, and what the process used.

    Raises:
        MethodFailedError: the function raised, or the process died.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch, log.open("a", encoding="utf-8") as output:
        answer = Path(scratch) / "answer.json"
        process = subprocess.run(
            [sys.executable, "-m", "geoevs.protocol.isolate", function, answer],
            input=json.dumps(arguments),
            text=True,
            env=os.environ | dict.fromkeys(THREAD_VARIABLES, str(threads)),
            stdout=output,
            stderr=subprocess.STDOUT,
            check=False,
        )
        if not answer.exists():
            raise MethodFailedError(_death(process.returncode))
        reply = json.loads(answer.read_text(encoding="utf-8"))
    if "failure" in reply:
        raise MethodFailedError(reply["failure"])
    return reply["result"], Usage(reply["peak_memory"], reply["gpu_memory"])


def _death(code: int) -> str:
    if code >= 0:
        return f"the process ended by itself with exit code {code}"
    name = signal.Signals(-code).name
    hint = ", perhaps for lack of memory" if -code == signal.SIGKILL else ""
    return f"the process was killed by {name}{hint}"


def _peak_memory() -> int:
    """Peak resident bytes of this process.

    `getrusage` would count the parent's too, whose memory a child shares until it is replaced.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _peak_gpu_memory() -> int:
    torch = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_available():
        return 0
    return int(torch.cuda.max_memory_allocated())


def _child(function: str, answer: str) -> None:
    arguments = json.load(sys.stdin)
    module, name = function.split(":")
    try:
        reply = {
            "result": getattr(importlib.import_module(module), name)(**arguments),
            "peak_memory": _peak_memory(),
            "gpu_memory": _peak_gpu_memory(),
        }
        write_json(Path(answer), reply)
    except Exception as error:
        traceback.print_exc()
        write_json(Path(answer), {"failure": reason_of(error)})


if __name__ == "__main__":
    _child(*sys.argv[1:])
    # A method's threads or atexit hooks must not change the outcome any more.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)
