"""Steps in processes of their own; the functions below run there."""

import errno
import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from geoevs.core import isolate
from geoevs.core.errors import GeoEvsError
from geoevs.core.isolate import (
    TIMEOUT,
    MethodFailedError,
    absolute_paths,
    is_machine_fault,
    run_isolated,
)

CHILD = """
import os, signal, subprocess, sys, time
import numpy as np
from geoevs.core.errors import GeoEvsError
from geoevs.core.isolate import begin_part

def double(value):
    return 2 * value

def noisy():
    print('{"failure": "not this"}')
    print("stderr too", file=sys.stderr)
    os.write(1, b"\\xff\\x00 raw bytes\\n")
    return "quiet"

def fail(kind, message):
    raise {"value": ValueError, "ours": GeoEvsError}[kind](message)

def leave(code):
    os._exit(code)

def quit(code):
    sys.exit(code)

def die(number):
    os.kill(os.getpid(), number)
    time.sleep(60)

def allocate(megabytes):
    return float(np.ones(megabytes * 125_000).sum())

def unspeakable():
    return {1, 2}

def stubborn():
    import atexit, threading
    threading.Thread(target=time.sleep, args=(60,)).start()
    atexit.register(os._exit, 7)
    return "done"

def ask():
    return sys.stdin.read()

def hang(how, pids):
    worker = [sys.executable, "-S", "-c", "import time; time.sleep(600)"]
    started = [subprocess.Popen(worker, start_new_session=new).pid for new in (False, True)]
    if how == "ignore":
        for number in set(range(1, 65)) - {9, 19, 32, 33}:
            signal.signal(number, signal.SIG_IGN)
    with open(pids, "w") as file:
        file.write(f"{os.getpid()} {started[0]} {started[1]}")
    if how == "stop":
        os.kill(started[0], signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGSTOP)
    time.sleep(600)

def parts(seconds, **limit):
    for number, wait in enumerate(seconds):
        begin_part(f"part {number}", **limit)
        time.sleep(wait)
    return "done"

def employ(megabytes, workers, waits):
    code = f"x = b'x' * ({megabytes} * 10**6); print(flush=True); import time; time.sleep(1.5)"
    command = [sys.executable, "-S", "-c", code]
    started = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(workers)]
    for process in started:
        process.stdout.readline()
    time.sleep(1.0)
    if waits:
        for process in started:
            process.wait()

def shout(times):
    for _ in range(times):
        print("x" * 99)

def threads():
    import cv2, numba, torch
    return [cv2.getNumThreads(), numba.get_num_threads(), torch.get_num_threads()]
"""


@pytest.fixture
def isolated(tmp_path, monkeypatch):
    """Runs one of the functions above; gives its result and usage."""
    (tmp_path / "child_steps.py").write_text(CHILD)
    paths = [str(tmp_path), *filter(None, sys.path)]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))

    def run(name: str, seconds_limit=None, **arguments):
        step, log = f"child_steps:{name}", tmp_path / "logs" / "step.log"
        return run_isolated(step, arguments, 1, log, seconds_limit)

    return run


def log(tmp_path) -> str:
    return (tmp_path / "logs" / "step.log").read_text(errors="replace")


def failure(isolated, name, **arguments) -> str:
    with pytest.raises(MethodFailedError) as caught:
        isolated(name, **arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_result_comes_back(isolated):
    result, usage = isolated("double", value=[1.5, None])
    assert result == [1.5, None, 1.5, None]
    assert usage.gpu_memory == 0


def test_what_a_method_prints_goes_to_the_log_alone(isolated, tmp_path, capfd):
    assert isolated("noisy")[0] == "quiet"
    assert capfd.readouterr() == ("", "")
    assert "not this" in log(tmp_path)
    assert "stderr too" in log(tmp_path)
    assert "raw bytes" in log(tmp_path)


def test_an_exception_is_one_line_and_the_log_has_its_traceback(isolated, tmp_path):
    assert failure(isolated, "fail", kind="value", message="a\n b") == "ValueError: a b"
    assert "Traceback" in log(tmp_path)
    assert "child_steps.py" in log(tmp_path)
    assert failure(isolated, "fail", kind="ours", message="put it there") == "put it there"
    assert failure(isolated, "fail", kind="value", message="") == "ValueError: no message"
    assert log(tmp_path).count("Traceback") == 3  # appended


def test_a_child_that_leaves_early_has_failed_whatever_its_code(isolated):
    for name in ("leave", "quit"):
        for code in (0, 3):
            reason = failure(isolated, name, code=code)
            assert reason == f"the process ended by itself with exit code {code}"


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (signal.SIGSEGV, "the process was killed by SIGSEGV"),
        (36, "the process was killed by signal 36"),
        (signal.SIGKILL, "machine: the process was killed by SIGKILL, perhaps for lack of memory"),
    ],
)
def test_a_child_that_is_killed_says_by_what(isolated, number, reason):
    assert failure(isolated, "die", number=int(number)) == reason


