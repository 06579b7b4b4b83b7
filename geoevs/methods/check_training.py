"""The training contract as named checks, run on a tiny scene in a folder of their own."""

import dataclasses
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from geoevs.core.code_hash import PACKAGES
from geoevs.core.settings import SettingError, make_settings
from geoevs.methods.check import LIMIT
from geoevs.methods.finding import find_methods, find_trainings, training_class
from geoevs.methods.tiny import write_tiny_scene
from geoevs.methods.trained import FAILURE_FILE, SECONDS_FILE
from geoevs.methods.training import CombinedTraining, Inputs
from geoevs.methods.training_steps import combine_files, failure_of, prepare_scene
from geoevs.methods.trial import BrokenContractError, Check, run_check
from geoevs.scenes.store import Scene

STEPS = 8
"""Steps of the trainings that are compared, where Settings has `steps`."""

TRAIN = """
import dataclasses, importlib, json, sys
from pathlib import Path
arguments = json.load(sys.stdin)
for package, folders in arguments.pop("packages").items():
    importlib.import_module(package).__path__ = folders
from geoevs.methods.training import Inputs
from geoevs.methods.training_steps import train_method
paths = ("combined", "weights")
inputs = {k: Path(v) if v and k in paths else v for k, v in arguments.pop("inputs").items()}
files = [Path(file) for file in arguments.pop("files")]
work, out = (Path(arguments.pop(name)) for name in ("work", "out"))
train_method(**arguments, files=files, inputs=Inputs(**inputs), seed=0, work=work, out=out)
"""
IMPORT = """
import importlib, json, sys
arguments = json.load(sys.stdin)
for package, folders in arguments["packages"].items():
    importlib.import_module(package).__path__ = folders
sys.modules["torch"] = None
importlib.import_module(arguments["module"])
"""


class TrainingTrial:
    """One method's training on the tiny scene, with what the checks learn of it on their way."""

    def __init__(
        self,
        name: str,
        values: Mapping[str, Any],
        folder: Path,
        make_inputs: Callable[[Scene, Path], Inputs],
    ) -> None:
        self.name, self.folder = name, folder
        self.scene = write_tiny_scene(folder / "scene")
        self.inputs = make_inputs(self.scene, folder)
        kind = training_class(name)
        self.training = kind()
        names = {field.name for field in dataclasses.fields(kind.Settings)}
        few = {"steps": STEPS} if "steps" in names else {}
        self.values = few | dict(values)
        make_settings(f"the training of '{name}'", kind.Settings, self.values)
        self.files: list[Path] = []

    def start(self, place: str) -> subprocess.Popen[str]:
        """Train in a process of its own, into folders called `place`."""
        inputs = {
            "geometry": self.inputs.geometry,
            "weights": str(self.inputs.weights),
            "combined": None if self.inputs.combined is None else str(self.inputs.combined),
        }
        arguments = {
            "method": self.name,
            "values": self.values,
            "files": list(map(str, self.files)),
            "inputs": inputs,
            "work": str(self.folder / "work" / place),
            "out": str(self.folder / "out" / place),
        }
        return _start(TRAIN, arguments)


def check_training(
    name: str,
    values: Mapping[str, Any],
    make_inputs: Callable[[Scene, Path], Inputs],
    weights: Path,
) -> list[Check]:
    """Run every check on the training of the method called `name`.

    Args:
        name: the method's.
        values: settings that are not its defaults, such as fewer steps.
        make_inputs: gives what a training may read, of the tiny scene.
        weights: where the folder of a training that ended well is kept.

    Raises:
        GeoEvsError: the method does not train, or a setting is wrong.
    """
    with tempfile.TemporaryDirectory() as temporary:
        trial = TrainingTrial(name, values, Path(temporary), make_inputs)
        checks: list[Check] = []
        for title, check in TRAINING_CHECKS.items():
            failed = [done.name for done in checks if done.status == "failed"]
            skipped = Check(title, "skipped", f"{failed[0]} failed") if failed else None
            checks.append(skipped or run_check(title, check, trial))
        trained = trial.folder / "out/whole"
        if trained.is_dir() and not (trained / FAILURE_FILE).exists():
            shutil.copytree(trained, weights)
        return checks


