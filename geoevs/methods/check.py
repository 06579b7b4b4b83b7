"""The adapter contract as named checks, run on a tiny scene in a folder of their own."""

import ast
import contextlib
import inspect
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.isolate import MethodFailedError, absolute_paths, run_isolated
from geoevs.core.splits import PLAIN_SPLITS
from geoevs.methods.contract import (
    FROM_PICTURES,
    NEEDS,
    SEES,
    MaskedAdapter,
    MethodInfo,
    Rendering,
    SplatsAdapter,
)
from geoevs.methods.finding import make_method
from geoevs.methods.returned import checked_array, checked_report, checked_rgb, checked_splats
from geoevs.methods.tiny import with_hidden_black
from geoevs.methods.trial import (
    FRAME,
    KEEP,
    VIRTUAL,
    BrokenContractError,
    Check,
    Trial,
    difference_of,
    failure,
    run_check,
    watched_files,
)
from geoevs.scenes.camera import Camera

# Views can tell when these are read; what else a method declares is taken at its word.
WATCHED_NEEDS = ("lidar", "tracks", "map")

# A method that reads these could see its answers.
HIDDEN_PACKAGES = ("geoevs.protocol", "geoevs.results")

LIMIT = 3600.0
"""Seconds that all checks of a method may take."""


def check_isolated(name: str, options: dict[str, Any]) -> list[Check]:
    """`check_adapter` in a process of its own, as a run has it: one that hangs or dies is a check.

    Raises:
        GeoEvsError: there is no such method, or an option is wrong.
    """
    arguments = {"name": name, "options": absolute_paths(options)}
    try:
        told, _ = run_isolated(f"{__name__}:check_step", arguments, None, None, LIMIT)
    except MethodFailedError as failure:
        return [Check(failure.part or "import", "failed", str(failure))]
    if "refused" in told:
        raise GeoEvsError(told["refused"])
    return [Check(**check) for check in told["checks"]]


def check_step(name: str, options: dict[str, Any]) -> dict[str, Any]:
    """All checks as data, or the sentence that refuses to begin, as the isolated process has it."""
    try:
        return {"checks": [asdict(check) for check in check_adapter(name, options)]}
    except GeoEvsError as error:
        return {"refused": str(error)}


def check_adapter(name: str, options: dict[str, Any]) -> list[Check]:
    """Run every check on the method called `name`.

    Raises:
        GeoEvsError: there is no such method, or an option is wrong.
    """
    with tempfile.TemporaryDirectory() as temporary, contextlib.ExitStack() as stack:
        folder = Path(temporary)
        (folder / "cwd").mkdir()
        (folder / "saved").mkdir()
        stack.enter_context(contextlib.chdir(folder / "cwd"))
        try:
            trial = Trial(name, options, folder)
        except GeoEvsError:
            raise
        except Exception as error:
            return [failure("import", error)]
        return [
            Check(title, "skipped", "fit failed")
            if check in AFTER_FIT and not trial.fitted
            else run_check(title, check, trial)
            for title, check in CHECKS.items()
        ]


def contract_failures(name: str, **options: object) -> list[str]:
    """The failed checks of a method, one line each; its test asserts that there are none."""
    checks = check_adapter(name, options)
    return [f"{check.name}: {check.sentence}" for check in checks if check.status == "failed"]


def _check_info(trial: Trial) -> None:
    info = trial.method.info
    if not isinstance(info, MethodInfo):
        raise BrokenContractError(f"info is a {type(info).__name__}; make it a MethodInfo")
    for field in ("name", "paradigm", "extra_prior"):
        if not str(getattr(info, field)).strip():
            raise BrokenContractError(f"info.{field} is empty; tables print it, so fill it in")
    for field, words in (("needs", NEEDS), ("splits", PLAIN_SPLITS)):
        named = getattr(info, field)
        if isinstance(named, str) or any(word not in words for word in named):
            raise BrokenContractError(
                f"info.{field} is {named!r}; make it a tuple of {', '.join(words)}"
            )
    if info.sees not in SEES:
        raise BrokenContractError(f"info.sees is {info.sees!r}; make it one of {', '.join(SEES)}")
    hidden = [need for need in info.needs if need in FROM_PICTURES]
    if info.sees != "views" and hidden:
        raise BrokenContractError(
            f"info.needs has {hidden[0]}, which is made of pictures that a method that sees "
            f"'{info.sees}' does not see; remove one of the two"
        )


def _check_imports(trial: Trial) -> None:
    folder = Path(inspect.getfile(type(trial.method))).parent
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_bytes())):
            names = [alias.name for alias in getattr(node, "names", []) if hasattr(alias, "name")]
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module, *(f"{node.module}.{name}" for name in names)]
            elif not isinstance(node, ast.Import):
                continue
            for name in names:
                if name.startswith(HIDDEN_PACKAGES):
                    raise BrokenContractError(
                        f"{path.name}:{node.lineno} imports {name}; a method must not know how it "
                        "is scored"
                    )


def _check_fit(trial: Trial) -> None:
    report = trial.fit(trial.method)
    with _as_in_a_run():
        checked_report(report)
    trial.fitted = True


@contextlib.contextmanager
def _as_in_a_run() -> Iterator[None]:
    """What a run would refuse is a broken contract."""
    try:
        yield
    except GeoEvsError as error:
        raise BrokenContractError(str(error)) from error


