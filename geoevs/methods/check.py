"""The adapter contract as named checks, run on a tiny scene in a folder of their own."""

import ast
import contextlib
import importlib
import inspect
import os
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.isolate import MethodFailedError, absolute_paths, begin_part, run_isolated
from geoevs.core.plugins import module_path
from geoevs.core.randomness import Rng
from geoevs.methods.contract import (
    NEEDS,
    Adapter,
    Budget,
    FitReport,
    MaskedAdapter,
    MethodInfo,
    Rendering,
    SplatsAdapter,
    Views,
)
from geoevs.methods.finding import find_methods, make_method
from geoevs.methods.returned import checked_array, checked_report, checked_rgb, checked_splats
from geoevs.methods.tiny import HEIGHT, MOUNT, WIDTH, tiny_camera, write_tiny_scene
from geoevs.scenes.camera import Camera

# Where the checks render: what an `external` method must hold images of.
FRAME = 1
SOURCE = "front"
VIRTUAL = tiny_camera("virtual", 22.5, MOUNT + np.array([0.5, 1.0, 0.0]))

# What a masked view keeps of its condition map: all but a block in the middle.
KEEP = np.ones((HEIGHT, WIDTH), bool)
KEEP[HEIGHT // 4 : -HEIGHT // 4, WIDTH // 4 : -WIDTH // 4] = False

# Views can tell when these are read; what else a method declares is taken at its word.
WATCHED_NEEDS = ("lidar", "tracks")

# A method that reads these could see its answers.
HIDDEN_PACKAGES = ("geoevs.protocol", "geoevs.results")

LIMIT = 3600.0
"""Seconds that all checks of a method may take."""

# What Python and Numba themselves write beside the code.
UNWATCHED_FOLDERS = ("__pycache__",)


@dataclass(frozen=True)
class Check:
    """The result of one check of a contract.

    Args:
        name: what was checked.
        status: `passed`, `failed`, `warned` or `skipped`.
        sentence: why it did not pass.
        traceback: of the method's own exception, where it raised one.
    """

    name: str
    status: str
    sentence: str = ""
    traceback: str = ""


OWN_FILES = ("adapter.py", "training.py")
"""Where a method's own code begins: failures name the last line there."""

Tried = TypeVar("Tried")
"""What checks are run on: a method, or a training."""


class BrokenContractError(Exception):
    """The sentence of a failed check."""


class WatchedViews(Views):
    """Views that remember which needs were read, and which were refused."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.used: set[str] = set()
        self.refused: set[str] = set()

    def _require(self, need: str) -> None:
        try:
            super()._require(need)
        except GeoEvsError:
            self.refused.add(need)
            raise
        self.used.add(need)


class Trial:
    """One method on the tiny scene, with what the checks learn of it on their way."""

    def __init__(self, name: str, options: dict[str, Any], folder: Path) -> None:
        self.name, self.options, self.folder = name, options, folder
        self.scene = write_tiny_scene(folder / "scene")
        self.source = self.scene.camera(SOURCE, FRAME)
        self.before = _watched_files(folder, name)
        self.method = make_method(name, options)
        self.views: WatchedViews | None = None
        self.fitted = False
        self.rendered: dict[str, Rendering] = {}

    def fit(self, method: Adapter) -> FitReport:
        """Fit to the tiny scene, with the same randomness each time."""
        self.views = WatchedViews(self.scene, self.scene.cameras, method.info.needs)
        return method.fit(self.views, Budget(), Rng(0, "check-adapter"))

    def render(self, camera: Camera) -> Rendering:
        """The first fit's rendering of a camera, made once."""
        if camera.name not in self.rendered:
            self.rendered[camera.name] = self.method.render(camera, FRAME)
        return self.rendered[camera.name]

    def render_masked(self) -> Rendering | None:
        """The first fit's masked view, made once, where the method has any."""
        if isinstance(self.method, MaskedAdapter) and "masked" not in self.rendered:
            self.rendered["masked"] = self.method.render_masked(VIRTUAL, FRAME, KEEP)
        return self.rendered.get("masked")

    def difference(self, other: Adapter) -> str:
        """The first part of these views that another copy of the method renders otherwise."""
        for camera in (VIRTUAL, self.source):
            if part := _difference(self.render(camera), other.render(camera, FRAME)):
                return part
        if masked := self.render_masked():
            copy = cast(MaskedAdapter, other)
            part = _difference(masked, copy.render_masked(VIRTUAL, FRAME, KEEP))
            if part:
                return f"{part} of a masked view"
        mine: Adapter = self.method
        if isinstance(mine, SplatsAdapter):
            theirs = cast(SplatsAdapter, other)
            return "" if mine.splats(FRAME).same(theirs.splats(FRAME)) else "splats"
        return ""


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
            return [_failure("import", error)]
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


def run_check(title: str, check: Callable[[Tried], str | None], trial: Tried) -> Check:
    """Run one check on a trial; whatever the method raises is a failure of that check."""
    begin_part(title)
    try:
        warning = check(trial)
    except BrokenContractError as broken:
        return Check(title, "failed", str(broken))
    except Exception as error:
        return _failure(title, error)
    return Check(title, "warned", warning) if warning else Check(title, "passed")


def _failure(title: str, error: Exception) -> Check:
    """A failed check from the method's own exception: what, and the last line of its own code."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if Path(frame.filename).name in OWN_FILES]
    place = (own or frames)[-1]
    where = f"{Path(place.filename).parent.name}/{Path(place.filename).name}:{place.lineno}"
    sentence = f"{reason_of(error)} (at {where})"
    return Check(title, "failed", sentence, "".join(traceback.format_exception(error)))


def _check_info(trial: Trial) -> None:
    info = trial.method.info
    if not isinstance(info, MethodInfo):
        raise BrokenContractError(f"info is a {type(info).__name__}; make it a MethodInfo")
    for field in ("name", "paradigm", "extra_prior"):
        if not str(getattr(info, field)).strip():
            raise BrokenContractError(f"info.{field} is empty; tables print it, so fill it in")
    unknown = [need for need in info.needs if need not in NEEDS]
    if isinstance(info.needs, str) or unknown:
        raise BrokenContractError(
            f"info.needs is {info.needs!r}; make it a tuple of {', '.join(NEEDS)}"
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
    difference = _difference(trial.render(VIRTUAL), everything)
    if difference:
        raise BrokenContractError(
            f"render_masked that keeps every pixel gives another {difference} than render; hide "
            "pixels of the condition map and change nothing else"
        )


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


def _check_reload(trial: Trial) -> str | None:
    saved = trial.folder / "saved"
    for camera in (VIRTUAL, trial.source):
        trial.render(camera)
    trial.render_masked()
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


def _difference(first: Rendering, second: Rendering) -> str:
    """The first part of two renderings that is not the same bit for bit, or nothing."""
    for part in ("rgb", "depth", "support"):
        one, other = getattr(first, part), getattr(second, part)
        if (one is None) != (other is None):
            return part
        if one is not None and (one.dtype != other.dtype or not np.array_equal(one, other)):
            return part
    return ""


def _check_own_folder(trial: Trial) -> None:
    after = _watched_files(trial.folder, trial.name)
    touched = [p for p in {**trial.before, **after} if trial.before.get(p) != after.get(p)]
    if touched:
        more = f" and {len(touched) - 1} more" if len(touched) > 1 else ""
        raise BrokenContractError(
            f"wrote outside its folder: {sorted(touched)[0]}{more}; write only where save is told"
        )


def _watched_files(folder: Path, name: str) -> dict[Path, tuple[int, int]]:
    """Size and time of every file that a method has no business with."""
    roots = [folder / "cwd", folder / "scene"]
    for package in ("geoevs", "baselines"):
        roots += map(Path, importlib.import_module(package).__path__)
    if (module := find_methods().get(name)) and (own := module_path(module)):
        roots.append(own.parent)  # of a method outside the project too
    return {path: state for root in roots for path, state in _files(root)}


def _files(root: Path) -> Iterator[tuple[Path, tuple[int, int]]]:
    for parent, folders, names in os.walk(root):
        folders[:] = [n for n in folders if n not in UNWATCHED_FOLDERS and not n.startswith(".")]
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                status = (Path(parent) / name).stat()
                yield Path(parent) / name, (status.st_size, status.st_mtime_ns)


CHECKS: dict[str, Callable[[Trial], str | None]] = {
    "info": _check_info,
    "imports": _check_imports,
    "fit": _check_fit,
    "source view": _check_source_view,
    "virtual view": _check_virtual_view,
    "masked view": _check_masked_view,
    "splats": _check_splats,
    "declared needs": _check_needs,
    "determinism": _check_determinism,
    "save and reload": _check_reload,
    "own folder": _check_own_folder,
}
AFTER_FIT = (
    _check_source_view,
    _check_virtual_view,
    _check_masked_view,
    _check_splats,
    _check_determinism,
    _check_reload,
)
