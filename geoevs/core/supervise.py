"""Watching over one process of a stranger's code, and ending with it all that it has started.

A script that `geoevs.core.isolate` starts in a session of its own. It imports the standard library
alone, so that it is there in a moment. It lies between the runner and the stranger: whoever kills
its parent kills no runner; workers that leave their group fall to it, and not to the machine.

Standard input is one line of JSON (see `Watch`), and stays open for as long as the runner lives:
when that ends, in whatever way, so does everything here. Standard output gets the report.
"""

import contextlib
import ctypes
import fcntl
import json
import os
import select
import signal
import sys
import time

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
SAMPLE_EVERY = 0.1
"""Seconds between looks at the memory of processes, as long as a look is short."""
SAMPLE_SHARE = 0.05
"""Largest share of the time that is spent on looking."""
LAST_SECONDS = 3.0
"""How long processes that were killed may take to be gone."""
AFTER_ANSWER = 2.0
"""Seconds in which a process that has answered must end."""
LONGEST_ANSWER = 4_000_000
"""Bytes; an answer is a few numbers and sentences."""
FIRST_CHANNEL = 200
"""The answer's descriptor is at least this, out of the way of those that are closed by number."""


def prctl(option: int, value: int) -> None:
    """Set an attribute of this process, where the system is Linux."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0)


def descendants(root: int) -> list[int]:
    """Processes that `root` or one of its descendants has started; none where /proc is not."""
    children: dict[int, list[int]] = {}
    with contextlib.suppress(OSError):
        for name in os.listdir("/proc"):
            if name.isdigit():
                with contextlib.suppress(OSError, ValueError, IndexError):
                    with open(f"/proc/{name}/stat", "rb") as file:
                        parent = int(file.read().rpartition(b")")[2].split()[1])
                    children.setdefault(parent, []).append(int(name))
    found, new = [], children.get(root, [])
    while new:
        found += new
        new = [child for pid in new for child in children.get(pid, ())]
    return found


def resident(pid: int) -> int:
    """Bytes of memory of a process; what several share counts in parts."""
    with contextlib.suppress(OSError, ValueError), open(f"/proc/{pid}/smaps_rollup", "rb") as file:
        for line in file:
            if line.startswith(b"Pss:"):
                return int(line.split()[1]) * 1024
    return 0


def end_all(pids: "list[int] | None" = None, spared: "set[int] | None" = None) -> dict[int, int]:
    """Kill descendants, those that are stopped too, until none is left; statuses of own children.

    Args:
        pids: what is killed whether or not /proc knows it.
        spared: descendants that are left alone, with all that they have started since.
    """
    statuses: dict[int, int] = {}
    until = time.monotonic() + LAST_SECONDS
    spared = set(spared or ())
    for pid in list(spared):
        spared.update(descendants(pid))
    while time.monotonic() < until:
        left = {*descendants(os.getpid()), *(pids or [])} - spared - statuses.keys()
        if not left:
            break
        for pid in left:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        for pid in left:
            with contextlib.suppress(OSError):
                done, status = os.waitpid(pid, os.WNOHANG)
                if done:
                    statuses[done] = status
        pids = [pid for pid in pids or [] if pid not in statuses and _is_there(pid)]
        time.sleep(0.003)
    return statuses


def _is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


class Watch:
    """One process from its start to its end, and that of all it has started.

    Args:
        wanted: `command`, `environment`, `folder` (the working directory), `input` (text for its
            standard input), `nonce` (what its answers begin with), `limit` (seconds, or None), and
            `log` (a path, or None: standard error) with `log_bytes`.
        runner: a descriptor that is at its end when the runner is.
    """

    def __init__(self, wanted: dict, runner: int) -> None:
        self.runner = runner
        self.nonce = wanted["nonce"].encode()
        self.limit = wanted["limit"]
        self.answer = None
        self.ended = ""  # why it was ended here: timeout, forged, runner
        self.peak = 0
        self.parts: dict[str, float] = {}
        self._part = ("", 0.0)
        self._answered = 0.0
        self._status: int | None = None
        self._received = b""
        self._log = _Log(wanted["log"], wanted["log_bytes"]) if wanted["log"] else None
        self._start(wanted)

    def _start(self, wanted: dict) -> None:
        answers, answer_to = os.pipe()
        output, output_to = os.pipe()
        given, self._input = os.pipe()
        channel = fcntl.fcntl(answer_to, fcntl.F_DUPFD, FIRST_CHANNEL)
        self._pending = json.dumps({**wanted["input"], "channel": channel}).encode()
        parent = os.getpid()
        self.pid = os.fork()
        if self.pid == 0:
            try:
                os.setsid()
                prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
                if os.getppid() != parent:
                    os._exit(1)
                for number in (signal.SIGINT, signal.SIGTERM, signal.SIGPIPE, signal.SIGXFSZ):
                    signal.signal(number, signal.SIG_DFL)
                os.dup2(given, 0)
                os.dup2(output_to if self._log else 2, 1)
                os.dup2(1, 2)
                os.set_inheritable(channel, True)
                os.chdir(wanted["folder"])
                os.execve(wanted["command"][0], wanted["command"], wanted["environment"])
            finally:
                os._exit(127)
        for descriptor in (answer_to, output_to, given, channel):
            os.close(descriptor)
        self._readers = {answers: self._read_answer, output: self._read_output}
        for descriptor in (*self._readers, self._input):
            os.set_blocking(descriptor, False)
        self._exit = None
        with contextlib.suppress(OSError, AttributeError):
            self._exit = os.pidfd_open(self.pid)
        self.began = time.monotonic()
        self.deadline = None if self.limit is None else self.began + self.limit

    def run(self) -> dict:
        """Wait for its end, or bring it about; what there is to say of it."""
        next_sample, answered = self.began + SAMPLE_EVERY, None
        while self._status is None and not self.ended:
            now = time.monotonic()
            if self.answer is not None:
                answered = answered or now
                if now - answered > AFTER_ANSWER:
                    break
            elif self.deadline is not None and now >= self.deadline:
                self.ended = "timeout"
                break
            if now >= next_sample:
                self._sample()
                spent = time.monotonic() - now
                next_sample = now + max(SAMPLE_EVERY, spent / SAMPLE_SHARE)
            self._wait(max(0.0, min(next_sample, self.deadline or next_sample) - time.monotonic()))
            self._reap()
        seconds = time.monotonic() - self.began
        for descriptor in list(self._readers):  # what came before the end
            self._drain(descriptor)
        statuses = end_all([self.pid] if self._status is None else [])
        status = statuses.get(self.pid, 0) if self._status is None else self._status
        for descriptor in list(self._readers):
            self._drain(descriptor)
        part = self._part[0]
        self._close_part()
        return {
            "code": os.waitstatus_to_exitcode(status),
            "ended": self.ended,
            "limit": self.limit,
            "answer": self.answer,
            "peak_memory": self.peak,
            "part": part,
            "parts": self.parts,
            "seconds": seconds,
        }

    def _wait(self, seconds: float) -> None:
        reading = [self.runner, *self._readers, *([] if self._exit is None else [self._exit])]
        writing = [] if self._input is None else [self._input]
        ready, writable, _ = select.select(reading, writing, [], seconds)
        if writable:
            self._write_input()
        for descriptor in ready:
            if descriptor == self.runner:
                if not os.read(self.runner, 4096):
                    self.ended = "runner"
            elif descriptor in self._readers:
                self._read(descriptor)

    def _write_input(self) -> None:
        try:
            self._pending = self._pending[os.write(self._input, self._pending) :]
        except OSError:
            self._pending = b""
        if not self._pending:
            os.close(self._input)
            self._input = None

    def _read(self, descriptor: int) -> bool:
        try:
            data = os.read(descriptor, 1 << 16)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if not data:
            del self._readers[descriptor]
            os.close(descriptor)
            return False
        self._readers[descriptor](data)
        return True

    def _drain(self, descriptor: int) -> None:
        until = time.monotonic() + 1.0  # a process that lives on may write for ever
        while descriptor in self._readers and time.monotonic() < until and self._read(descriptor):
            pass

    def _read_output(self, data: bytes) -> None:
        if self._log:
            self._log.write(data)

    def _read_answer(self, data: bytes) -> None:
        """Lines that begin with the nonce: marks, and one answer. Anything else is a stranger's."""
        self._received += data
        *lines, self._received = self._received.split(b"\n")
        for line in lines:
            nonce, _, text = line.partition(b" ")
            told = None
            with contextlib.suppress(ValueError):
                told = json.loads(text) if nonce == self.nonce else None
            if self.answer is not None or not isinstance(told, dict):
                self.ended = self.ended or "forged"
                return
            if "part" in told:
                self._close_part()
                self._part = (told["part"], time.monotonic())
                if "limit" in told:
                    self.limit = told["limit"]
                    self.deadline = None if self.limit is None else self._part[1] + self.limit
            else:
                self.answer = told
                self._answered = time.monotonic()
        if len(self._received) > LONGEST_ANSWER:
            self.ended = self.ended or "forged"

    def _close_part(self) -> None:
        name, began = self._part
        if name:
            self.parts[name] = (self._answered or time.monotonic()) - began
        self._part = ("", 0.0)

    def _reap(self) -> None:
        """Take leave of the process, and of those that fell to this one."""
        with contextlib.suppress(ChildProcessError):
            while True:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if not pid:
                    return
                if pid == self.pid:
                    self._status = status

    def _sample(self) -> None:
        """A single process says its own peak; several are added up."""
        pids = descendants(os.getpid())
        if len(pids) > 1:
            self.peak = max(self.peak, sum(map(resident, pids)))


