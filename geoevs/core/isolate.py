"""Running one step of a stranger's code in a process of its own: nothing it does ends the run.

Between the two stands a supervisor (`geoevs.core.supervise`), which ends the process at its limit
and with it all that it has started. Output goes to a log. A crash, even of the interpreter, becomes
a `MethodFailedError` with its reason; peak memory is that of the process and its workers.
"""

import contextlib
import errno
import importlib
import json
import os
import resource
import secrets
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geoevs.core import supervise
from geoevs.core.code_hash import PACKAGES
from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.files import FolderRemovedError, new_folder
from geoevs.core.text import clean

LOG_BYTES = 20_000_000
"""Most bytes of a log."""

LATE = 2.0
"""Seconds past its limit after which a supervisor that does not answer is given up."""

MACHINE, TIMEOUT = "machine", "timeout"
"""Kinds of failures that are not, or not only, the method's; reasons begin with these words."""

MACHINE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EIO)

OUT_OF_MEMORY = ("MemoryError", "OutOfMemoryError")
"""Names of exceptions for lack of memory, PyTorch's on a GPU among them."""


class MethodFailedError(Exception):
    """A method's step failed; its text is the reason in one line.

    Args:
        reason: why.
        kind: MACHINE, TIMEOUT, or empty.
        limit: the seconds that it had, where it took more.

    `part` is the last part of the step that had begun (see `begin_part`), if any had.
    """

    def __init__(self, reason: str, kind: str = "", limit: float | None = None) -> None:
        super().__init__(f"{kind}: {reason}" if kind else reason)
        self.kind, self.limit, self.part = kind, limit, ""


@dataclass(frozen=True)
class Usage:
    """What a step used: peak memory of its processes, peak GPU memory of the main one, in bytes.

    `parts` are the seconds of its parts by the runner's clock (see `begin_part`).
    """

    peak_memory: int
    gpu_memory: int
    parts: Mapping[str, float] = field(default_factory=dict)


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
    function: str,
    arguments: Mapping[str, Any],
    threads: int | None,
    log: Path | None,
    limit: float | None = None,
) -> tuple[Any, Usage]:
    """Call `module:function` with JSON-able keyword arguments in a fresh Python process.

    Its working directory is an empty folder that is deleted afterwards, so paths among the
    arguments are absolute. When the call returns, nothing that the function started is left.

    Args:
        function: where it is, such as `geoevs.protocol.fit_step:fit_step`.
        arguments: its keyword arguments.
        threads: how many its numerical libraries may start; None: what the environment says.
        log: where the child's output and traceback are appended; None: this process' own.
        limit: seconds after which it is ended; None: never.

    Returns:
        The function's JSON-able result, and what the process used.

    Raises:
        MethodFailedError: the function raised, or the process died or was ended.
        GeoEvsError: the log cannot be written.
    """
    if log is not None:
        _touch(log)
    nonce = secrets.token_hex(16)
    packages = {name: list(sys.modules[name].__path__) for name in PACKAGES if name in sys.modules}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        wanted = {
            "command": [sys.executable, "-P", "-c", f"from {__name__} import child; child()"],
            "environment": _environment(threads),
            "folder": scratch,
            "input": {
                "function": function,
                "arguments": arguments,
                "nonce": nonce,
                "packages": packages,
            },
            "nonce": nonce,
            "limit": limit,
            "log": None if log is None else str(log.absolute()),
            "log_bytes": LOG_BYTES,
        }
        report = _supervised(wanted, limit)
    try:
        return _result(report)
    except MethodFailedError as failure:
        failure.part = (report or {}).get("part", "")
        raise


@contextlib.contextmanager
def lent_folder(path: Path) -> Iterator[Path]:
    """A `new_folder` for a step to fill; if it removes that, it has failed.

    Raises:
        MethodFailedError: it was removed, whatever stands in its place.
        GeoEvsError: see `new_folder`.
    """
    try:
        with new_folder(path) as folder:
            yield folder
    except FolderRemovedError as error:
        raise MethodFailedError("the folder that it was given was removed") from error


