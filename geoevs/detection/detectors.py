"""Detectors of every setting: trained, run on test scenes, and what became of it."""

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_folder
from geoevs.core.parquet import write_parquet
from geoevs.detection.bevformer.inputs import RigFrame
from geoevs.detection.bevformer.settings import Fitting
from geoevs.detection.labels import scored
from geoevs.detection.outcomes import Outcome
from geoevs.detection.rigs import DetectionScene
from geoevs.detection.rows import PREDICTION_TYPES, read_predictions
from geoevs.detection.settings import DetectionSettings
from geoevs.detection.training_settings import AUGMENTED, BLIND, LONGER, NATIVE, views_label
from geoevs.protocol.entries import TRUTH, read_outcomes
from geoevs.protocol.targets import ALL_CAMERAS

FOUND = "predictions.parquet"
"""What a detector found, in the folder of its predictions."""


def outcomes_of(
    run: Path, settings: Sequence[str], seeds: Sequence[int]
) -> dict[tuple[str, int], Outcome]:
    """How each setting and seed ended, in this order."""
    return {
        (setting, seed): Outcome.read(run / layout.PREDICTIONS.format(setting=setting, seed=seed))
        for setting in settings
        for seed in seeds
    }


def read_found(folder: Path) -> pd.DataFrame:
    """Rows of PREDICTION_TYPES of a folder of predictions; none where the detector failed.

    Raises:
        GeoEvsError: they are missing, damaged, or no predictions.
    """
    if Outcome.read(folder).reason:
        return pd.DataFrame(
            {name: pd.Series(dtype=kind) for name, kind in PREDICTION_TYPES.items()}
        )
    return read_predictions(folder / FOUND)


def found_by(run: Path, settings: Sequence[str], seed: int) -> dict[str, pd.DataFrame]:
    """What detectors of one seed found, by setting; those that failed are left out."""
    folders = {
        setting: run / layout.PREDICTIONS.format(setting=setting, seed=seed) for setting in settings
    }
    return {
        setting: read_found(folder)
        for setting, folder in folders.items()
        if not Outcome.read(folder).reason
    }


def detectors_of(run: Path, seeds: Sequence[int]) -> dict[int, Path | str]:
    """By seed, the folder of the detector of the recorded views, or why there is none."""
    folders = {seed: run / layout.DETECTOR.format(setting=NATIVE, seed=seed) for seed in seeds}
    return {seed: Outcome.read(folder).reason or folder for seed, folder in folders.items()}


BACKBONE, WEIGHTS = "backbone.safetensors", "detector.safetensors"
"""Networks, in the folders of a backbone and of a detector."""


def train_backbone(
    scenes: Sequence[DetectionScene], settings: DetectionSettings, seed: int, work: Path, out: Path
) -> None:
    """Train what turns pictures into features, on the recorded views of scenes.

    Detectors of all settings share it, so that they differ in their pictures alone.

    Args:
        scenes: to learn from.
        settings: the config's section.
        seed: of the detectors that will take it.
        work: holds what a killed training needs to go on.
        out: the folder to write, whole or not at all; BACKBONE lies in it.
    """
    from geoevs.detection.bevformer import features

    _check_labels(scenes)
    frames = frames_of(scenes, NATIVE, settings.detector)
    with new_folder(out) as partial:
        features.train_backbone(
            frames, settings.detector, settings.training, seed, work, partial / BACKBONE
        )


def train_setting(
    scenes: Sequence[DetectionScene],
    setting: str,
    settings: DetectionSettings,
    seed: int,
    backbone: Path,
    work: Path,
    out: Path,
) -> None:
    """Train a detector in one setting; what it could not be trained for is written down.

    Args:
        scenes: to learn from.
        setting: of `settings_with`.
        settings: the config's section.
        seed: of the detector.
        backbone: the folder of `train_backbone`.
        work: holds what a killed training needs to go on.
        out: the folder to write, whole or not at all: Outcome, and WEIGHTS if all went well.
    """
    from geoevs.detection.bevformer import features, training

    fitting, detector = fitting_of(setting, settings), settings.detector
    weights = backbone / BACKBONE
    with new_folder(out) as partial:
        try:
            _check_labels(scenes)
            frames = frames_of(scenes, setting, detector)
            if not fitting.sees_pictures:
                frames = features.cache_features(frames, weights, work)
            began = time.monotonic()
            training.train(
                frames, weights, detector, fitting, seed, work, partial / WEIGHTS
            )
            outcome = Outcome(
                views=len(frames[0].recorded),
                frames=len(frames),
                training_seconds=time.monotonic() - began,
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
