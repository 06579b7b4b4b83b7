"""Methods that misbehave: each ends in rows of its own, and leaves nothing that runs on.

One method a line: where it misbehaves, how it ends, and what its rows say. `fit` and `render` are
stages of a failure; `view` is a failure of some views alone; `ok` is none.
"""

import os
import re
import textwrap
import time
from pathlib import Path

import pandas as pd
import psutil
import pytest
from hypothesis import settings

import baselines
from geoevs import layout
from geoevs.core.files import read_json
from geoevs.core.isolate import LOG_BYTES
from geoevs.core.parquet import join_parquet, write_parquet
from geoevs.methods.contract import Budget
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.rows import cost_frame, score_frame
from geoevs.protocol.runs import fit_method, render_method
from geoevs.protocol.scoring import cost_rows, score_method
from geoevs.run import Answers

LIMIT = 2.0
"""Seconds for a step that hangs; others have USUAL ones."""
USUAL = 60.0
LATE = 5.0
"""Seconds past its limit in which a hanging step must have ended."""

TEMPLATE = '''
import atexit, ctypes, errno, json, os, shutil, signal, subprocess, sys, threading, time
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from geoevs.methods.contract import FitReport, MethodInfo, Rendering
from geoevs.core.errors import GeoEvsError

WORKER = [sys.executable, "-S", "-c", "import time; time.sleep(600)"]

class Mute(Exception):
    def __str__(self):
        raise ValueError("no words")
    __repr__ = __str__

class Beyond(BaseException):
    pass

def daemon():
    """A process that has left its parent and its session."""
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            for fd in range(1000):
                try:
                    os.close(fd)
                except OSError:
                    pass
            time.sleep(600)
        os._exit(0)

def open_descriptors():
    return [int(name) for name in os.listdir("/proc/self/fd") if int(name) > 2]

@dataclass
class Method:
    info = MethodInfo("Bad", "control")

    def fit(self, views, budget, rng):
        report = FitReport()
{fit}
        return report

    def render(self, camera, frame):
        rgb = np.full((camera.height, camera.width, 3), 0.5)
{render}
        return Rendering(rgb)

    def save(self, folder):
        (folder / "value").write_bytes(b"12345")
{save}

    @classmethod
    def load(cls, folder):
{load}
        return cls()
'''

HUNG = rf"^timeout: it took longer than {LIMIT:g} s$"
KILLED = "^machine: the process was killed by SIGKILL, perhaps for lack of memory$"
FORGED = "^something else than its answer was written"

