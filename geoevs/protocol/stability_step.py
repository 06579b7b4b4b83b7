"""Fitting and rendering a method under many conditions, as one isolated process runs it."""

import shutil
import tempfile
import traceback
from pathlib import Path
from typing import Any

from geoevs.core.errors import reason_of
from geoevs.core.files import write_json
from geoevs.protocol.entries import FINE, failed
from geoevs.protocol.fit_step import fit_step
from geoevs.protocol.render_step import render_step
from geoevs.protocol.stability import OUTCOME_FILE
from geoevs.protocol.targets import ALL_CAMERAS, read_targets, write_targets


def stability_step(
    method: str,
    options: dict[str, Any],
    conditions: list[dict[str, Any]],
    targets: str,
    splits: list[str] | None,
    masks: str,
    folder: str,
    log: str,
) -> None:
    """Fit and render each condition in turn; one that fails says so, and the next one is tried.

    A fit that is not random stands for all draws of its scene.

    Args:
        method: its name.
        options: its own.
        conditions: `key`, `scene` (the store that the method is given) and `seed` of each.
        targets: the scene's target list.
        splits: those to render, or None for all.
        masks: the scene's condition masks.
        folder: where `<key>/<target key>.png` and `<key>/outcome.json` go.
        log: where this process' output goes; outcomes name it.
    """
    with tempfile.TemporaryDirectory() as scratch:
        listed = Path(scratch) / "targets.json"
        every = read_targets(Path(targets))
        write_targets(listed, [t for t in every if splits is None or t.split in splits])
        certain: dict[str, Path] = {}  # by scene: what a fit that is not random has left
        for condition in conditions:
            place = Path(folder) / condition["key"]
            if condition["scene"] in certain:
                shutil.copytree(certain[condition["scene"]], place)
                continue
            place.mkdir()
            outcome = FINE
            stage = "fit"
            try:
                with tempfile.TemporaryDirectory(dir=scratch) as model:
                    budget = {"seconds": None, "threads": 1}
                    arguments = (condition["seed"], ALL_CAMERAS, budget, model)
                    fit = fit_step(condition["scene"], method, options, *arguments)
                    stage = "render"
                    seen = (str(listed), ALL_CAMERAS, model, masks, str(place))
                    render_step(method, *seen, warm_up=False)
                if not fit["random"]:
                    certain[condition["scene"]] = place
            except Exception as error:
                traceback.print_exc()
                outcome = failed(stage, reason_of(error), log)
            write_json(place / OUTCOME_FILE, outcome)
