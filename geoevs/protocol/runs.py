"""Fitting and rendering one method on one scene: isolated, timed, and never in the run's way.

A fit leaves `<folder>/<sources>/model/` and `<folder>/fit.json`; a render leaves
`<folder>/<target key>.png` and `<folder>/render.json`. Both files say, for each set of sources,
what it cost or at which stage and why it failed.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from geoevs.core.files import new_folder, write_json
from geoevs.methods.contract import ORACLES, Budget
from geoevs.protocol.entries import FAILED, FINE, MethodEntry, failed, read_outcomes
from geoevs.core.isolate import MethodFailedError, Usage, run_isolated
from geoevs.protocol.targets import read_targets

# Named, not imported: no step's code counts for the others when the workflow hashes it.
FIT_STEP = "geoevs.protocol.fit_step:fit_step"
RENDER_STEP = "geoevs.protocol.render_step:render_step"
ORACLE_STEP = "geoevs.protocol.oracle:oracle_step"


def fit_method(
    entry: MethodEntry, scene: Path, targets: Path, budget: Budget, folder: Path, log: Path
) -> None:
    """Fit a method once for every set of sources that the targets use, and record the outcome."""
    log.unlink(missing_ok=True)
    with new_folder(folder) as partial:
        outcomes = {}
        for sources in _source_sets(targets):
            model = partial / sources / "model"
            model.mkdir(parents=True)
            if entry.method in ORACLES:
                nothing = {"fit_seconds": 0.0, "bytes": 0, "masked": True}
                outcomes[sources] = _succeeded(nothing, Usage(0, 0), budget.threads)
                continue
            arguments = {
                "scene": str(scene),
                "method": entry.method,
                "options": entry.options,
                "seed": entry.seed,
                "sources": sources,
                "budget": asdict(budget),
                "folder": str(model),
            }
            outcome = _attempt("fit", FIT_STEP, arguments, budget.threads, log)
            if outcome["status"] == FAILED and any(model.iterdir()):
                outcome["reason"] += f"; what it saved is in {folder / sources / 'model'}"
            outcomes[sources] = outcome
        write_json(partial / "fit.json", outcomes)


def render_method(
    entry: MethodEntry,
    model: Path,
    targets: Path,
    masks: Path,
    folder: Path,
    log: Path,
    answers: dict[str, str] | None = None,
) -> None:
    """Render all targets with a fitted method; a set of sources whose fit failed stays failed.

    Args:
        entry: the method, or one of ORACLES.
        model: what `fit_method` left.
        targets: the scene's target list.
        masks: the scene's condition masks.
        folder: what to write, whole or not at all.
        log: where the method's own output goes.
        answers: `run`, `dataset` and `scene` of its Answers, which oracles alone are told.
    """
    log.unlink(missing_ok=True)
    fits = read_outcomes(model / "fit.json")
    with new_folder(folder) as partial:
        outcomes = {}
        for sources, fit in fits.items():
            if fit["status"] == FAILED:
                outcomes[sources] = fit
                continue
            step, read = RENDER_STEP, {"targets": str(targets), "masks": str(masks)}
            read["model"] = str(model / sources / "model")
            if entry.method in ORACLES:
                step, read = ORACLE_STEP, answers
            arguments = {"method": entry.method, "sources": sources, "folder": str(partial), **read}
            rendered = _attempt("render", step, arguments, fit["threads"], log)
            peak = {name: max(fit[name], rendered[name]) for name in ("peak_memory", "gpu_memory")}
            outcomes[sources] = {**fit, **rendered, **peak}
        write_json(partial / "render.json", outcomes)


def _attempt(
    stage: str, step: str, arguments: dict[str, Any], threads: int, log: Path
) -> dict[str, Any]:
    try:
        result, usage = run_isolated(step, arguments, threads, log)
    except MethodFailedError as failure:
        return {**failed(stage, str(failure), log), "threads": threads, **asdict(Usage(0, 0))}
    return _succeeded(result, usage, threads)


def _succeeded(result: dict[str, Any], usage: Usage, threads: int) -> dict[str, Any]:
    return {**FINE, "threads": threads, **asdict(usage), **result}


def _source_sets(targets: Path) -> list[str]:
    return sorted({target.sources for target in read_targets(targets)})
