"""Score rows by hand, and a run's folder of the tiny scene."""

import math

import numpy as np
import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.images import write_image
from geoevs.methods.tiny import write_tiny_scene
from geoevs.protocol.condition_masks import RawReprojection, make_condition_masks
from geoevs.protocol.records import write_records
from geoevs.protocol.reference import make_references
from geoevs.protocol.rows import SCORE_TYPES, score_frame
from geoevs.protocol.targets import make_targets, write_targets

PLACE = {"dataset": "d", "scene": "s"}
PROTOCOL = {
    "lateral": [-1.0, 1.0],
    "pose_sweep": {"angles": [10.0, 20.0], "every": 2},
    "masked": {"yaw": [15.0, 20.0], "lateral": [-2.0, 2.0], "every": 2},
}


@pytest.fixture
def rows():
    """Makes score rows; what is not said is an extrapolation row of one frame that went well."""

    def make(*changes: dict) -> pd.DataFrame:
        blank = {"string": "", "int64": 0, "float64": math.nan}
        usual = {name: blank[kind] for name, kind in SCORE_TYPES.items()} | {
            **PLACE,
            **{"split": "extrapolation", "method": "mine", "variant": "default"},
            **{"metric": "sparse_psnr", "value": 20.0, "status": "ok", "fingerprint": "f"},
            **{"support_ratio": 0.01, "pose_offset": 1.0, "lateral_shift": 0.0, "target": "t"},
        }
        return score_frame([{**usual, **change} for change in changes])

    return make


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """A run with the tiny scene and grey renders of `grey`; without truth."""
    folder = tmp_path_factory.mktemp("run")
    store = write_tiny_scene(folder / layout.SCENE.format(**PLACE))
    targets = make_targets(store, PROTOCOL, seed=0)
    write_targets(folder / layout.TARGETS.format(**PLACE), targets)
    reprojection = RawReprojection(store)
    references = make_references(store, targets, reprojection, seed=0)
    write_records(folder / layout.REFERENCES.format(**PLACE), references)
    write_records(
        folder / layout.MASKS.format(**PLACE), make_condition_masks(targets, reprojection)
    )
    renders = folder / layout.RENDERS.format(label="grey", **PLACE)
    for target in targets:
        write_image(renders / f"{target.key}.png", np.full((48, 72, 3), 99, np.uint8))
    return folder