def check_imports_no_torch(name: str) -> Check:
    """Check that a method's adapter and training can be read where torch is not."""
    title = "reads without torch"
    for module in (find_methods()[name], find_trainings().get(name, "")):
        if not module:
            continue
        process = _start(IMPORT, {"module": module})
        _, errors = process.communicate()
        if process.returncode and "torch" in errors:
            return Check(
                title,
                "failed",
                f"{module} imports torch when it is read, as every config check does; import it in "
                "the functions that need it, and put networks into another module",
                errors,
            )
    return Check(title, "passed")


def _check_settings(trial: TrainingTrial) -> None:
    kind = trial.training.Settings
    for wrong in ({"no-such-setting": 1}, {dataclasses.fields(kind)[0].name: object()}):
        try:
            make_settings(trial.name, kind, wrong)
        except SettingError:
            continue
        (setting,) = wrong
        raise BrokenContractError(
            f"Settings takes anything for '{setting}'; give the field a type that can be checked"
        )


def _check_prepare(trial: TrainingTrial) -> None:
    first, again = (trial.folder / f"prepared-{n}.npz" for n in (1, 2))
    for out in (first, again):
        prepare_scene(trial.name, trial.scene.folder, trial.inputs, out, LIMIT)
        if reason := failure_of(out):
            raise BrokenContractError(reason)
    if first.read_bytes() != again.read_bytes():
        raise BrokenContractError(
            "prepare wrote other bytes the second time; it has no randomness, and write_arrays "
            "writes no dates"
        )
    trial.files = [first]


def _check_combine(trial: TrainingTrial) -> None:
    if not isinstance(trial.training, CombinedTraining):
        return
    combined = trial.folder / "combined.npz"
    combine_files(trial.name, trial.files, combined, LIMIT)
    if reason := failure_of(combined):
        raise BrokenContractError(reason)
    trial.inputs = dataclasses.replace(trial.inputs, combined=combined)


def _check_train(trial: TrainingTrial) -> None:
    _finish(trial.start("whole"))
    out = trial.folder / "out/whole"
    failure = out / FAILURE_FILE
    if failure.exists():
        raise BrokenContractError(json.loads(failure.read_text(encoding="utf-8"))["reason"])
    if not _contents(out):
        raise BrokenContractError("train wrote nothing into its folder; write the weights there")


def _check_resume(trial: TrainingTrial) -> str | None:
    process = trial.start("killed")
    work = trial.folder / "work/killed"
    while process.poll() is None and not (work.is_dir() and any(work.iterdir())):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    ended = process.returncode == 0
    _finish(trial.start("killed"))
    whole, resumed = (_contents(trial.folder / "out" / name) for name in ("whole", "killed"))
    different = sorted(n for n in whole | resumed if whole.get(n) != resumed.get(n))
    if different:
        raise BrokenContractError(
            f"a training that was killed went on to another {different[0]}; take all randomness "
            "from the seed and the step, and keep what a step depends on in `work`"
        )
    return "it ended before it could be killed; give it more steps" if ended else None


def _contents(folder: Path) -> dict[str, bytes]:
    """The files of a finished training, but for how long it took."""
    files = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    files.pop(SECONDS_FILE, None)
    return files


def _start(code: str, arguments: Mapping[str, Any]) -> subprocess.Popen[str]:
    packages = {name: list(sys.modules[name].__path__) for name in PACKAGES if name in sys.modules}
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    process.stdin.write(json.dumps({"packages": packages, **arguments}))
    process.stdin.close()
    process.stdin = None
    return process


def _finish(process: subprocess.Popen[str]) -> None:
    _, errors = process.communicate()
    if process.returncode:
        last = errors.strip().splitlines()[-1:] or [f"exit code {process.returncode}"]
        raise BrokenContractError(f"training ended with {last[0]}")


TRAINING_CHECKS: dict[str, Callable[[TrainingTrial], str | None]] = {
    "training's settings": _check_settings,
    "prepare": _check_prepare,
    "combine": _check_combine,
    "train": _check_train,
    "train after a kill": _check_resume,
}
