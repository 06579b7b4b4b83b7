"""Steps in processes of their own; the functions below run there."""

import os
import signal
import sys

import numpy as np
import pytest

from geoevs.core.isolate import MethodFailedError, run_isolated

CHILD = """
import os, signal, sys, time
import numpy as np
from geoevs.core.errors import GeoEvsError

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

    def run(name: str, **arguments):
        return run_isolated(f"child_steps:{name}", arguments, 1, tmp_path / "logs" / "step.log")

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
