"""What detectors of every setting found, and what became of them."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from geoevs import layout
from geoevs.detection.outcomes import Outcome
from geoevs.detection.rows import PREDICTION_TYPES, read_predictions
from geoevs.detection.training_settings import NATIVE

FOUND = "predictions.parquet"
"""What a detector found, in the folder of its predictions."""


def outcomes_of(
    run: Path, settings: Sequence[str], seeds: Sequence[int]
) -> dict[tuple[str, int], Outcome]:
    """How each setting and seed ended, in this order."""
    return {
        (setting, seed): Outcome.read(run / layout.PREDICTIONS.format(seed=seed) / setting)
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
        setting: run / layout.PREDICTIONS.format(seed=seed) / setting for setting in settings
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