# Where it misbehaves, in which lines; how it ends; what its rows say.
METHODS = {
    # What its report says.
    "a-text-of-seconds": ("fit", "report = FitReport(training_seconds='long')", "fit",
                          "training_seconds is 'long'; give seconds, or None"),
    "numpy-numbers": ("fit", "report = FitReport(np.int32(3), np.array(4), 'n', np.float32(2))",
                      "ok", ""),
    "huge-primitives": ("fit", "report = FitReport(primitives=10**30)", "fit",
                        "primitives is 1000000.*; give a whole number from 0 on"),
    "a-note-of-bytes": ("fit", "report = FitReport(note=b'n')", "fit", "note is a bytes; make it"),
    "a-note-of-megabytes": ("fit", "report = FitReport(note='n' * 10**7)", "ok", ""),
    "a-broken-note": ("fit", r"report = FitReport(note='=HY\udcff\x1b[31m\n# |')", "ok", ""),
    "no-report": ("fit", "report = None", "fit", "^fit returned a NoneType; return a FitReport$"),
    "a-report-without-words": ("fit", "report = FitReport(primitives=Mute())", "fit",
                               "primitives is a Mute; give a whole number"),
    # What it raises.
    "surrogates": ("fit", r"raise OSError('no \udcff\x1b[2J file')", "fit", r"^OSError: no \[2J f"),
    "megabytes": ("fit", "raise ValueError('x' * 5_000_000)", "fit",
                  r"^ValueError: x{100,600}\.\.\. \(\d+ characters more\)$"),
    "without-words": ("fit", "raise Mute()", "fit", "^Mute: no message$"),
    "interrupted": ("fit", "raise KeyboardInterrupt", "fit", "^KeyboardInterrupt: no message$"),
    "beyond": ("render", "raise Beyond('x')", "render", "^Beyond: x$"),
    "bottomless": ("fit", "f = lambda: f()\nf()", "fit", "^RecursionError: "),
    "out-of-memory": ("fit", "raise MemoryError", "fit", "^machine: MemoryError: no message$"),
    "a-billion-gigabytes": ("fit", "np.zeros(2**50)", "fit", "^machine: .*MemoryError: Unable"),
    "a-full-disk": ("save", "raise OSError(errno.ENOSPC, 'No space left on device')", "fit",
                    r"^machine: OSError: \[Errno 28\] No space left"),
    "a-full-disk-behind": (
        "save",
        "try:\n    raise OSError(errno.EDQUOT, 'quota')\nexcept OSError as e:\n"
        "    raise GeoEvsError('cannot write it') from e",
        "fit", "^machine: cannot write it"),
    # How it leaves.
    "exits": ("fit", "sys.exit()", "fit", "^the process ended by itself with exit code 0$"),
    "leaves": ("render", "os._exit(0)", "render", "exit code 0$"),
    "exit-hooks": ("fit", "atexit.register(time.sleep, 600); atexit.register(os._exit, 3)", "ok",
                   ""),
    "endless-threads": ("fit", "threading.Thread(target=time.sleep, args=(600,)).start()", "ok",
                        ""),
    "segfault": ("fit", "ctypes.string_at(0)", "fit", "^the process was killed by SIGSEGV$"),
    "aborts": ("render", "os.abort()", "render", "^the process was killed by SIGABRT$"),
    "kills-itself": ("fit", "os.kill(os.getpid(), signal.SIGKILL)", "fit", KILLED),
    "terminates-itself": ("fit", "os.kill(os.getpid(), signal.SIGTERM); time.sleep(600)", "fit",
                          "^the process was killed by SIGTERM$"),
    "a-real-time-signal": ("fit", "os.kill(os.getpid(), 36); time.sleep(600)", "fit",
                           "^the process was killed by signal 36$"),
    "interrupts-itself": ("fit", "os.kill(os.getpid(), signal.SIGINT); time.sleep(600)", "fit",
                          "^KeyboardInterrupt: "),
    "kills-its-group": ("fit", "os.killpg(0, signal.SIGKILL)", "fit", KILLED),
    "kills-its-parent": ("fit", "os.kill(os.getppid(), signal.SIGKILL); time.sleep(600)", "fit",
                         "^the process that watched over it was killed$"),
    # How it hangs.
    "sleeps-in-fit": ("fit", "time.sleep(600)", "fit", HUNG),
    "sleeps-in-load": ("load", "time.sleep(600)", "render", HUNG),
    "sleeps-in-render": ("render", "time.sleep(600)", "render", HUNG),
    "stops-itself": ("fit", "os.kill(os.getpid(), signal.SIGSTOP)", "fit", HUNG),
    "stops-its-parent": ("fit", "os.kill(os.getppid(), signal.SIGSTOP); time.sleep(600)", "fit",
                         HUNG),
    "deaf": (
        "fit",
        "for n in range(1, 65):\n    try:\n        signal.signal(n, signal.SIG_IGN)\n"
        "    except (OSError, ValueError):\n        pass\ntime.sleep(600)",
        "fit", HUNG),
    # Whom it leaves behind.
    "a-worker": ("fit", "subprocess.Popen(WORKER)", "ok", ""),
    "a-stopped-worker": ("fit", "os.kill(subprocess.Popen(WORKER).pid, signal.SIGSTOP)", "ok", ""),
    "a-worker-of-its-own": ("render", "subprocess.Popen(WORKER, start_new_session=True)", "ok", ""),
    "a-daemon": ("fit", "daemon()", "ok", ""),
    "a-daemon-and-a-crash": ("fit", "daemon(); ctypes.string_at(0)", "fit", "SIGSEGV"),
    "a-fork-that-comes-back": ("fit", "os.fork()", "any", ""),
    # Where it goes, and what it breaks there.
    "elsewhere": ("fit", "os.chdir('/')", "ok", ""),
    "elsewhere-in-render": ("render", "os.makedirs('out'); os.chdir('out')", "view", ""),
    "no-working-folder": ("fit", "shutil.rmtree(os.getcwd())", "ok", ""),
    "no-model-folder": ("save", "shutil.rmtree(folder)", "fit", "^save removed the folder that it"),
    "no-folder-at-all": ("save", "shutil.rmtree(folder.parents[1])", "fit",
                         "^save removed the folder that it"),
    "a-locked-folder": ("save", "folder.chmod(0)", "any", ""),
    "a-mask": ("fit", "os.umask(0o777)", "any", ""),
    "another-environment": ("fit", "os.environ.clear(); sys.path.clear()", "ok", ""),
    "closed-descriptors": ("fit", "os.closerange(0, 10)", "ok", ""),
    "all-descriptors-closed": ("fit", "os.closerange(0, 1000)", "fit", "exit code 1$"),
    "no-output": ("fit", "sys.stdout.close(); sys.stderr = None", "ok", ""),
    "a-flood": ("fit", "for _ in range(400): print('x' * 10**5)", "ok", ""),
    "other-functions": ("fit", "json.dumps = open = os.write = None", "fit", "exit code 1$"),
    "another-clock": (
        "fit",
        "import geoevs.protocol.clock as c\nnow = time.perf_counter()\n"
        "c.time = type('T', (), {'perf_counter': staticmethod(lambda: now)})\ntime.sleep(2.6)",
        "fit", r"^it told .* s for 'fit', which took \d.*s by the runner's clock"),
    # What it answers in the runner's place.
    "forged-lines": (
        "fit",
        "for fd in open_descriptors():\n    try:\n"
        "        os.write(fd, b'{\"result\": {\"fit_seconds\": 0}}\\n')\n"
        "    except OSError:\n        pass\ntime.sleep(600)",
        "fit", FORGED),
    "forged-and-gone": (
        "fit",
        "for fd in open_descriptors():\n    try:\n        os.write(fd, b'0 {}\\n')\n"
        "    except OSError:\n        pass\nos._exit(0)",
        "fit", FORGED),
    # What it calls a picture.
    "up-to-255": ("render", "rgb = rgb * 255", "render", "rgb spans 127.5 to 127.5; keep it fin"),
    "from-minus-1": ("render", "rgb = rgb * 2 - 1.5", "render", "rgb spans -0.5 to -0.5; keep it"),
    "a-hair-above-1": ("render", "rgb = rgb * 2 + 1e-6", "ok", ""),
    "nan-pixels": ("render", "rgb[0, 0] = np.nan", "render", "rgb spans nan to nan; keep it"),
    "another-size": ("render", "rgb = rgb[1:]", "render", r"shape \(47, 72, 3\); the camera asks"),
    "no-rendering": ("render", "return rgb", "render", "render returned ndarray; return a Render"),
}  # fmt: skip

