"""Detectors of every setting: trained, and run on test scenes."""

import dataclasses
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_folder
from geoevs.core.networks import best_device
from geoevs.core.parquet import write_parquet
from geoevs.detection.bevformer import detecting, features, training
from geoevs.detection.bevformer.backbone import load_backbone
from geoevs.detection.bevformer.inputs import FeatureFrame, RigFrame
from geoevs.detection.bevformer.settings import Detector, Fitting
from geoevs.detection.found import FOUND
from geoevs.detection.labels import scored
from geoevs.detection.outcomes import Outcome
from geoevs.detection.rigs import DetectionScene
from geoevs.detection.settings import DetectionSettings
from geoevs.detection.training_settings import AUGMENTED, LONGER, NATIVE, views_label
from geoevs.protocol.entries import TRUTH

BACKBONE, WEIGHTS = "backbone.safetensors", "detector.safetensors"
"""Networks, in the folders of a backbone and of a detector."""


def train_backbone(
    scenes: Sequence[DetectionScene],
    settings: DetectionSettings,
    seed: int,
    pretrained: Path,
    work: Path,
    out: Path,
) -> None:
    """Train what turns pictures into features, on the recorded views of scenes.

    Detectors of all settings share it, so that they differ in their pictures alone.

    Args:
        scenes: to learn from.
        settings: the config's section.
        seed: of the detectors that will take it.
        pretrained: the folder of this suite's own weights.
        work: holds what a killed training needs to go on.
        out: the folder to write, whole or not at all: Outcome, and BACKBONE if all went well.
    """
    with new_folder(out) as partial:
        try:
            _check_labels(scenes, "learn from")
            frames = list(_frames(scenes, NATIVE, settings.detector))
            training.train_backbone(
                *(frames, settings.detector, settings.training, seed, work),
                *(partial / BACKBONE, pretrained),
            )
            outcome = Outcome(views=len(frames[0].recorded), frames=len(frames))
        except GeoEvsError as failure:
            outcome = Outcome(reason=str(failure))
        outcome.write(partial)


def train_setting(
    scenes: Sequence[DetectionScene],
    setting: str,
    settings: DetectionSettings,
    seed: int,
    backbone: Path,
    work: Path,
    out: Path,
) -> None:
    """Train a detector in one setting; why there is none is written down.

    Args:
        scenes: to learn from.
        setting: of `settings_with`.
        settings: the config's section.
        seed: of the detector.
        backbone: the folder of `train_backbone`.
        work: holds what a killed training needs to go on.
        out: the folder to write, whole or not at all: Outcome, and WEIGHTS if all went well.
    """
    with new_folder(out) as partial, tempfile.TemporaryDirectory() as scratch:
        try:
            _refuse_failure(backbone, "backbone")
            fitting, weights = fitting_of(setting, settings), backbone / BACKBONE
            frames = _frames(scenes, setting, settings.detector)
            seen: list[RigFrame] | list[FeatureFrame] = (
                list(frames)
                if fitting.sees_pictures
                else _featured(frames, weights, settings.detector, Path(scratch))
            )
            places = (weights, settings.detector, fitting, seed, work, partial / WEIGHTS)
            seconds = training.train(seen, *places)
            outcome = Outcome(
                views=len(seen[0].recorded), frames=len(seen), training_seconds=seconds
            )
        except GeoEvsError as failure:
            outcome = Outcome(reason=str(failure))
        outcome.write(partial)


def fitting_of(setting: str, settings: DetectionSettings) -> Fitting:
    """How a detector learns in a setting."""
    fitting = settings.training
    if setting == LONGER:
        return dataclasses.replace(fitting, steps=round(settings.longer * fitting.steps))
    if setting == AUGMENTED:
        return dataclasses.replace(fitting, flip=True, jitter=True)
    return fitting


def _frames(
    scenes: Iterable[DetectionScene], setting: str, detector: Detector
) -> Iterator[RigFrame]:
    """All scenes' frames as a detector sees them, in its own size."""
    for scene in scenes:
        for frame in scene.frames(setting):
            yield frame.resized(detector.image)


def _featured(
    frames: Iterable[RigFrame], backbone: Path, detector: Detector, folder: Path
) -> list[FeatureFrame]:
    """Frames with features in the place of pictures, which stay on disk."""
    network, found = load_backbone(backbone).to(best_device()), []
    for number, frame in enumerate(frames):
        path = folder / f"{number:06d}.npz"
        features.cache_features(frame, network, detector.image, path)
        found.append(features.read_features(path))
    return found


def _check_labels(scenes: Sequence[DetectionScene], purpose: str) -> None:
    """Refuse scenes without any label that counts, and say why none does."""
    labels = pd.concat([scene.labels for scene in scenes], ignore_index=True)
    scored(labels, f"{len(scenes)} scenes to {purpose}")


def _refuse_failure(folder: Path, what: str) -> None:
    if reason := Outcome.read(folder).reason:
        raise GeoEvsError(f"its {what} failed: {reason}")


def find_settings(
    scenes: Sequence[DetectionScene], detectors: Mapping[str, Path], out: Path
) -> None:
    """Run the detectors of settings on the test scenes; why nothing can be found is written down.

    Args:
        scenes: to test on.
        detectors: by setting, the folder of `train_setting`.
        out: the folder to write, whole or not at all: for every setting a folder with Outcome, and
            FOUND if all went well.
    """
    with new_folder(out) as partial:
        for setting, detector in detectors.items():
            outcome, folder = Outcome.read(detector), partial / setting
            folder.mkdir()
            try:
                if not outcome.reason:
                    _check_labels(scenes, "test on")
                    outcome, found = _found(scenes, setting, detector, outcome)
                    write_parquet(folder / FOUND, found)
            except GeoEvsError as failure:
                outcome = dataclasses.replace(outcome, reason=str(failure))
            outcome.write(folder)


def _found(
    scenes: Sequence[DetectionScene], setting: str, detector: Path, trained: Outcome
) -> tuple[Outcome, pd.DataFrame]:
    """What a detector of a setting finds in the test scenes, and what that takes."""
    parts, seconds, views = [], 0.0, 0
    for scene in scenes:
        frames = list(scene.frames(setting))
        began = time.monotonic()
        parts.append(find(detector, frames))
        seconds += time.monotonic() - began
        views = max(views, *(len(frame.recorded) for frame in frames))
    count = sum(len(scene.store.frames) for scene in scenes)
    outcome = dataclasses.replace(
        trained,
        frames=count,
        views=views,
        detect_seconds=seconds / count,
        render_seconds=_render_seconds(scenes, setting) / count,
    )
    return outcome, pd.concat(parts, ignore_index=True)


def find(detector: Path, frames: Iterable[RigFrame]) -> pd.DataFrame:
    """Rows of PREDICTION_TYPES of what a detector finds in a scene's frames.

    Args:
        detector: the folder of `train_setting`.
        frames: of one scene or more, each in its order of time.
    """
    return detecting.detect(detector / WEIGHTS, list(frames), best_device())


def _render_seconds(scenes: Iterable[DetectionScene], setting: str) -> float:
    """What an entrant's views of all scenes took: its fits, and the median of a view, times them.

    Nothing of recorded views and of the truth.
    """
    label = views_label(setting)
    return 0.0 if label in (None, TRUTH) else sum(scene.view_seconds(label) for scene in scenes)
