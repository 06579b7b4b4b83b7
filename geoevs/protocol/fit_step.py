"""Fitting a method to a scene, as the isolated process runs it."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_json
from geoevs.core.isolate import begin_part
from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, MaskedAdapter, Views
from geoevs.methods.finding import make_method
from geoevs.methods.returned import checked_report
from geoevs.methods.trained import UNCOUNTED_FILES
from geoevs.protocol.clock import timed
from geoevs.protocol.entries import SPLITS_FILE
from geoevs.protocol.targets import source_cameras
from geoevs.scenes.store import Scene

WORTH_A_NOTE = 0.1
"""Fewest seconds of compilation that a note mentions."""


def fit_step(
    scene: str,
    method: str,
    options: dict[str, Any],
    seed: int,
    sources: str,
    budget: dict[str, Any],
    folder: str,
    splits: list[str],
) -> dict[str, Any]:
    """Fit a method to the views that a set of sources allows, and save it.

    Where the method takes part comes first, into SPLITS_FILE beside `folder`, so that it is known
    of a fit that fails too. One that takes part in none of `splits` is not fitted. A fit that stops
    with a GeoEvsError, as at a gradient that is not finite, is saved as it was.

    Args:
        scene: the scene store.
        method: its name.
        options: its own.
        seed: the run's seed for this entry.
        sources: which cameras it may see (see `source_cameras`).
        budget: fields of Budget.
        folder: an empty folder for the saved method.
        splits: of the targets that it is fitted for.

    Returns:
        Nothing where the method was not fitted; else fit seconds without those of compilation,
        training seconds, primitives, parameters, bytes on disk, a note, the method's and ours on
        compilation, whether it can be asked for masked views, whether it is random, and `clock`,
        the seconds of the parts that it announced.

    Raises:
        GeoEvsError: the method's report has a number that cannot be, or it left nothing.
    """
    store = Scene(Path(scene))
    adapter = make_method(method, options)
    info = adapter.info
    write_json(Path(folder).parent / SPLITS_FILE, list(info.splits))
    if info.splits and not set(info.splits).intersection(splits):
        return {}
    views = Views(store, source_cameras(store, sources), info.needs, info.sees)
    rng = Rng(seed, store.info.name, method, sources)
    begin_part("fit")
    try:
        with timed() as spent:
            report = adapter.fit(views, Budget(**budget), rng)
    except GeoEvsError:
        # What a fit has stopped at helps to find the cause; the first error is the one to tell.
        with suppress(Exception):
            adapter.save(Path(folder))
        raise
    begin_part("save")
    report = checked_report(report)
    adapter.save(Path(folder))
    if not Path(folder).is_dir():
        raise GeoEvsError("save removed the folder that it was given; write into it")
    notes = [report.note] if report.note else []
    if spent.compiling >= WORTH_A_NOTE:
        notes.append(f"kernels compiled in {spent.compiling:.1f} s, not counted")
    return {
        "fit_seconds": spent.seconds,
        "training_seconds": report.training_seconds,
        "primitives": report.primitives,
        "parameters": report.parameters,
        "bytes": _size(Path(folder)),
        "note": "; ".join(notes),
        "masked": isinstance(adapter, MaskedAdapter),
        "random": rng.used,
        "clock": {"fit": spent.seconds + spent.compiling},
    }


def _size(folder: Path) -> int:
    """Bytes of a saved method; how long its networks were trained differs from run to run."""
    files = (path for path in folder.rglob("*") if path.name not in UNCOUNTED_FILES)
    return sum(path.stat().st_size for path in files if path.is_file())