def absolute_paths(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options whose relative paths are absolute: steps work in folders of their own.

    A text is a path if it names a folder, or something in a folder that is there, from where the
    runner works.
    """
    return {
        name: os.path.abspath(value) if isinstance(value, str) and _is_path(value) else value
        for name, value in options.items()
    }


def _is_path(text: str) -> bool:
    try:
        return os.path.isdir(text) or (os.sep in text and os.path.isdir(os.path.dirname(text)))
    except ValueError:  # a null character
        return False


def _touch(log: Path) -> None:
    """A log that cannot be written is no method's fault."""
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        log.touch()
    except OSError as error:
        raise GeoEvsError(
            f"cannot write {log} ({error.strerror}); free space there or make it writable"
        ) from error


def _environment(threads: int | None) -> dict[str, str]:
    environment = dict(os.environ)
    if threads is not None:
        environment |= dict.fromkeys(THREAD_VARIABLES, str(threads))
    # The same code as here, wherever the child works.
    root = str(Path(__file__).parents[2])
    given = environment.get("PYTHONPATH", "")
    paths = [root, *(os.path.abspath(path) for path in given.split(os.pathsep) if given)]
    environment["PYTHONPATH"] = os.pathsep.join(dict.fromkeys(paths))
    return environment


def _supervised(wanted: dict[str, Any], limit: float | None) -> dict[str, Any] | None:
    """What the supervisor reports; None where it was ended itself, or does not answer."""
    supervise.prctl(supervise.PR_SET_CHILD_SUBREAPER, 1)  # for what a lost supervisor leaves
    others = set(supervise.descendants(os.getpid()))
    process = subprocess.Popen(
        [sys.executable, "-I", "-S", supervise.__file__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
        bufsize=0,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    reported, whole = b"", False
    try:
        with contextlib.suppress(BrokenPipeError):
            _write(process.stdin.fileno(), json.dumps(wanted).encode() + b"\n")
        until = None if limit is None else time.monotonic() + limit + LATE
        while True:
            left = None if until is None else max(0.0, until - time.monotonic())
            ready, _, _ = select.select([process.stdout], [], [], left)
            data = os.read(process.stdout.fileno(), 1 << 16) if ready else b""
            if not data:
                whole = bool(reported)
                break
            reported += data
    finally:
        process.stdin.close()  # it ends what it watches over, if it has not
        try:
            process.wait(1.0 if until is not None and not reported else supervise.LAST_SECONDS + 2)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()
        if not whole:
            supervise.end_all(spared=others)
        supervise.prctl(supervise.PR_SET_CHILD_SUBREAPER, 0)
    with contextlib.suppress(ValueError):
        return json.loads(reported)
    late = until is not None and time.monotonic() >= until
    return {"ended": "timeout", "limit": limit} if late else None


def _result(report: dict[str, Any] | None) -> tuple[Any, Usage]:
    if report is None:
        raise MethodFailedError("the process that watched over it was killed")
    if report["ended"] == "timeout":
        raise _too_long(report["limit"])
    if report["ended"] == "forged":
        raise MethodFailedError("something else than its answer was written where that belongs")
    reply = report["answer"]
    if reply is None:
        raise _death(report["code"])
    if "failure" in reply:
        kind = MACHINE if reply.get("machine") else ""
        raise MethodFailedError(clean(str(reply["failure"])), kind)
    try:
        peak = max(int(reply["peak_memory"]), report["peak_memory"])
        return reply["result"], Usage(peak, int(reply["gpu_memory"]), report["parts"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise MethodFailedError("its answer has another form than it should have") from error


def _too_long(limit: float) -> MethodFailedError:
    return MethodFailedError(f"it took longer than {limit:g} s", TIMEOUT, limit)


def _death(code: int) -> MethodFailedError:
    if code >= 0:
        return MethodFailedError(f"the process ended by itself with exit code {code}")
    if -code == signal.SIGKILL:
        return MethodFailedError(
            "the process was killed by SIGKILL, perhaps for lack of memory", MACHINE
        )
    return MethodFailedError(f"the process was killed by {signal_name(-code)}")


def signal_name(number: int) -> str:
    """A signal's name; real-time signals have numbers alone.

    >>> signal_name(11), signal_name(36)
    ('SIGSEGV', 'signal 36')
    """
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def is_machine_fault(error: BaseException) -> bool:
    """Whether an exception, or one behind it, says that memory or disk gave out.

    >>> is_machine_fault(OSError(errno.ENOSPC, "full")), is_machine_fault(OSError("gone"))
    (True, False)
    """
    seen: set[int] = set()
    links: list[BaseException | None] = [error]
    while links:
        link = links.pop()
        if link is None or id(link) in seen:
            continue
        seen.add(id(link))
        if any(kind.__name__ in OUT_OF_MEMORY for kind in type(link).__mro__):
            return True
        if isinstance(link, OSError) and link.errno in MACHINE_ERRORS:
            return True
        links += [link.__cause__, link.__context__]
    return False


def _peak_memory() -> int:
    """Peak resident bytes of this process, or of the largest worker that it has waited for.

    Of the process itself, `getrusage` would count the parent's too, whose memory a child shares
    until it is replaced. A worker's is this process' own then, which changes nothing.
    """
    unit = 1 if sys.platform == "darwin" else 1024
    workers = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * unit
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return max(int(line.split()[1]) * 1024, workers)
    return max(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit, workers)


def _peak_gpu_memory() -> int:
    torch = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_available():
        return 0
    return int(torch.cuda.max_memory_allocated())


def _write(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


class _Channel:
    """The child's way to its supervisor: lines that begin with what the two alone know."""

    def __init__(self, descriptor: int, nonce: str) -> None:
        os.set_inheritable(descriptor, False)
        self._descriptor, self._nonce = descriptor, nonce

    def tell(self, message: Mapping[str, Any]) -> None:
        _write(self._descriptor, f"{self._nonce} {json.dumps(message)}\n".encode())


_channel: _Channel | None = None


def begin_part(name: str, **limit: float | None) -> None:
    """Tell the runner that a part of a step begins here, and that the one before has ended.

    Its clock times the parts. Nothing happens outside of `run_isolated`.

    Args:
        name: of the part.
        limit: as `limit=SECONDS`, which this part may take; without, that of the step goes on.
    """
    if _channel is not None:
        _channel.tell({"part": name, **limit})


def child() -> None:
    """What the isolated process runs: one call, one answer, and the end."""
    global _channel
    wanted = json.loads(sys.stdin.buffer.read())
    _channel = _Channel(wanted["channel"], wanted["nonce"])
    code = 0
    try:
        for package, folders in wanted["packages"].items():
            importlib.import_module(package).__path__ = folders
        module, name = wanted["function"].split(":")
        _channel.tell(
            {
                "result": getattr(importlib.import_module(module), name)(**wanted["arguments"]),
                "peak_memory": _peak_memory(),
                "gpu_memory": _peak_gpu_memory(),
            }
        )
    except SystemExit as leave:
        code = leave.code & 0xFF if isinstance(leave.code, int) else int(leave.code is not None)
    except BaseException as error:
        code = _tell_failure(_channel, error)
    # A method's threads or atexit hooks must not change the outcome any more.
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(BaseException):
            stream.flush()
    os._exit(code)


def _tell_failure(channel: _Channel, error: BaseException) -> int:
    """Print a traceback and answer with the reason; the exit code, which says if that failed."""
    with contextlib.suppress(BaseException):
        traceback.print_exc()
    reason, machine = type(error).__name__, False
    with contextlib.suppress(BaseException):
        machine = is_machine_fault(error)
        reason = reason_of(error)
    try:
        channel.tell({"failure": reason, "machine": machine})
    except BaseException:
        return 1
    return 0
