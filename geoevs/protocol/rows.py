"""The tidy rows from which every table, CSV and chart derives, and their checks."""

import dataclasses
import hashlib
import json
from typing import Any

import pandas as pd

from geoevs import PROTOCOL
from geoevs.core.errors import GeoEvsError
from geoevs.projection import FOOTPRINT_RADIUS, FOOTPRINT_TOLERANCE
from geoevs.protocol.metrics import METRICS, SSIM_MIN_EFFECTIVE_PIXELS, SSIM_RADIUS, SSIM_SIGMA
from geoevs.protocol.targets import without_usual
from geoevs.scenes.store import Scene

SCORE_TYPES = {
    "dataset": "string",
    "scene": "string",
    "frame": "int64",
    "target": "string",
    "split": "string",
    "method": "string",
    "variant": "string",
    "seed": "int64",
    "metric": "string",
    "value": "float64",
    "valid_pixels": "int64",
    "support_ratio": "float64",
    "pose_offset": "float64",
    "lateral_shift": "float64",
    "stressor": "string",
    "level": "float64",
    "status": "string",
    "stage": "string",
    "reason": "string",
    "log": "string",
    "fingerprint": "string",
}
COST_TYPES = {
    "dataset": "string",
    "scene": "string",
    "method": "string",
    "variant": "string",
    "seed": "int64",
    "sources": "string",
    "fit_seconds": "float64",
    "training_seconds": "float64",
    "load_seconds": "float64",
    "warm_up_seconds": "float64",
    "render_seconds": "float64",
    "peak_memory": "int64",
    "gpu_memory": "int64",
    "primitives": "int64",
    "parameters": "int64",
    "bytes": "int64",
    "device": "string",
    "threads": "int64",
    "host": "string",
    "cpu": "string",
    "note": "string",
    "status": "string",
    "stage": "string",
    "reason": "string",
    "log": "string",
}


def score_frame(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Score rows as a typed table."""
    return pd.DataFrame(rows, columns=list(SCORE_TYPES)).astype(SCORE_TYPES)


def cost_frame(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Cost rows as a typed table."""
    return pd.DataFrame(rows, columns=list(COST_TYPES)).astype(COST_TYPES)


def protocol_fingerprint(scene: Scene, protocol: dict[str, Any]) -> str:
    """Hash of all that must agree before the scores of two scenes may be put together.

    The version of the protocol stands for what a hash of settings does not see.

    Args:
        scene: gives resolution, cameras and rig.
        protocol: the config's section of that name.
    """
    first = scene.camera(scene.cameras[0], scene.frames[0])
    described = {
        "version": PROTOCOL,
        "resolution": [first.height, first.width],
        "cameras": scene.cameras,
        "rig": dataclasses.asdict(scene.info.rig),
        "protocol": without_usual(protocol),
        "metrics": {name: [spec.kind.__name__, spec.region] for name, spec in METRICS.items()},
        "ssim": [SSIM_RADIUS, SSIM_SIGMA, SSIM_MIN_EFFECTIVE_PIXELS],
        "footprint": [FOOTPRINT_RADIUS, FOOTPRINT_TOLERANCE],
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:16]


def check_fingerprints(rows: pd.DataFrame) -> None:
    """Refuse rows of one dataset that were measured under different protocols.

    Raises:
        GeoEvsError: they were; the sentence names the dataset and the fingerprints.
    """
    for dataset, fingerprints in rows.groupby("dataset")["fingerprint"].unique().items():
        if len(fingerprints) > 1:
            raise GeoEvsError(
                f"scores of dataset '{dataset}' come from different protocols "
                f"({', '.join(sorted(fingerprints))}); rerun `snakemake scores` so that they agree"
            )
