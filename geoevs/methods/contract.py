"""The adapter contract: what a method gets, what it gives back, and how it is found by name.

A method is one class `Method` in `baselines/<name>/adapter.py`, made with its options as keywords.
It sees a scene only through `Views`, which holds what the protocol allows and nothing else.
"""

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self, runtime_checkable

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.randomness import Rng
from geoevs.projection import colour_points
from geoevs.scenes.camera import Camera
from geoevs.scenes.road_map import RoadMap
from geoevs.scenes.scene import Frame, PointCloud, Rig, SceneExtras
from geoevs.scenes.splats import Splats
from geoevs.scenes.store import Scene, write_scene

ORACLES = ("reference", "truth")
"""Controls that copy what scores a method. No adapter can see that, so no method has their name."""

CONTROL = "control"
"""The paradigm of ORACLES, and of methods that only mark a floor or a simple baseline."""

DEFAULT = "default"
"""The variant of an entrant, or of a training, whose name in the config is its method's alone."""

NEEDS = ("lidar", "tracks", "map", "sfm", "training")

SEES = ("views", "first-frame", "layout")
"""How much of the recorded pictures may reach a method: all of its sources, those of the scene's
first frame, or none."""

FROM_PICTURES = ("lidar", "sfm")
"""Needs that are made of pictures: the colours of points, and points matched between images."""


@dataclass(frozen=True)
class MethodInfo:
    """A method's description of itself; tables show all but the citation.

    Args:
        name: as people write it, such as `Street Gaussians`.
        paradigm: `reconstruction`, `diffusion`, ...; `control` sets it apart from methods.
        extra_prior: what it knew before it saw the scene, such as `Stable Diffusion`.
        needs: which of NEEDS it uses; `Views` refuses what is not declared.
        citation: where it was published.
        sees: which of SEES; `Views` refuses the rest.
        splits: which of PLAIN_SPLITS it takes part in; none are named where it takes part in all.
    """

    name: str
    paradigm: str
    extra_prior: str = "none"
    needs: tuple[str, ...] = ()
    citation: str = ""
    sees: str = SEES[0]
    splits: tuple[str, ...] = ()


@dataclass(frozen=True)
class Budget:
    """What a fit keeps to: `seconds` of wall time (None: as long as the method likes), `threads`.

    It is asked, and its costs show whether it does; what ends a fit is the config's limit.
    """

    seconds: float | None = None
    threads: int = 1


@dataclass(frozen=True)
class FitReport:
    """The outcome of a fit: number of primitives, of learned parameters, and a note for readers.

    `training_seconds` are those of the trainings whose networks the fit was given, which are no
    part of the fit; None where nothing was trained, or nobody knows how long.
    """

    primitives: int = 0
    parameters: int = 0
    note: str = ""
    training_seconds: float | None = None


@dataclass(frozen=True)
class Rendering:
    """A synthesised view; depth and support where the method has them."""

    rgb: np.ndarray  # [H, W, 3] float in [0, 1] or uint8 (see methods/returned.py)
    depth: np.ndarray | None = None  # [H, W] metres, 0 = none
    support: np.ndarray | None = None  # [H, W] bool: pixels that geometry explains


