"""What a detector sees of a frame, by its setting, and what it is to find there."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.hashes import file_hash
from geoevs.core.images import read_image, to_float
from geoevs.core.stamps import MADE_WITH, check_stamp
from geoevs.detection.bevformer.inputs import RigFrame
from geoevs.detection.labels import read_labels, world_from_vehicle
from geoevs.detection.rows import BOX
from geoevs.detection.rules import CLASSES
from geoevs.detection.task_metrics import image_from_vehicle
from geoevs.detection.training_settings import BLIND, views_label
from geoevs.detection.views import BETWEEN, OFFSET
from geoevs.protocol.entries import FAILED, TRUTH, read_outcomes
from geoevs.protocol.pictures import read_view
from geoevs.protocol.provenance import made_with
from geoevs.protocol.targets import ALL_CAMERAS, Target, read_targets
from geoevs.scenes.camera import Camera
from geoevs.scenes.store import Scene

GREY = 0.5
"""The value of all pixels that a blind detector sees."""


class DetectionScene:
    """A scene of the stage: its store, labels, targets and what entrants rendered of them.

    Args:
        run: the run's folder.
        dataset, scene: by their names in the config.
    """

    def __init__(self, run: Path, dataset: str, scene: str) -> None:
        self._run, self._place = Path(run), {"dataset": dataset, "scene": scene}
        self.name = scene_name(dataset, scene)
        self.store = Scene(self._path(layout.SCENE))
        self.labels: pd.DataFrame = read_labels(self._path(layout.DETECTION_LABELS))

    def _path(self, pattern: str, **names: str) -> Path:
        return self._run / pattern.format(**self._place, **names)

    @cached_property
    def targets(self) -> list[Target]:
        """All views that entrants render of it.

        Raises:
            GeoEvsError: they are missing, damaged, or of another scene.
        """
        path = self._path(layout.DETECTION_TARGETS)
        check_stamp(path, made_with(path), {"scene": self.store.stamp})
        return read_targets(path)

    def frames(self, setting: str) -> Iterator[RigFrame]:
        """Every frame as detectors of a setting see it.

        Raises:
            GeoEvsError: a picture of the setting is missing; the sentence says why.
        """
        label = views_label(setting)
        for frame in self.store.frames:
            cameras = [self.store.camera(name, frame) for name in self.store.cameras]
            pictures = [self.store.image(name, frame) for name in self.store.cameras]
            if setting == BLIND:
                pictures = [np.full_like(picture, GREY) for picture in pictures]
            recorded = [True] * len(cameras)
            if label is not None:
                views = self._of_frame(BETWEEN, frame)
                pictures += self.pictures(label, views)
                cameras += [view.camera for view in views]
                recorded += [False] * len(views)
            yield self._rig_frame(frame, cameras, pictures, recorded, 0.0)

    def moved_frames(self, label: str | None, offset: float) -> Iterator[RigFrame]:
        """Every frame as the rig would see it from `offset` metres to the left.

        Labels are those of the recorded rig, in the moved vehicle's frame.

        Args:
            label: whose pictures; None: the recorded ones, at the offset 0.
            offset: of the rig.

        Raises:
            GeoEvsError: a picture is missing; the sentence says why.
        """
        for frame in self.store.frames:
            cameras = self.moved_cameras(frame, offset)
            if label is None:
                pictures = [self.store.image(name, frame) for name in self.store.cameras]
            else:
                views = self._of_frame(OFFSET, frame)
                views = [view for view in views if view.lateral_shift == offset]
                pictures = self.pictures(label, views)
            yield self._rig_frame(frame, cameras, pictures, [True] * len(cameras), offset)

    def moved_cameras(self, frame: int, offset: float) -> list[Camera]:
        """The cameras of the rig `offset` metres to the left; at 0 the recorded ones."""
        if offset == 0:
            return [self.store.camera(name, frame) for name in self.store.cameras]
        views = self._of_frame(OFFSET, frame)
        return [view.camera for view in views if view.lateral_shift == offset]

    def _of_frame(self, split: str, frame: int) -> list[Target]:
        return [view for view in self.targets if (view.split, view.frame) == (split, frame)]

    def pictures(self, label: str, views: Sequence[Target]) -> list[np.ndarray]:
        """(H, W, 3) float32 in [0, 1] each: what an entrant, or the truth, shows of some views.

        Raises:
            GeoEvsError: one is missing, or is of other targets; the sentence says why.
        """
        if label == TRUTH:
            return [self._truth(view) for view in views]
        folder = self._path(layout.DETECTION_VIEWS, label=label)
        path, targets = folder / "render.json", self._path(layout.DETECTION_TARGETS)
        outcome = read_outcomes(path)[ALL_CAMERAS]
        expected = {"scene": self.store.stamp, "targets": file_hash(targets)}
        check_stamp(path, outcome.get(MADE_WITH), expected)
        found = []
        for view in views:
            image, told = read_view(folder, view, outcome)
            if image is None:
                stage = told["stage"] if outcome["status"] == FAILED else view.key
                raise GeoEvsError(f"{self.name}: {stage}: {told['reason']} (see {told['log']})")
            found.append(image)
        return found

    def view_seconds(self, label: str) -> float:
        """Seconds that an entrant took for the views between cameras, its fit among them."""
        folder = self._path(layout.DETECTION_VIEWS, label=label)
        outcome = read_outcomes(folder / "render.json")[ALL_CAMERAS]
        count = sum(view.split == BETWEEN for view in self.targets)
        return (outcome.get("fit_seconds") or 0.0) + count * (outcome.get("render_seconds") or 0.0)

    def _truth(self, view: Target) -> np.ndarray:
        path = self._path(layout.DETECTION_TRUTH) / f"{view.key}.png"
        if not path.exists():
            raise GeoEvsError(f"{self.name}: nobody knows what a camera at {view.key} would see")
        return to_float(read_image(path))

    def vehicle_pose(self, frame: int, offset: float = 0.0) -> np.ndarray:
        """(4, 4) float64: the vehicle's frame, of the rig moved aside, in the world."""
        pose = world_from_vehicle(self.store, frame)
        pose[:3, 3] += offset * pose[:3, 1]
        return pose

    def boxes(self, frame: int, offset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """(M, 7) float64 boxes that count in a frame, as BOX, and (M,) int64 places in CLASSES."""
        rows = self.labels[(self.labels["frame"] == frame) & (self.labels["reason"] == "")]
        boxes = rows[list(BOX)].to_numpy(np.float64)
        boxes[:, 1] -= offset
        return boxes, pd.Index(CLASSES).get_indexer(rows["class"]).astype(np.int64)

    def _rig_frame(
        self,
        frame: int,
        cameras: Sequence[Camera],
        pictures: Sequence[np.ndarray],
        recorded: Sequence[bool],
        offset: float,
    ) -> RigFrame:
        pose = self.vehicle_pose(frame, offset)
        boxes, classes = self.boxes(frame, offset)
        return RigFrame(
            scene=self.name,
            frame=frame,
            seconds=self.store.timestamp(frame),
            images=np.stack(pictures),
            image_from_vehicle=np.stack([image_from_vehicle(camera, pose) for camera in cameras]),
            recorded=np.array(recorded, bool),
            world_from_vehicle=pose,
            boxes=boxes,
            classes=classes,
        )

    def sensor(self) -> tuple[float, float, float]:
        """Where LET metrics look from: the mean place of the cameras in the vehicle's frame."""
        frame = self.store.frames[0]
        pose = self.vehicle_pose(frame)
        centres = [self.store.camera(name, frame).centre for name in self.store.cameras]
        x, y, z = ((np.mean(centres, axis=0) - pose[:3, 3]) @ pose[:3, :3]).tolist()
        return x, y, z


def scene_name(dataset: str, scene: str) -> str:
    """What rows call a scene, whose name another data set may have too.

    >>> scene_name("street-detection", "curve-2901")
    'street-detection/curve-2901'
    """
    return f"{dataset}/{scene}"
