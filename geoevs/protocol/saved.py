"""The models that a run's fits left, found by the names that the config has and opened again."""

import os
from contextlib import suppress
from pathlib import Path

from geoevs import layout
from geoevs.core.errors import GeoEvsError, did_you_mean, reason_of
from geoevs.core.text import printable
from geoevs.methods.contract import ORACLES, Adapter
from geoevs.methods.finding import method_class
from geoevs.protocol.entries import FAILED, read_outcomes
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.scenes.store import Scene

MODELS = layout.MODEL.partition("/")[0]


class SavedScene:
    """A scene of a run, and the entrants whose fits to all of its cameras were saved.

    Args:
        run: the run's folder.
        name: the scene as the config has it, SCENE or DATASET/SCENE.

    Raises:
        GeoEvsError: the folder is no run, it has no models, or no such scene.
    """

    def __init__(self, run: Path, name: str) -> None:
        self.run = Path(run)
        if not self.run.is_dir():
            raise GeoEvsError(f"{self.run} is no run's folder; name a run, or give its path")
        models = self.run / MODELS
        scenes = [(data, scene) for data in _folders(models) for scene in _folders(models / data)]
        if not scenes:
            raise GeoEvsError(
                f"{models} holds no models; make the run's fits again, or copy that folder with it"
            )
        found = [pair for pair in scenes if name in (pair[1], "/".join(pair))]
        if len(found) != 1:
            names = sorted({scene for _, scene in scenes} | {"/".join(pair) for pair in scenes})
            problem = "stands for several scenes" if found else "is no scene with models"
            raise GeoEvsError(f"'{name}' {problem} in {self.run}; {did_you_mean(name, names)}")
        self.dataset, self.name = found[0]
        self.entrants = [
            label
            for label in _folders(self._path(layout.MODEL, ""))
            if _method(label) not in ORACLES  # which have no model
        ]

    def _path(self, pattern: str, label: str = "") -> Path:
        return self.run / pattern.format(dataset=self.dataset, scene=self.name, label=label)

    def scene(self) -> Scene:
        """The scene's store, which lies in the run too."""
        return Scene(self._path(layout.SCENE))

    def method(self, label: str) -> type[Adapter]:
        """The class of an entrant's method.

        Args:
            label: METHOD or METHOD.VARIANT, with `.seedN` where the seed is another than 0.

        Raises:
            GeoEvsError: no such entrant has a model, or its method is gone.
        """
        if label not in self.entrants:
            raise GeoEvsError(
                f"there is no model of '{label}' on {self.dataset}/{self.name}; "
                f"{did_you_mean(label, self.entrants)}"
            )
        try:
            return method_class(_method(label))
        except Exception as error:  # its code may be gone, or raise anything
            folder = self._path(layout.MODEL, label)
            raise GeoEvsError(
                f"{folder} cannot be opened without its method: {reason_of(error)}"
            ) from error

    def load(self, label: str) -> Adapter:
        """An entrant as it was fitted to the views of all cameras.

        Raises:
            GeoEvsError: see `method`; or its fit failed, or cannot be opened.
        """
        kind = self.method(label)
        folder = self._path(layout.MODEL, label)
        outcome = read_outcomes(folder / "fit.json").get(ALL_CAMERAS)
        if outcome is None or outcome["status"] == FAILED:
            reason = outcome["reason"] if outcome else f"it has no fit to {ALL_CAMERAS}"
            raise GeoEvsError(
                f"{folder} has no model to open ({reason}); choose another entrant of "
                f"{', '.join(self.entrants)}"
            )
        model = (folder / ALL_CAMERAS / "model").absolute()
        try:
            return kind.load(model)
        except Exception as error:  # a method may raise anything, at a model of other code too
            raise GeoEvsError(
                f"{model} cannot be opened by its method ({reason_of(error)}); fit it again"
            ) from error

    def with_part(self, name: str) -> list[str]:
        """The entrants whose method has an optional part of the contract, such as `splats`."""
        having = []
        for label in self.entrants:
            with suppress(Exception):  # of methods that are gone, or cannot be imported
                if hasattr(self.method(label), name):
                    having.append(label)
        return having


def _method(label: str) -> str:
    return label.partition(".")[0]


def _folders(path: Path) -> list[str]:
    """The names of folders in a folder, none if it is missing."""
    if not path.is_dir():
        return []
    with os.scandir(path) as entries:
        return sorted(e.name for e in entries if e.is_dir() and e.name == printable(e.name))
