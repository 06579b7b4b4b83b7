"""The steps of any method's training: prepare each scene, combine what was prepared, train."""

import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.files import link_file, new_folder, write_json
from geoevs.core.settings import make_settings
from geoevs.methods.finding import training_class
from geoevs.methods.trained import FAILURE_FILE, GEOMETRY_FILE, seconds_file, trained_seconds
from geoevs.methods.training import CombinedTraining, Inputs
from geoevs.scenes.store import Scene


def prepare_scene(method: str, scene: Path, inputs: Inputs, out: Path) -> None:
    """Write what a method's training learns from one scene.

    Args:
        method: its name.
        scene: the scene store.
        inputs: what the training reads beside it.
        out: the file to write.

    Raises:
        GeoEvsError: the method does not train, or an input is missing.
    """
    training = training_class(method)()
    training.prepare(Scene(scene), inputs, out)


def combine_files(method: str, files: Sequence[Path], out: Path) -> None:
    """Write what a method's training makes of all prepared files together.

    Raises:
        GeoEvsError: the method does not train, or its training combines nothing.
    """
    training = training_class(method)()
    if not isinstance(training, CombinedTraining):
        raise GeoEvsError(f"the training of '{method}' has no 'combine'; leave this step out")
    training.combine(files, out)


def train_method(
    method: str,
    values: Mapping[str, Any],
    files: Sequence[Path],
    inputs: Inputs,
    seed: int,
    work: Path,
    out: Path,
) -> None:
    """Train a method's networks into a folder.

    A failure is written down, not raised: entrants that take these weights fail with its reason,
    and the others go on.

    Args:
        method: its name.
        values: of its Settings, where they are not the defaults.
        files: what `prepare_scene` wrote.
        inputs: what the training reads beside them.
        seed: of the training.
        work: the training's own folder, which outlives a kill.
        out: the folder to write.

    Raises:
        GeoEvsError: the method does not train, a setting is wrong, or the depth network's weights
            are missing: nobody's networks could be trained so.
    """
    training = training_class(method)()
    settings = make_settings(f"the training of '{method}'", training.Settings, values)
    geometry = inputs.geometry_weights
    if geometry is not None and not geometry.is_file():
        raise GeoEvsError(f"{geometry} is missing; make or copy it there")
    began = time.monotonic()
    try:
        with new_folder(out) as partial:
            training.train(settings, files, inputs, seed, work, partial)
            seconds = {"training": _seconds(work, began)}
            if geometry is not None:
                link_file(geometry, partial / GEOMETRY_FILE)
                seconds["geometry"] = trained_seconds(geometry) or 0.0
            write_json(seconds_file(partial), seconds)
    except Exception as error:  # a method's training may raise anything
        if not isinstance(error, GeoEvsError):
            traceback.print_exc()
        print(f"error: {reason_of(error)}", file=sys.stderr)
        with new_folder(out) as partial:
            write_json(partial / FAILURE_FILE, {"reason": reason_of(error)})
        return
    _forget(work)


def _seconds(work: Path, began: float) -> float:
    """Wall seconds of a training, those of killed parts among them where its loop counts them."""
    if "torch" in sys.modules:
        from geoevs.core.optimising import STATE, training_seconds

        if (work / STATE).exists():
            return training_seconds(work)
    return time.monotonic() - began


def _forget(work: Path) -> None:
    if "torch" in sys.modules:
        from geoevs.core.optimising import finish

        finish(work)