TAG = "GEOEVS_TEST_TAG"


@pytest.fixture(scope="module")
def tried(stage, tmp_path_factory):
    """Tries a method as a run does, and writes its parts; gives outcomes, score and cost rows."""
    root = tmp_path_factory.mktemp("misbehaving")
    run = root / "run"
    answers = stage.linked(run, layout.TARGETS)
    stage.keep(answers.path(layout.TARGETS), "interpolation")
    (root / "methods").mkdir()
    places = list(baselines.__path__)
    baselines.__path__ = [*places, str(root / "methods")]
    os.environ[TAG] = str(root)

    def write(name, place, lines):
        parts = dict.fromkeys(("fit", "render", "save", "load"), "pass") | {place: lines}
        text = TEMPLATE.format(**{k: textwrap.indent(v, " " * 8) for k, v in parts.items()})
        folder = root / "methods" / name.replace("-", "_")
        folder.mkdir()
        (folder / "adapter.py").write_text(text)

    def trial(name, place, lines, limits):
        write(name, place, lines)
        entry = MethodEntry(name)
        model, renders = answers.path(layout.MODEL, label=name), answers.renders(name)
        targets, masks = answers.path(layout.TARGETS), answers.path(layout.MASKS)
        logs = root / f"{name}.fit.log", root / f"{name}.render.log"
        budget = Budget(threads=1)
        fit_method(entry, stage.store.folder, targets, budget, model, logs[0], limits[0])
        render_method(entry, model, targets, masks, renders, logs[1], limit=limits[1])
        opened = Answers(run, **answers.place)
        scores = score_frame(score_method(entry, opened, [1.0], "f"))
        costs = cost_frame(cost_rows(entry, opened))
        for pattern, rows in ((layout.SCORE_PART, scores), (layout.COST_PART, costs)):
            write_parquet(answers.path(pattern, label=name), rows)
        return read_json(renders / "render.json")["front-side"], scores, costs

    trial.root, trial.run = root, run
    yield trial
    baselines.__path__ = places
    del os.environ[TAG]


