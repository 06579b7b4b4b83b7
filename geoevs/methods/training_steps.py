"""The steps of any method's training: prepare each scene, combine what was prepared, train.

Each runs isolated, as fits do. What fails is written down in place of what should have been made,
so that the entrants that take these weights fail with its reason, and all others go on.
"""

import dataclasses
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geoevs.core.attempts import attempt_after, attempt_file
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import link_file, new_folder, write_json
from geoevs.core.isolate import (
    MACHINE,
    MethodFailedError,
    absolute_paths,
    lent_folder,
    run_isolated,
)
from geoevs.core.settings import make_settings
from geoevs.methods.finding import training_class
from geoevs.methods.trained import (
    ATTEMPT_FILE,
    FAILURE_FILE,
    GEOMETRY_FILE,
    seconds_file,
    trained_seconds,
)
from geoevs.methods.training import CombinedTraining, Inputs
from geoevs.scenes.store import Scene

# Named, not imported, as an isolated process finds them.
PREPARE_STEP = f"{__name__}:prepare_step"
COMBINE_STEP = f"{__name__}:combine_step"
TRAIN_STEP = f"{__name__}:train_step"

FAILURE_START = b'{\n "failure": '
"""How a file begins that says why a scene could not be prepared; no prepared one does."""


def prepare_scene(
    method: str,
    scene: Path,
    inputs: Inputs,
    out: Path,
    limit: float | None = None,
    attempt: int = 0,
) -> None:
    """Write what a method's training learns from one scene; or why it could not, in its place.

    Args:
        method: its name.
        scene: the scene store.
        inputs: what the training reads beside it.
        out: the file to write.
        limit: seconds after which it is ended; None: never.
        attempt: the number of this attempt (see `core.attempts`).

    Raises:
        GeoEvsError: the method does not train.
    """
    training_class(method)
    arguments = {"method": method, "scene": str(scene.absolute()), "inputs": _described(inputs)}
    _make_file(PREPARE_STEP, arguments, out, f"preparing {scene.name}", limit, attempt)


def combine_files(
    method: str,
    files: Sequence[Path],
    out: Path,
    limit: float | None = None,
    attempt: int = 0,
) -> None:
    """Write what a method's training makes of all prepared files; or why it could not.

    Raises:
        GeoEvsError: the method does not train, or its training combines nothing.
    """
    if not isinstance(training_class(method)(), CombinedTraining):
        raise GeoEvsError(f"the training of '{method}' has no 'combine'; leave this step out")
    try:
        _refuse_failures(files)
    except MethodFailedError as failure:
        _write_failure(out, str(failure), attempt_after(attempt, False))
        return
    arguments = {"method": method, "files": _absolute(files)}
    _make_file(COMBINE_STEP, arguments, out, "combining", limit, attempt)


def train_method(
    method: str,
    values: Mapping[str, Any],
    files: Sequence[Path],
    inputs: Inputs,
    seed: int,
    work: Path,
    out: Path,
    limit: float | None = None,
    attempt: int = 0,
) -> None:
    """Train a method's networks into a folder.

    A failure is written down, not raised: entrants that take these weights fail with its reason,
    and the others go on. A training that was ended at its limit goes on from its work folder, when
    it is given more time.

    Args:
        method: its name.
        values: of its Settings, where they are not the defaults.
        files: what `prepare_scene` wrote.
        inputs: what the training reads beside them.
        seed: of the training.
        work: the training's own folder, which outlives a kill.
        out: the folder to write.
        limit: seconds after which it is ended; None: never.
        attempt: the number of this attempt (see `core.attempts`).

    Raises:
        GeoEvsError: the method does not train, a setting is wrong, or the depth network's weights
            are missing: nobody's networks could be trained so.
    """
    training = training_class(method)()
    make_settings(f"the training of '{method}'", training.Settings, values)
    geometry = inputs.geometry_weights
    if geometry is not None and not geometry.is_file():
        raise GeoEvsError(f"{geometry} is missing; make or copy it there")
    arguments = {
        "method": method,
        "values": absolute_paths(values),
        "files": _absolute(files),
        "inputs": _described(inputs),
        "seed": seed,
        "work": str(work.absolute()),
    }
    try:
        _refuse_failures([*files, *([inputs.combined] if inputs.combined else [])])
        with lent_folder(out) as partial:
            told, _ = run_isolated(
                TRAIN_STEP, {**arguments, "out": str(partial.absolute())}, None, None, limit
            )
            seconds = {"training": float(told["seconds"])}
            if geometry is not None:
                link_file(geometry, partial / GEOMETRY_FILE)
                seconds["geometry"] = trained_seconds(geometry) or 0.0
            write_json(seconds_file(partial), seconds)
            if attempt:
                write_json(partial / ATTEMPT_FILE, {"attempt": attempt_after(attempt, False)})
    except MethodFailedError as failure:
        print(f"error: {failure}", file=sys.stderr)
        outcome: dict[str, Any] = {"reason": str(failure), "stage": "training"}
        outcome["attempt"] = attempt_after(attempt, failure.kind == MACHINE)
        if failure.limit is not None:
            outcome["limit"] = failure.limit
        with new_folder(out) as partial:
            write_json(partial / FAILURE_FILE, outcome)
        return
    if told["state"]:  # changed code must not find it
        (work / Path(told["state"]).name).unlink(missing_ok=True)