def test_peak_memory_is_the_childs_own(isolated):
    mine = np.ones(100_000_000)  # 800 MB, which a forked child shares for a moment
    _, small = isolated("allocate", megabytes=1)
    _, large = isolated("allocate", megabytes=200)
    assert 10e6 < small.peak_memory < 200e6
    assert large.peak_memory - small.peak_memory + 5e6 >= 200e6
    assert large.peak_memory < 500e6
    assert mine[0] == 1


def test_a_result_that_is_not_json_is_a_failure(isolated):
    assert failure(isolated, "unspeakable").startswith("TypeError: Object of type set is not JSON")


def test_no_library_starts_more_threads_than_the_budget_has(isolated):
    assert isolated("threads")[0] == [1, 1, 1]


def test_threads_and_exit_hooks_change_nothing(isolated):
    assert isolated("stubborn")[0] == "done"


def test_a_child_that_reads_its_input_does_not_hang(isolated):
    assert isolated("ask")[0] == ""


def test_a_function_that_does_not_exist_is_a_failure(isolated):
    assert failure(isolated, "nothing").startswith("AttributeError: ")


WORKER = "[sys.executable, '-S', '-c', 'import time; time.sleep(600)']"


def alive(pid):
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.parametrize("how", ["sleep", "stop", "ignore"])
def test_a_child_that_hangs_is_ended_at_its_limit(isolated, tmp_path, how):
    began = time.monotonic()
    with pytest.raises(MethodFailedError) as caught:
        isolated("hang", 1.0, how=how, pids=str(tmp_path / "pids"))
    assert 1.0 <= time.monotonic() - began < 6.0
    assert str(caught.value) == "timeout: it took longer than 1 s"
    assert (caught.value.kind, caught.value.limit) == (TIMEOUT, 1.0)
    pids = (tmp_path / "pids").read_text().split()
    assert len(pids) == 3  # itself, a worker in its group, one that left it
    assert not any(alive(int(pid)) for pid in pids)


def test_a_part_may_have_a_limit_of_its_own(isolated):
    assert isolated("parts", 60.0, seconds=[0.1, 0.2])[0] == "done"
    usage = isolated("parts", 60.0, seconds=[0.3, 0.6])[1]
    assert list(usage.parts) == ["part 0", "part 1"]
    assert 0.3 <= usage.parts["part 0"] < 0.6 <= usage.parts["part 1"] < 3
    with pytest.raises(MethodFailedError) as caught:
        isolated("parts", 60.0, seconds=[0.1, 30], limit=1.0)
    assert (caught.value.limit, caught.value.part) == (1.0, "part 1")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_what_a_runner_started_ends_with_it(isolated, tmp_path, number):
    """Whatever ends the runner, Snakemake or somebody at a terminal."""
    pids = tmp_path / "pids"
    call = {"how": "sleep", "pids": str(pids)}
    code = (
        "import signal; from pathlib import Path; from geoevs.core.isolate import run_isolated\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's & ignores it
        f"run_isolated('child_steps:hang', {call!r}, 1, Path({str(tmp_path / 'log')!r}))"
    )
    runner = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    until = time.monotonic() + 30
    while not (pids.exists() and len(pids.read_text().split()) == 3):
        assert time.monotonic() < until
        time.sleep(0.02)
    runner.send_signal(number)
    runner.wait(10)
    until = time.monotonic() + 5
    while any(alive(int(pid)) for pid in pids.read_text().split()):
        assert time.monotonic() < until
        time.sleep(0.02)


@pytest.mark.parametrize("waits", [True, False])
def test_memory_is_that_of_all_workers(isolated, waits):
    _, usage = isolated("employ", megabytes=150, workers=2, waits=waits)
    assert 300e6 < usage.peak_memory < 500e6


def test_a_log_has_an_end(isolated, tmp_path, monkeypatch):
    monkeypatch.setattr(isolate, "LOG_BYTES", 10_000)
    for _ in range(2):
        assert isolated("shout", times=1000)[0] is None
    text = log(tmp_path)
    assert len(text) < 10_200
    assert text.count("[cut: a log has at most 0.01 MB]") == 2
    assert text.startswith("x" * 99)


def test_paths_are_absolute_where_a_step_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "images/inner").mkdir(parents=True)
    (tmp_path / "telea").write_text("")
    options = {
        "folder": "images",
        "weights": "images/inner",
        "inpaint": "telea",
        "n": 3,
        "no": "\0",
    }
    changed = {"folder": str(tmp_path / "images"), "weights": str(tmp_path / "images/inner")}
    assert absolute_paths(options) == options | changed


MACHINES = [
    MemoryError(),
    type("OutOfMemoryError", (RuntimeError,), {})("CUDA out of memory"),
    *(OSError(number, "x") for number in (errno.ENOSPC, errno.EDQUOT, errno.EIO)),
]


@pytest.mark.parametrize("error", MACHINES)
def test_faults_of_the_machine_are_told_from_those_of_methods(error):
    assert is_machine_fault(error)
    wrapped = GeoEvsError("cannot write it")
    wrapped.__cause__ = error
    assert is_machine_fault(wrapped)
    loop = ValueError("a")
    loop.__cause__ = KeyError("b")
    loop.__cause__.__context__ = loop
    assert not is_machine_fault(loop)
    assert not is_machine_fault(OSError(errno.ENOENT, "gone"))
    assert not is_machine_fault(OSError("no number"))
