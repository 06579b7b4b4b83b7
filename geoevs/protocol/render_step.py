"""Rendering a scene's targets with a fitted method, as the isolated process runs it."""

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.images import to_uint8, write_image
from geoevs.core.isolate import begin_part
from geoevs.methods.contract import JointAdapter, MaskedAdapter, Rendering
from geoevs.methods.finding import method_class
from geoevs.methods.returned import checked_rgb, checked_together
from geoevs.protocol.clock import timed
from geoevs.protocol.condition_masks import ConditionMasks
from geoevs.protocol.entries import SPLITS, takes_part
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

    Targets of splits that the method takes no part in are left out, and masked ones where it has no
    condition map to mask. Those of a frame and split are made at once where the method can.

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
    can = {"masked": isinstance(adapter, MaskedAdapter), SPLITS: adapter.info.splits}
    wanted = [target for target in wanted if takes_part(can, target)]
    stored = ConditionMasks(Path(masks))
    keeps = {target.key: stored[target.key].keep for target in wanted if target.masked}

    def render(targets: Sequence[Target]) -> Sequence[Rendering]:
        target, frame = targets[0], targets[0].frame
        if target.masked:
            return [adapter.render_masked(target.camera, frame, keeps[target.key])]
        if isinstance(adapter, JointAdapter):
            cameras = [one.camera for one in targets]
            return checked_together(adapter.render_together(cameras, frame), cameras)
        return [adapter.render(target.camera, frame)]

    groups = _groups(wanted, isinstance(adapter, JointAdapter))
    rendered = render_targets(render, groups, Path(folder), warm_up)
    return {**loaded, **rendered, "clock": clock | rendered["clock"]}


def _groups(targets: Sequence[Target], together: bool) -> list[list[Target]]:
    """Targets that are rendered in one call: each alone, or unmasked ones by frame and split."""
    groups: dict[tuple[Any, ...], list[Target]] = {}
    for target in targets:
        alone = target.masked or not together
        key = (target.key,) if alone else (target.frame, target.split)
        groups.setdefault(key, []).append(target)
    return list(groups.values())


def render_targets(
    render: Callable[[Sequence[Target]], Sequence[Rendering]],
    groups: Sequence[Sequence[Target]],
    folder: Path,
    warm_up: bool = True,
) -> dict[str, Any]:
    """Write what is rendered of targets, and say how long that took.

    Args:
        render: what is timed; from a group to a rendering of each of its targets.
        groups: one at least, of one target at least.
        folder: where `<target key>.png` go.
        warm_up: whether the first group is rendered before.

    Returns:
        `warm_up_seconds`, of the group before, a view (None without), `render_seconds`, the median
        a view, and `clock`, the seconds of the parts that were announced. The views of a group
        share its seconds alike.

    Raises:
        GeoEvsError: a picture has another size, type or range.
    """
    before, clock = None, {}
    if warm_up:
        begin_part("warm-up")
        with timed() as spent:
            render(groups[0])
        before = spent.seconds / len(groups[0])
        clock["warm-up"] = spent.seconds + spent.compiling
    begin_part("views")
    seconds, whole = [], 0.0
    for group in groups:
        with timed() as spent:
            renderings = render(group)
        with timed() as writing:
            for rendering, target in zip(renderings, group, strict=True):
                write_image(folder / f"{target.key}.png", _picture(rendering, target))
        seconds += [spent.seconds / len(group)] * len(group)
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
