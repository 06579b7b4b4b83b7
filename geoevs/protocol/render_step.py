"""Rendering a scene's targets with a fitted method, as the isolated process runs it."""

import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.images import to_uint8, write_image
from geoevs.core.isolate import begin_part
from geoevs.methods.contract import MaskedAdapter, Rendering
from geoevs.methods.finding import method_class
from geoevs.methods.returned import checked_rgb
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
        `load_seconds`, of loading the saved method, and what `render_targets` returns.
    """
    wanted = [target for target in read_targets(Path(targets)) if target.sources == sources]
    kind = method_class(method)
    begin_part("load")
    with timed() as spent:
        adapter = kind.load(Path(model))
    loaded = {"load_seconds": spent.seconds}
    clock = {"load": spent.seconds + spent.compiling}
    if not isinstance(adapter, MaskedAdapter):
        wanted = [target for target in wanted if not target.masked]
    stored = ConditionMasks(Path(masks))
    keeps = {target.key: stored[target.key].keep for target in wanted if target.masked}

    def render(target: Target) -> Rendering:
        if target.masked:
            return adapter.render_masked(target.camera, target.frame, keeps[target.key])
        return adapter.render(target.camera, target.frame)

    rendered = render_targets(render, wanted, Path(folder), warm_up)
    return {**loaded, **rendered, "clock": clock | rendered["clock"]}


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
        `warm_up_seconds`, of the view before (None without), `render_seconds`, the median a view,
        and `clock`, the seconds of the parts that were announced.

    Raises:
        GeoEvsError: a picture has another size, type or range.
    """
    before, clock = None, {}
    if warm_up:
        begin_part("warm-up")
        with timed() as spent:
            render(targets[0])
        before, clock["warm-up"] = spent.seconds, spent.seconds + spent.compiling
    begin_part("views")
    seconds, whole = [], 0.0
    for target in targets:
        with timed() as spent:
            rendering = render(target)
        with timed() as writing:
            write_image(folder / f"{target.key}.png", _picture(rendering, target))
        seconds.append(spent.seconds)
        whole += sum(part.seconds + part.compiling for part in (spent, writing))
    begin_part("end")
    clock["views"] = whole
    return {
        "warm_up_seconds": before,
        "render_seconds": statistics.median(seconds),
        "clock": clock,
    }


def _picture(rendering: Rendering, target: Target) -> np.ndarray:
    try:
        return to_uint8(checked_rgb(rendering, target.camera))
    except GeoEvsError as error:
        raise GeoEvsError(f"target {target.key}: {error}") from None