def survivors(root: Path) -> list[psutil.Process]:
    """Processes that a step started, wherever they are now."""
    found = []
    for process in psutil.process_iter():
        try:
            tagged = process.environ().get(TAG) == str(root)
            mine = process.pid == os.getpid() or process.status() == psutil.STATUS_ZOMBIE
        except psutil.Error:
            continue
        if tagged and not mine:
            found.append(process)
    return found


# A third of them, unless all are asked for: `pytest --hypothesis-profile long` with this file.
EVERY = 1 if settings.get_current_profile_name() == "long" else 3


@pytest.mark.parametrize("name", list(METHODS)[::EVERY])
def test_a_method_that_misbehaves_is_rows_of_its_own(tried, name):
    place, lines, ending, reason = METHODS[name]
    before = psutil.Process().children(recursive=True)
    began = time.monotonic()
    hangs = [reason == HUNG and ending == stage for stage in ("fit", "render")]
    outcome, scores, costs = tried(name, place, lines, [LIMIT if h else USUAL for h in hangs])
    took = time.monotonic() - began
    assert survivors(tried.root) == []
    assert psutil.Process().children(recursive=True) == before
    assert len(scores) > 0
    assert len(costs) == 1
    reasons = {outcome["reason"], *scores["reason"], *costs["reason"]}
    assert all(len(text) < 700 and text.isprintable() for text in reasons)
    assert all(len(note) < 700 and note.isprintable() for note in costs["note"])
    if ending in ("fit", "render"):
        assert (outcome["status"], outcome["stage"]) == ("failed", ending)
        assert re.search(reason, outcome["reason"]), outcome["reason"]
        assert set(scores["status"]) == {"failed"}
        assert costs["fit_seconds"].isna().all() == (ending == "fit")
    elif ending == "ok":
        assert outcome["reason"] == ""
        assert set(scores["status"]) <= {"ok", "unavailable", "empty-mask"}
    file = {"fit": layout.MODEL + "/fit.json"}.get(ending, layout.RENDERS + "/render.json")
    told = read_json(tried.run / file.format(dataset="d", scene="s", label=name))["front-side"]
    assert told["attempt"] == (3 if told["reason"].startswith("machine:") else 0)
    if hangs[0]:  # what hangs while it renders was fitted before, which may take longer
        assert LIMIT <= took < LIMIT + LATE
    for log in tried.root.glob(f"{name}.*.log"):
        assert log.stat().st_size < LOG_BYTES + 100
    assert Path.cwd().is_dir()


def test_everybody_else_has_tables(tried):
    """The parts of all methods so far, and of a good one, are put together."""
    tried("good", "fit", "pass", [USUAL, USUAL])
    for kind in ("scores", "costs"):
        parts = sorted((tried.run / "parts").rglob(f"*.{kind}.parquet"))
        join_parquet(tried.run / f"{kind}.parquet", parts)
        rows = pd.read_parquet(tried.run / f"{kind}.parquet")
        assert set(rows["method"]) == {part.name.split(".")[0] for part in parts}
        good = rows[rows["method"] == "good"]
        assert set(good["status"]) <= {"ok", "unavailable"}
        assert set(good["reason"]) <= {"", *good["reason"][good["status"] == "unavailable"]}
