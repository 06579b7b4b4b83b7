"""Fitting and rendering one method on one scene: isolated, timed, and never in the run's way.

A fit leaves `<folder>/<sources>/model/` and `<folder>/fit.json`; a render leaves
`<folder>/<target key>.png` and `<folder>/render.json`. Both files say, for each set of sources,
what it cost or at which stage and why it failed.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from geoevs.core.attempts import attempt_after
from geoevs.core.files import new_folder, write_json
from geoevs.core.hashes import file_hash
from geoevs.core.isolate import (
    MACHINE,
    MethodFailedError,
    Usage,
    absolute_paths,
    lent_folder,
    run_isolated,
)
from geoevs.core.machine import machine
from geoevs.core.stamps import MADE_WITH, settings_hash
from geoevs.core.text import clean
from geoevs.methods.contract import ORACLES, Budget
from geoevs.protocol.entries import (
    FAILED,
    FINE,
    SPLITS,
    MethodEntry,
    failed,
    read_outcomes,
    read_splits,
    takes_part,
)
from geoevs.protocol.pictures import PICTURES, seal_pictures
from geoevs.protocol.rows import COST_TYPES
from geoevs.protocol.targets import read_targets
from geoevs.scenes.store import Scene

# Named, not imported: no step's code counts for the others when the workflow hashes it.
FIT_STEP = "geoevs.protocol.fit_step:fit_step"
RENDER_STEP = "geoevs.protocol.render_step:render_step"
ORACLE_STEP = "geoevs.protocol.oracle:oracle_step"

CLOCK_SECONDS, CLOCK_SHARE = 2.0, 0.1
"""How far the seconds that a step's process tells may be off the runner's clock."""


def fit_method(
    entry: MethodEntry,
    scene: Path,
    targets: Path,
    budget: Budget,
    folder: Path,
    log: Path,
    limit: float | None = None,
    attempt: int = 0,
) -> None:
    """Fit a method once for every set of sources that the targets use, and record the outcome.

    Sets whose targets are all of splits that the method takes no part in are left out.

    Args:
        entry: the method, or one of ORACLES.
        scene: the scene store.
        targets: the scene's target list.
        budget: what the fit is asked to keep to.
        folder: what to write, whole or not at all.
        log: where the method's own output goes.
        limit: seconds after which a fit is ended; None: never.
        attempt: the number of this attempt (see `core.attempts`).

    Raises:
        GeoEvsError: the target list is damaged, or the folder cannot be written.
    """
    log.unlink(missing_ok=True)
    made_with = {"scene": Scene(scene).stamp, "settings": fit_settings(entry)}
    outcomes: dict[str, dict[str, Any]] = {}
    with _folder_of("fit", folder, outcomes, log) as partial:
        for sources, splits in _source_sets(targets).items():
            model = partial / sources / "model"
            model.mkdir(parents=True)
            if entry.method in ORACLES:
                nothing = {"fit_seconds": 0.0, "bytes": 0, "masked": True}
                done = _done(budget.threads, attempt_after(attempt, False), Usage(0, 0))
                outcomes[sources] = {**FINE, **done, **nothing}
                continue
            arguments = {
                "scene": str(scene.absolute()),
                "method": entry.method,
                "options": absolute_paths(entry.options),
                "seed": entry.seed,
                "sources": sources,
                "budget": asdict(budget),
                "folder": str(model.absolute()),
                "splits": splits,
            }
            outcome = _attempt("fit", FIT_STEP, arguments, budget.threads, log, limit, attempt)
            if outcome["status"] == FAILED and model.is_dir() and any(model.iterdir()):
                outcome["reason"] += f"; what it saved is in {folder / sources / 'model'}"
            outcomes[sources] = {**outcome, SPLITS: read_splits(model.parent)}
        for sources, outcome in outcomes.items():  # one fit may have removed another's model
            if outcome["status"] != FAILED and not (partial / sources / "model").is_dir():
                outcome |= failed("fit", "the folder with the saved method was removed", log)
            outcome[MADE_WITH] = made_with


def render_method(
    entry: MethodEntry,
    model: Path,
    targets: Path,
    masks: Path,
    folder: Path,
    log: Path,
    answers: dict[str, str] | None = None,
    limit: float | None = None,
    attempt: int = 0,
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
        limit: seconds after which the rendering of one set of sources is ended; None: never.
        attempt: the number of this attempt (see `core.attempts`).

    Raises:
        GeoEvsError: the fit's outcome or the target list is damaged, or nothing can be written.
    """
    log.unlink(missing_ok=True)
    fits = read_outcomes(model / "fit.json")
    listed = read_targets(targets)
    made_with = {"targets": file_hash(targets), "masks": file_hash(masks)}
    outcomes: dict[str, dict[str, Any]] = {}
    with _folder_of("render", folder, outcomes, log) as partial:
        for sources, fit in fits.items():
            fit = {key: value for key, value in fit.items() if key != "limit"}
            if fit["status"] == FAILED:
                outcomes[sources] = {**fit, "attempt": attempt_after(attempt, False)}
                continue
            mine = [t for t in listed if t.sources == sources and takes_part(fit, t)]
            if not mine:
                outcomes[sources] = fit
                continue
            step, read = RENDER_STEP, {"targets": targets, "masks": masks}
            read["model"] = model / sources / "model"
            if entry.method in ORACLES:
                step, read = ORACLE_STEP, {**answers, "run": Path(answers["run"])}
            arguments = {"method": entry.method, "sources": sources, "folder": partial, **read}
            arguments = {
                name: str(value.absolute()) if isinstance(value, Path) else value
                for name, value in arguments.items()
            }
            rendered = _attempt("render", step, arguments, fit["threads"], log, limit, attempt)
            peak = {name: max(fit[name], rendered[name]) for name in ("peak_memory", "gpu_memory")}
            outcomes[sources] = {**fit, **rendered, **peak, **_machines(fit, rendered)}
        for sources, outcome in outcomes.items():  # when nobody writes any more
            outcome[MADE_WITH] = {**fits[sources].get(MADE_WITH, {}), **made_with}
            if outcome["status"] != FAILED:
                views = [target for target in listed if target.sources == sources]
                outcome[PICTURES] = seal_pictures(partial, views)


