"""Fitting and rendering one method on one scene: isolated, timed, and never in the run's way.

A fit leaves `<folder>/<sources>/model/` and `<folder>/fit.json`; a render leaves
`<folder>/<target key>.png` and `<folder>/render.json`. Both files say, for each set of sources,
what it cost or at which stage and why it failed.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from geoevs.core.files import new_folder, write_json
from geoevs.methods.contract import Budget
from geoevs.protocol.entries import FAILED, FINE, ORACLES, MethodEntry, failed, read_outcomes
from geoevs.protocol.isolate import MethodFailedError, Usage, run_isolated
from geoevs.protocol.targets import read_targets


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
            outcome = _attempt("fit", arguments, budget.threads, log)
            if outcome["status"] == FAILED and any(model.iterdir()):
                outcome["reason"] += f"; what it saved is in {folder / sources / 'model'}"
            outcomes[sources] = outcome
        write_json(partial / "fit.json", outcomes)


def render_method(
    entry: MethodEntry,
    model: Path,
    targets: Path,
    masks: Path,
    evidence: dict[str, str],
    folder: Path,
    log: Path,
) -> None:
    """Render all targets with a fitted method; a set of sources whose fit failed stays failed."""
    log.unlink(missing_ok=True)
    fits = read_outcomes(model / "fit.json")
    with new_folder(folder) as partial:
        outcomes = {}
        for sources, fit in fits.items():
            if fit["status"] == FAILED:
                outcomes[sources] = fit
                continue
            arguments = {
                "method": entry.method,
                "targets": str(targets),
                "sources": sources,
                "model": str(model / sources / "model"),
                "masks": str(masks),
                "evidence": evidence,
                "folder": str(partial),
            }
            rendered = _attempt("render", arguments, fit["threads"], log)
            peak = {name: max(fit[name], rendered[name]) for name in ("peak_memory", "gpu_memory")}
            outcomes[sources] = {**fit, **rendered, **peak}
        write_json(partial / "render.json", outcomes)


def _attempt(stage: str, arguments: dict[str, Any], threads: int, log: Path) -> dict[str, Any]:
    try:
        step = f"geoevs.protocol.{stage}_step:{stage}_step"
        result, usage = run_isolated(step, arguments, threads, log)
    except MethodFailedError as failure:
        return {**failed(stage, str(failure), log), "threads": threads, **asdict(Usage(0, 0))}
    return _succeeded(result, usage, threads)


def _succeeded(result: dict[str, Any], usage: Usage, threads: int) -> dict[str, Any]:
    return {**FINE, "threads": threads, **asdict(usage), **result}


def _source_sets(targets: Path) -> list[str]:
    return sorted({target.sources for target in read_targets(targets)})
