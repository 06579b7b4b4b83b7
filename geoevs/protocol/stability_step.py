"""Fitting and rendering a method under many stresses, as one isolated process runs it."""

import shutil
import tempfile
import traceback
from pathlib import Path
from typing import Any

from geoevs.core.attempts import attempt_after
from geoevs.core.errors import reason_of
from geoevs.core.files import write_json
from geoevs.core.isolate import MACHINE, begin_part, is_machine_fault
from geoevs.protocol.entries import FINE, SPLITS, failed, read_splits
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
    limits: dict[str, float | None],
    attempt: int,
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
        limits: seconds that each `fit` and each `render` may take; None: as long as they like.
        attempt: the number of this attempt (see `core.attempts`).
    """
    with tempfile.TemporaryDirectory() as scratch:
        target_list = Path(scratch) / "targets.json"
        listed = read_targets(Path(targets))
        wanted = [t for t in listed if splits is None or t.split in splits]
        write_targets(target_list, wanted)
        asked = sorted({target.split for target in wanted})
        certain: dict[str, Path] = {}  # by scene: what a fit that is not random has left
        for stress in stresses:
            place = Path(folder) / stress["key"]
            if stress["scene"] in certain:
                shutil.copytree(certain[stress["scene"]], place)
                continue
            place.mkdir()
            outcome = {**FINE, "attempt": attempt_after(attempt, False)}
            stage = "fit"
            try:
                begin_part(stage, limit=limits[stage])
                with tempfile.TemporaryDirectory(dir=scratch) as model:
                    budget = {"seconds": None, "threads": 1}
                    arguments = (stress["seed"], ALL_CAMERAS, budget, model, asked)
                    fit = fit_step(stress["scene"], method, options, *arguments)
                    if fit:
                        stage = "render"
                        begin_part(stage, limit=limits[stage])
                        views = (str(target_list), ALL_CAMERAS)
                        render_step(method, *views, model, masks, str(place), warm_up=False)
                if not fit.get("random"):
                    certain[stress["scene"]] = place
            except Exception as error:
                traceback.print_exc()
                fault = is_machine_fault(error)
                reason = f"{MACHINE}: {reason_of(error)}" if fault else reason_of(error)
                outcome = failed(stage, reason, log)
                outcome["attempt"] = attempt_after(attempt, fault)
            outcome[SPLITS] = read_splits(Path(scratch))
            write_json(place / OUTCOME_FILE, outcome)
