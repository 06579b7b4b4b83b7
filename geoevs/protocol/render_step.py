"""Rendering a scene's targets with a fitted method, as the isolated process runs it."""

import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import to_uint8, write_image
from geoevs.methods.contract import MaskedAdapter, Rendering
from geoevs.methods.finding import method_class
from geoevs.protocol.clock import timed
from geoevs.protocol.condition_masks import ConditionMasks
from geoevs.protocol.targets import Target, read_targets


def render_step(
    method: str,
    targets: str,
    sources: str,
    model: str,
    masks: str,
    folder: str,
    warm_up: bool = True,
) -> dict[str, Any]:
    """Render every target of a set of sources with a saved method.

    Masked targets are left out where the method has no condition map to mask.

    Args:
        method: its name.
        targets: the scene's target list.
        sources: the set of sources whose targets to render.
        model: the saved method.
        masks: the scene's condition masks.
        folder: where `<target key>.png` go.
        warm_up: whether one view is rendered before, which only seconds need.

    Returns:
        The median seconds per view.
    """
    wanted = [target for target in read_targets(Path(targets)) if target.sources == sources]
    adapter = method_class(method).load(Path(model))
    if not isinstance(adapter, MaskedAdapter):
        wanted = [target for target in wanted if not target.masked]
    stored = ConditionMasks(Path(masks))
    keeps = {target.key: stored[target.key].keep for target in wanted if target.masked}

    def render(target: Target) -> Rendering:
        if target.masked:
            return adapter.render_masked(target.camera, target.frame, keeps[target.key])
        return adapter.render(target.camera, target.frame)

    return render_targets(render, wanted, Path(folder), warm_up)


def render_targets(
    render: Callable[[Target], Rendering], targets: list[Target], folder: Path, warm_up: bool = True
) -> dict[str, Any]:
    """Write what is rendered of targets, and say how long that took.

    Args:
        render: what is timed.
        targets: one at least.
        folder: where `<target key>.png` go.
        warm_up: whether one view is rendered before.

    Returns:
        `render_seconds`, the median a view.

    Raises:
        GeoEvsError: a picture has another size or type, or pixels that are not finite.
    """
    if warm_up:
        render(targets[0])
    seconds = []
    for target in targets:
        with timed() as spent:
            rendering = render(target)
        seconds.append(spent.seconds)
        write_image(folder / f"{target.key}.png", _checked(rendering, target))
    return {"render_seconds": statistics.median(seconds)}


def _checked(rendering: Rendering, target: Target) -> np.ndarray:
    rgb = np.asarray(rendering.rgb)
    expected = (target.camera.height, target.camera.width, 3)
    if rgb.shape != expected:
        raise GeoEvsError(f"target {target.key} was rendered as {rgb.shape}, not {expected}")
    if rgb.dtype != np.uint8 and not np.issubdtype(rgb.dtype, np.floating):
        raise GeoEvsError(
            f"target {target.key} was rendered as {rgb.dtype}; give uint8, or floats in [0, 1]"
        )
    if not np.isfinite(rgb).all():
        raise GeoEvsError(f"target {target.key} was rendered with NaN or infinite pixels")
    return to_uint8(rgb)
