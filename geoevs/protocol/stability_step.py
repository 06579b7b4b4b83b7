"""Fitting and rendering a method under many stresses, as one isolated process runs it."""

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
    stresses: list[dict[str, Any]],
    targets: str,
    splits: list[str] | None,
    masks: str,
    folder: str,
    log: str,
) -> None:
    """Fit and render under each stress in turn; one that fails says so, and the next one is tried.

    A fit that is not random stands for all draws of its scene.

    Args:
        method: its name.
        options: its own.
        stresses: `key`, `scene` (the store that the method is given) and `seed` of each.
        targets: the scene's target list.
        splits: those to render, or None for all.
        masks: the scene's condition masks.
        folder: where `<key>/<target key>.png` and `<key>/outcome.json` go.
        log: where this process' output goes; outcomes name it.
    """
    with tempfile.TemporaryDirectory() as scratch:
        target_list = Path(scratch) / "targets.json"
        listed = read_targets(Path(targets))
        write_targets(target_list, [t for t in listed if splits is None or t.split in splits])
        certain: dict[str, Path] = {}  # by scene: what a fit that is not random has left
        for stress in stresses:
            place = Path(folder) / stress["key"]
            if stress["scene"] in certain:
                shutil.copytree(certain[stress["scene"]], place)
                continue
            place.mkdir()
            outcome = FINE
            stage = "fit"
            try:
                with tempfile.TemporaryDirectory(dir=scratch) as model:
                    budget = {"seconds": None, "threads": 1}
                    arguments = (stress["seed"], ALL_CAMERAS, budget, model)
                    fit = fit_step(stress["scene"], method, options, *arguments)
                    stage = "render"
                    views = (str(target_list), ALL_CAMERAS)
                    render_step(method, *views, model, masks, str(place), warm_up=False)
                if not fit["random"]:
                    certain[stress["scene"]] = place
            except Exception as error:
                traceback.print_exc()
                outcome = failed(stage, reason_of(error), log)
            write_json(place / OUTCOME_FILE, outcome)