class _Log:
    """A file that takes output until it is full, and says then that there was more."""

    def __init__(self, path: str, most: int) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
        self._left = max(0, most - os.fstat(self._file).st_size)
        self._cut = f"\n[cut: a log has at most {most / 1e6:g} MB]\n".encode()

    def write(self, data: bytes) -> None:
        """Append what there is room for; a disk that is full loses the rest."""
        with contextlib.suppress(OSError):
            if data[: self._left]:
                os.write(self._file, data[: self._left])
            if len(data) > self._left and self._cut:
                os.write(self._file, self._cut)
                self._cut = b""
        self._left = max(0, self._left - len(data))


def main() -> None:
    """Watch over what standard input describes, and report its end."""
    prctl(PR_SET_CHILD_SUBREAPER, 1)
    report = fcntl.fcntl(1, fcntl.F_DUPFD_CLOEXEC, 3)
    os.dup2(2, 1)
    runner = fcntl.fcntl(0, fcntl.F_DUPFD_CLOEXEC, 3)
    line = b""
    while not line.endswith(b"\n"):
        data = os.read(runner, 1 << 16)
        if not data:
            return
        line += data
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The runner decides who ends; its own end is seen at the pipe.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    text = json.dumps(Watch(json.loads(line), runner).run()).encode()
    with contextlib.suppress(OSError):
        while text:
            text = text[os.write(report, text) :]


if __name__ == "__main__":
    sys.exit(main())
