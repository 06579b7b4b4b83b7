"""The two steps of a method, as the isolated process runs them: fit a scene, render its targets."""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.adapter import Budget, Rendering, Rng, Views, make_method, method_class
from geoevs.errors import GeoEvsError
from geoevs.io import to_uint8, write_image
from geoevs.protocol.oracle import ReferenceCopy
from geoevs.protocol.targets import Target, read_targets, source_cameras
from geoevs.scenes.store import Scene

REFERENCE = "reference"
"""The control that copies the reference. No adapter can see it, so it is none (see oracle)."""


def fit_step(
    scene: str,
    method: str,
    options: dict[str, Any],
    seed: int,
    sources: str,
    budget: dict[str, Any],
    folder: str,
) -> dict[str, Any]:
    """Fit a method to the views that a set of sources allows, and save it.

    Args:
        scene: the scene store.
        method: its name.
        options: its own.
        seed: the run's seed for this entry.
        sources: which cameras it may see (see `source_cameras`).
        budget: fields of Budget.
        folder: an empty folder for the saved method.

    Returns:
        Fit seconds, primitives, parameters, bytes on disk, and the method's note.
    """
    store = Scene(Path(scene))
    adapter = make_method(method, options)
    views = Views(store, source_cameras(store, sources), adapter.info.needs)
    rng = Rng(seed, store.info.name, method, sources)
    start = time.perf_counter()
    report = adapter.fit(views, Budget(**budget), rng)
    _synchronise()
    seconds = time.perf_counter() - start
    adapter.save(Path(folder))
    size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    return {
        "fit_seconds": seconds,
        "primitives": report.primitives,
        "parameters": report.parameters,
        "bytes": size,
        "note": report.note,
    }


def render_step(
    method: str, targets: str, sources: str, model: str, evidence: dict[str, str], folder: str
) -> dict[str, Any]:
    """Render every target of a set of sources with a saved method.

    Args:
        method: its name.
        targets: the scene's target list.
        sources: the set of sources whose targets to render.
        model: the saved method; unused by the reference control.
        evidence: paths of the scene, references and truth; for the reference control alone.
        folder: where `<target key>.png` go.

    Returns:
        The median seconds per view, after one render that warms up.
    """
    wanted = [target for target in read_targets(Path(targets)) if target.sources == sources]
    render: Callable[[Target], Rendering]
    if method == REFERENCE:
        render = ReferenceCopy(**evidence).render
    else:
        adapter = method_class(method).load(Path(model))

        def render(target: Target) -> Rendering:
            return adapter.render(target.camera, target.frame)

    render(wanted[0])
    seconds = []
    for target in wanted:
        _synchronise()
        start = time.perf_counter()
        rendering = render(target)
        _synchronise()
        seconds.append(time.perf_counter() - start)
        write_image(Path(folder) / f"{target.key}.png", _checked(rendering, target))
    return {"render_seconds": statistics.median(seconds)}


def _checked(rendering: Rendering, target: Target) -> np.ndarray:
    rgb = np.asarray(rendering.rgb)
    expected = (target.camera.height, target.camera.width, 3)
    if rgb.shape != expected:
        raise GeoEvsError(f"target {target.key} was rendered as {rgb.shape}, not {expected}")
    if not np.isfinite(rgb).all():
        raise GeoEvsError(f"target {target.key} was rendered with NaN or infinite pixels")
    return to_uint8(rgb)


def _synchronise() -> None:
    """Wait for the GPU, where a method has started one, so that the clock sees its work."""
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        torch.cuda.synchronize()