@contextmanager
def _folder_of(
    stage: str, folder: Path, outcomes: dict[str, dict[str, Any]], log: Path
) -> Iterator[Path]:
    """The folder that a stage fills, with its outcomes in it; a method may have removed it."""
    file = f"{stage}.json"
    try:
        with lent_folder(folder) as partial:
            yield partial
            write_json(partial / file, outcomes)
    except MethodFailedError as failure:
        for outcome in outcomes.values():
            if outcome["status"] != FAILED:
                outcome |= failed(stage, str(failure), log)
        with new_folder(folder) as partial:
            write_json(partial / file, outcomes)


def fit_settings(entry: MethodEntry) -> str:
    """Hash of what a config says of an entrant's fit."""
    return settings_hash([entry.method, entry.options, entry.seed])


def _attempt(
    stage: str,
    step: str,
    arguments: dict[str, Any],
    threads: int,
    log: Path,
    limit: float | None,
    attempt: int,
) -> dict[str, Any]:
    try:
        result, usage = run_isolated(step, arguments, threads, log, limit)
        told = _checked(result, usage)
    except MethodFailedError as failure:
        attempt = attempt_after(attempt, failure.kind == MACHINE)
        outcome = failed(stage, str(failure), log) | _done(threads, attempt, Usage(0, 0))
        return outcome if failure.limit is None else {**outcome, "limit": failure.limit}
    return {**FINE, **told, **_done(threads, attempt_after(attempt, False), usage)}


def _done(threads: int, attempt: int, usage: Usage) -> dict[str, Any]:
    """What the runner itself says of a step: nothing that a method told may stand for it."""
    memory = {"peak_memory": usage.peak_memory, "gpu_memory": usage.gpu_memory}
    return {"threads": threads, "attempt": attempt, **memory, **machine()}


def _machines(fit: dict[str, Any], rendered: dict[str, Any]) -> dict[str, str]:
    """The machine of a fit and its rendering; both, where they were made on different ones."""
    said = {name: (fit.get(name, ""), rendered[name]) for name in ("host", "cpu")}
    return {name: ", ".join(dict.fromkeys(filter(None, both))) for name, both in said.items()}


def _checked(result: Any, usage: Usage) -> dict[str, Any]:
    """What a step told, if it can be: numbers that are, and seconds by the runner's clock.

    Raises:
        MethodFailedError: it cannot.
    """
    if not isinstance(result, dict) or not isinstance(result.get("clock", {}), dict):
        raise MethodFailedError("its answer has another form than it should have")
    told = {name: value for name, value in result.items() if name != "clock"}
    for name, kind in COST_TYPES.items():
        value = told.get(name)
        if value is None:
            continue
        number = type(value) in (int, float) and math.isfinite(value) and 0 <= value < 2**63
        if (kind == "string") != isinstance(value, str) or (kind != "string" and not number):
            raise MethodFailedError(f"it told {clean(str(value), 40)} as its {name}")
        if kind == "string":
            told[name] = clean(value)
    for part, seconds in result.get("clock", {}).items():
        true = usage.parts.get(part)
        seconds = float(seconds) if isinstance(seconds, (int, float)) else math.nan
        off = CLOCK_SECONDS + CLOCK_SHARE * (true or 0.0)
        if true is None or not abs(seconds - true) <= off:
            took = "was never begun" if true is None else f"took {true:.3g} s by the runner's clock"
            raise MethodFailedError(f"it told {seconds:.3g} s for '{part}', which {took}")
    return told


def _source_sets(targets: Path) -> dict[str, list[str]]:
    """The splits of each set of sources, without the masked ones, which go with others."""
    found: dict[str, set[str]] = {}
    for target in read_targets(targets):
        found.setdefault(target.sources, set()).add(target.unmasked.split)
    return {sources: sorted(found[sources]) for sources in sorted(found)}