def _make_file(
    step: str,
    arguments: Mapping[str, Any],
    out: Path,
    doing: str,
    limit: float | None,
    attempt: int,
) -> None:
    """Have an isolated step write a file, or write down why it could not."""
    out.parent.mkdir(parents=True, exist_ok=True)
    for file in (out, attempt_file(out)):
        file.unlink(missing_ok=True)
    try:
        run_isolated(step, {**arguments, "out": str(out.absolute())}, None, None, limit)
        if out.is_symlink() or not out.is_file():
            raise MethodFailedError("it wrote no file; write the path that it is given")
        if reason := failure_of(out):
            raise MethodFailedError(reason)
        if attempt:
            write_json(attempt_file(out), {"attempt": attempt_after(attempt, False)})
    except MethodFailedError as failure:
        print(f"error: {doing}: {failure}", file=sys.stderr)
        again = attempt_after(attempt, failure.kind == MACHINE)
        limited = {} if failure.limit is None else {"limit": failure.limit}
        _write_failure(out, f"{failure} (while {doing})", again, **limited)


def _write_failure(out: Path, reason: str, attempt: int, **limit: float) -> None:
    write_json(out, {"failure": reason, "stage": "training", "attempt": attempt, **limit})


def failure_of(file: Path) -> str:
    """Why a file that `prepare_scene` or `combine_files` wrote could not be made; empty if it was.

    Raises:
        GeoEvsError: the file is missing.
    """
    try:
        with file.open("rb") as opened:
            if opened.read(len(FAILURE_START)) != FAILURE_START:
                return ""
            opened.seek(0)
            return str(json.loads(opened.read(100_000))["failure"])
    except FileNotFoundError as error:
        raise GeoEvsError(f"{file} is missing; make or copy it there") from error
    except (KeyError, ValueError):
        return ""


def _refuse_failures(files: Sequence[Path]) -> None:
    for file in files:
        if reason := failure_of(file):
            raise MethodFailedError(reason)


def _absolute(files: Sequence[Path]) -> list[str]:
    return [str(file.absolute()) for file in files]


def _described(inputs: Inputs) -> dict[str, Any]:
    """Inputs as JSON has them; paths are absolute."""
    values = vars(inputs).items()
    return {k: str(v.absolute()) if isinstance(v, Path) else v for k, v in values}


def _inputs(described: Mapping[str, Any]) -> Inputs:
    paths = {field.name for field in dataclasses.fields(Inputs) if "Path" in str(field.type)}
    given: dict[str, Any] = {k: Path(v) if v and k in paths else v for k, v in described.items()}
    return Inputs(**given)


def prepare_step(method: str, scene: str, inputs: Mapping[str, Any], out: str) -> None:
    """Prepare one scene, as the isolated process does it."""
    training_class(method)().prepare(Scene(Path(scene)), _inputs(inputs), Path(out))


def combine_step(method: str, files: Sequence[str], out: str) -> None:
    """Combine prepared files, as the isolated process does it."""
    training = training_class(method)()
    assert isinstance(training, CombinedTraining)
    training.combine([Path(file) for file in files], Path(out))


def train_step(
    method: str,
    values: Mapping[str, Any],
    files: Sequence[str],
    inputs: Mapping[str, Any],
    seed: int,
    work: str,
    out: str,
) -> dict[str, Any]:
    """Train, as the isolated process does it.

    Returns:
        `seconds` of wall time, those of killed parts among them where its loop counts them, and the
        name of its `state` in the work folder, if its loop keeps one.
    """
    training = training_class(method)()
    settings = make_settings(f"the training of '{method}'", training.Settings, values)
    began = time.monotonic()
    paths = [Path(file) for file in files]
    training.train(settings, paths, _inputs(inputs), seed, Path(work), Path(out))
    seconds, state = time.monotonic() - began, ""
    if "torch" in sys.modules:
        from geoevs.core.optimising import STATE, training_seconds

        if (Path(work) / STATE).exists():
            seconds, state = training_seconds(Path(work)), STATE
    return {"seconds": seconds, "state": state}