def _check_source_view(trial: Trial) -> None:
    _check_rendering(trial.render(trial.source), trial.source)


def _check_virtual_view(trial: Trial) -> None:
    _check_rendering(trial.render(VIRTUAL), VIRTUAL)


def _check_masked_view(trial: Trial) -> None:
    if not isinstance(trial.method, MaskedAdapter):  # it has no condition map
        return
    _check_rendering(trial.render_masked(), VIRTUAL)
    everything = trial.method.render_masked(VIRTUAL, FRAME, np.ones_like(KEEP))
    difference = difference_of(trial.render(VIRTUAL), everything)
    if difference:
        raise BrokenContractError(
            f"render_masked that keeps every pixel gives another {difference} than render; hide "
            "pixels of the condition map and change nothing else"
        )


def _check_joint_views(trial: Trial) -> None:
    for rendering, camera in zip(trial.render_together(), trial.both, strict=False):
        _check_rendering(rendering, camera)


def _check_splats(trial: Trial) -> None:
    if isinstance(trial.method, SplatsAdapter):
        with _as_in_a_run():
            checked_splats(trial.method.splats(FRAME))


def _check_rendering(rendering: Rendering | None, camera: Camera) -> None:
    with _as_in_a_run():
        checked_rgb(rendering, camera)
        assert rendering is not None
        shape = camera.height, camera.width
        if rendering.depth is not None:
            depth = checked_array("depth", rendering.depth, shape)
            if not (np.isfinite(depth).all() and depth.min() >= 0):
                raise BrokenContractError(
                    "depth is negative or not finite somewhere; write 0 for none"
                )
        if rendering.support is not None:
            support = checked_array("support", rendering.support, shape)
            if support.dtype != bool:
                raise BrokenContractError(f"support is {support.dtype}; make it bool")


def _check_needs(trial: Trial) -> str | None:
    views = trial.views
    if views is None:
        raise BrokenContractError("info.needs could not be read")
    if views.refused:
        need = sorted(views.refused)[0]
        raise BrokenContractError(
            f"the method reads {need} without declaring it; add '{need}' to info.needs"
        )
    unused = [n for n in WATCHED_NEEDS if n in trial.method.info.needs and n not in views.used]
    if trial.rendered and unused:
        return f"declares {' and '.join(unused)} but did not read it on the tiny scene"
    return None


def _check_determinism(trial: Trial) -> str | None:
    again = make_method(trial.name, trial.options)
    trial.fit(again)
    difference = trial.difference(again)
    if not difference:
        return None
    return _other_bytes(
        f"two fits with the same rng rendered different {difference}; take all randomness "
        "from rng.numpy or rng.torch"
    )


def _check_hidden_pictures(trial: Trial) -> str | None:
    sees = trial.method.info.sees
    if sees == "views":  # nothing is hidden
        return None
    dark = with_hidden_black(trial.scene, trial.folder / "dark", sees)
    again = make_method(trial.name, trial.options)
    trial.fit(again, dark)
    difference = trial.difference(again)
    if not difference:
        return None
    return _other_bytes(
        f"where pictures that a method that sees '{sees}' does not see are black, the {difference} "
        "differs; read a scene through Views alone"
    )


def _check_reload(trial: Trial) -> str | None:
    saved = trial.folder / "saved"
    for camera in trial.both:
        trial.render(camera)
    trial.render_masked()
    trial.render_together()
    trial.method.save(saved)
    # The scene may be elsewhere, or gone, when a saved method is loaded.
    shutil.move(trial.folder / "scene", trial.folder / "scene-moved")
    try:
        difference = trial.difference(type(trial.method).load(saved))
        if not difference:
            return None
        return _other_bytes(
            f"after save and load the {difference} differs; save all that render needs"
        )
    finally:
        shutil.move(trial.folder / "scene-moved", trial.folder / "scene")


def _other_bytes(sentence: str) -> str:
    """A failure, but where a GPU was used only a warning: there sums come in any order."""
    torch = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_initialized():
        raise BrokenContractError(sentence)
    return f"{sentence} (or it is the GPU's order of sums: set CUDA_VISIBLE_DEVICES= to see)"


def _check_own_folder(trial: Trial) -> None:
    after = watched_files(trial.folder, trial.name)
    touched = [p for p in {**trial.before, **after} if trial.before.get(p) != after.get(p)]
    if touched:
        more = f" and {len(touched) - 1} more" if len(touched) > 1 else ""
        raise BrokenContractError(
            f"wrote outside its folder: {sorted(touched)[0]}{more}; write only where save is told"
        )


CHECKS: dict[str, Callable[[Trial], str | None]] = {
    "info": _check_info,
    "imports": _check_imports,
    "fit": _check_fit,
    "source view": _check_source_view,
    "virtual view": _check_virtual_view,
    "masked view": _check_masked_view,
    "joint views": _check_joint_views,
    "splats": _check_splats,
    "declared needs": _check_needs,
    "determinism": _check_determinism,
    "hidden pictures": _check_hidden_pictures,
    "save and reload": _check_reload,
    "own folder": _check_own_folder,
}
AFTER_FIT = (
    _check_source_view,
    _check_virtual_view,
    _check_masked_view,
    _check_joint_views,
    _check_splats,
    _check_determinism,
    _check_hidden_pictures,
    _check_reload,
)