class Views:
    """The part of a scene that a method may see under one split.

    Args:
        scene: the store.
        cameras: the source cameras the split allows.
        needs: what the method declared (see MethodInfo); LiDAR, tracks and map are refused
            otherwise.
        sees: likewise, which pictures.
    """

    def __init__(
        self, scene: Scene, cameras: Sequence[str], needs: Sequence[str], sees: str = SEES[0]
    ) -> None:
        self._scene = scene
        self._needs = tuple(needs)
        self._sees = sees
        self.scene_name: str = scene.info.name
        self.cameras: tuple[str, ...] = tuple(cameras)
        self.frames: tuple[int, ...] = scene.frames
        self.rig: Rig = scene.info.rig
        self.tags: tuple[str, ...] = scene.info.tags

    def has(self, need: str) -> bool:
        """Whether the method declared `need`, so that it may be read."""
        return need in self._needs

    def camera(self, name: str, frame: int) -> Camera:
        """The calibration and pose of a source camera in a frame.

        Raises:
            GeoEvsError: the split does not allow this camera, or the scene lacks the frame.
        """
        self._allow(name)
        return self._scene.camera(name, frame)

    def shows(self, frame: int) -> bool:
        """Whether the method may see the pictures of a frame."""
        return self._sees == "views" or (self._sees == "first-frame" and frame == self.frames[0])

    def image(self, name: str, frame: int) -> np.ndarray:
        """(H, W, 3) float32 in [0, 1]: a source image.

        Raises:
            GeoEvsError: the split does not allow this camera, the method does not see the frame,
                or the scene lacks it.
        """
        self._allow(name)
        if not self.shows(frame):
            raise GeoEvsError(
                f"the method reads the image of camera '{name}' in frame {frame}, but sees "
                f"'{self._sees}'; leave it alone, or change MethodInfo.sees"
            )
        return self._scene.image(name, frame)

    def lidar(self, frame: int) -> PointCloud:
        """The LiDAR points that may condition a method, never those that score it.

        Positions are in the world, in metres. Colours come from the source cameras alone.

        Raises:
            GeoEvsError: the method did not declare LiDAR, or does not see all that coloured it.
        """
        self._require("lidar")
        if self._sees != "views":
            raise GeoEvsError(
                f"the method reads LiDAR, whose colours are pixels, but sees '{self._sees}'; leave "
                "it alone, or change MethodInfo.sees"
            )
        points = self._scene.points(frame)
        points = points.select(~self.rig.scores(points))
        if set(self.cameras) == set(self._scene.cameras):
            return points
        cameras = {name: self.camera(name, frame) for name in self.cameras}
        images = {name: self.image(name, frame) for name in self.cameras}
        return colour_points(points, cameras, images, self._scene.ego_masks)

    def without_ego(self, name: str, depth: np.ndarray) -> np.ndarray:
        """(H, W) metres: a source camera's depth, none where it sees the car that carries it.

        What has no depth is lifted nowhere, so that no condition shows the car.
        """
        self._allow(name)
        mask = self._scene.ego_masks.get(name)
        return depth if mask is None else np.where(mask, np.zeros_like(depth), depth)

    @property
    def tracks(self) -> pd.DataFrame:
        """Boxes, one row a frame and track (see TRACK_COLUMNS)."""
        self._require("tracks")
        return self._scene.tracks

    @property
    def road_map(self) -> RoadMap | None:
        """The ground around the scene; None where its source has no map."""
        self._require("map")
        return self._scene.road_map

    def save(self, folder: Path) -> None:
        """Write the allowed part as a scene store of its own: LiDAR, tracks and map if declared.

        Pictures that the method does not see are not in it.
        """
        info = dataclasses.replace(self._scene.info, cameras=self.cameras)
        frames = (self._frame(frame) for frame in self.frames)
        tracks = self._scene.tracks
        masks = self._scene.ego_masks
        extras = SceneExtras(
            {name: masks[name] for name in self.cameras if name in masks},
            self.road_map if self.has("map") else None,
        )
        tracks = tracks if self.has("tracks") else tracks[:0]
        write_scene(folder, info, tracks, frames, extras, unseen=True)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Open views that `save` wrote; all that the folder holds may be read."""
        scene = Scene(folder)
        return cls(scene, scene.cameras, NEEDS)

    def _frame(self, frame: int) -> Frame:
        cameras = {name: self.camera(name, frame) for name in self.cameras}
        shown = self.cameras if self.shows(frame) else ()
        images = {name: self.image(name, frame) for name in shown}
        if self.has("lidar"):
            points = self.lidar(frame)
        else:
            points = PointCloud.uncoloured(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
        return Frame(frame, self._scene.timestamp(frame), cameras, images, points)

    def _allow(self, camera: str) -> None:
        if camera not in self.cameras:
            raise GeoEvsError(
                f"camera '{camera}' is not a source of this split; "
                f"{did_you_mean(camera, self.cameras)}"
            )

    def _require(self, need: str) -> None:
        if not self.has(need):
            raise GeoEvsError(
                f"the method reads {need} without declaring it; add '{need}' to MethodInfo.needs"
            )


class Adapter(Protocol):
    """A method under test; its class is called `Method`, its constructor takes its options."""

    info: MethodInfo

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Learn a scene from its allowed views."""
        ...

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Synthesise what `camera` would see in `frame`."""
        ...

    def save(self, folder: Path) -> None:
        """Write everything `render` needs into an existing, empty folder."""
        ...

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Restore what `save` wrote; it renders the same pixels."""
        ...


@runtime_checkable
class JointAdapter(Adapter, Protocol):
    """A method that makes a frame's views at once, as those that look at their neighbours do.

    It is asked for all views of a frame and split in one call, whose seconds they share alike.
    `render` is there for one view alone.
    """

    def render_together(self, cameras: Sequence[Camera], frame: int) -> Sequence[Rendering]:
        """Synthesise what each of `cameras` would see in `frame`, in their order."""
        ...


@runtime_checkable
class ReadsFiles(Protocol):
    """A method that reads files which no step makes, beside its weights."""

    def files(self, scene: str) -> Iterable[Path]:
        """The files and folders that are read for a scene: a change of them fits it again."""
        ...


@runtime_checkable
class MaskedAdapter(Adapter, Protocol):
    """A method that has a condition map, and so can be asked for masked views (section 3.4)."""

    def render_masked(
        self,
        camera: Camera,
        frame: int,
        keep: np.ndarray,  # [H, W] bool
    ) -> Rendering:
        """As `render`, with the condition map's pixels outside `keep` hidden."""
        ...


@runtime_checkable
class SplatsAdapter(Adapter, Protocol):
    """A method whose scene is 3D Gaussians, so that `geoevs export-splats` can write them."""

    def splats(self, frame: int) -> Splats:
        """What `render` draws in `frame`: what moves is where it is then, in the world."""
        ...
