"""One method on the tiny scene, and how a check of its contract ends."""

import contextlib
import importlib
import os
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.isolate import begin_part
from geoevs.core.plugins import module_path
from geoevs.core.randomness import Rng
from geoevs.methods.contract import (
    Adapter,
    Budget,
    FitReport,
    JointAdapter,
    MaskedAdapter,
    Rendering,
    SplatsAdapter,
    Views,
)
from geoevs.methods.finding import find_methods, make_method
from geoevs.methods.returned import checked_together
from geoevs.methods.tiny import HEIGHT, MOUNT, WIDTH, tiny_camera, write_tiny_scene
from geoevs.scenes.camera import Camera
from geoevs.scenes.store import Scene

# Where the checks render: what an `external` method must hold images of.
FRAME = 1
SOURCE = "front"
VIRTUAL = tiny_camera("virtual", 22.5, MOUNT + np.array([0.5, 1.0, 0.0]))

# What a masked view keeps of its condition map: all but a block in the middle.
KEEP = np.ones((HEIGHT, WIDTH), bool)
KEEP[HEIGHT // 4 : -HEIGHT // 4, WIDTH // 4 : -WIDTH // 4] = False

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
        self.before = watched_files(folder, name)
        self.method = make_method(name, options)
        self.views: WatchedViews | None = None
        self.fitted = False
        self.rendered: dict[str, Rendering] = {}

    def fit(self, method: Adapter, scene: Scene | None = None) -> FitReport:
        """Fit to the tiny scene, or another, with the same randomness each time."""
        scene, info = scene or self.scene, method.info
        self.views = WatchedViews(scene, scene.cameras, info.needs, info.sees)
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

    def render_together(self) -> list[Rendering]:
        """The first fit's renderings of both views at once, made once; none where it cannot."""
        if isinstance(self.method, JointAdapter) and "together 0" not in self.rendered:
            views = joint_views(self.method, self.both)
            self.rendered |= {f"together {number}": view for number, view in enumerate(views)}
        return [view for name, view in self.rendered.items() if name.startswith("together")]

    @property
    def both(self) -> tuple[Camera, Camera]:
        """The views that every method renders: a virtual one, and one of a source."""
        return VIRTUAL, self.source

    def difference(self, other: Adapter) -> str:
        """The first part of these views that another copy of the method renders otherwise."""
        for camera in self.both:
            if part := difference_of(self.render(camera), other.render(camera, FRAME)):
                return part
        if masked := self.render_masked():
            copy = cast(MaskedAdapter, other)
            if part := difference_of(masked, copy.render_masked(VIRTUAL, FRAME, KEEP)):
                return f"{part} of a masked view"
        if together := self.render_together():
            views = joint_views(cast(JointAdapter, other), self.both)
            for one, view in zip(together, views, strict=True):
                if part := difference_of(one, view):
                    return f"{part} of views rendered together"
        mine: Adapter = self.method
        if isinstance(mine, SplatsAdapter):
            theirs = cast(SplatsAdapter, other)
            return "" if mine.splats(FRAME).same(theirs.splats(FRAME)) else "splats"
        return ""


def joint_views(method: JointAdapter, cameras: Sequence[Camera]) -> Sequence[Rendering]:
    """What a method renders at once of the frame that the checks look at.

    Raises:
        BrokenContractError: it is not one rendering a camera.
    """
    try:
        return checked_together(method.render_together(cameras, FRAME), cameras)
    except GeoEvsError as error:
        raise BrokenContractError(str(error)) from error


def run_check(title: str, check: Callable[[Tried], str | None], trial: Tried) -> Check:
    """Run one check on a trial; whatever the method raises is a failure of that check."""
    begin_part(title)
    try:
        warning = check(trial)
    except BrokenContractError as broken:
        return Check(title, "failed", str(broken))
    except Exception as error:
        return failure(title, error)
    return Check(title, "warned", warning) if warning else Check(title, "passed")


def failure(title: str, error: Exception) -> Check:
    """A failed check from the method's own exception: what, and the last line of its own code."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if Path(frame.filename).name in OWN_FILES]
    place = (own or frames)[-1]
    where = f"{Path(place.filename).parent.name}/{Path(place.filename).name}:{place.lineno}"
    sentence = f"{reason_of(error)} (at {where})"
    return Check(title, "failed", sentence, "".join(traceback.format_exception(error)))


def difference_of(first: Rendering, second: Rendering) -> str:
    """The first part of two renderings that is not the same bit for bit, or nothing."""
    for part in ("rgb", "depth", "support"):
        one, other = getattr(first, part), getattr(second, part)
        if (one is None) != (other is None):
            return part
        if one is not None and (one.dtype != other.dtype or not np.array_equal(one, other)):
            return part
    return ""


def watched_files(folder: Path, name: str) -> dict[Path, tuple[int, int]]:
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
