"""Errors along the line of sight, and boxes without them (LET-3D-AP, sections 3.2 and 3.3).

P and G are the centres of a prediction and a truth, seen from the sensor.
"""

import numpy as np

from geoevs.detection.rules import Tolerance

LEAST = 1e-6
"""What lengths, and squares of lengths, are at least where they divide."""


def affinities(
    predictions: np.ndarray,  # [N, 7] or [N, 3]
    truths: np.ndarray,  # [M, 7] or [M, 3]
    tolerance: Tolerance,
) -> np.ndarray:
    """(N, M) float64 in [0, 1]: how well the distances of two centres agree.

    1 - |P.G / |G| - |G|| / max(share |G|, minimum): only the error along the line of sight counts.
    """
    seen, true = _from_sensor(predictions, tolerance), _from_sensor(truths, tolerance)
    distance = np.maximum(np.linalg.norm(true, axis=1), LEAST)
    error = np.abs(seen @ true.T / distance - distance)
    return np.clip(1 - error / np.maximum(tolerance.share * distance, tolerance.minimum), 0, 1)


def aligned(
    predictions: np.ndarray,  # [N, 7]
    truths: np.ndarray,  # [M, 7]
    tolerance: Tolerance,
) -> np.ndarray:
    """(N, M, 7): every prediction moved along its own line of sight to nearest every truth.

    P' = (P.G / |P|^2) P; size and heading stay.
    """
    seen, true = _from_sensor(predictions, tolerance), _from_sensor(truths, tolerance)
    scale = seen @ true.T / np.maximum((seen**2).sum(axis=1), LEAST)[:, None]
    moved = np.repeat(predictions[:, None], len(truths), axis=1)
    moved[..., :3] = scale[..., None] * seen[:, None] + tolerance.sensor
    return moved


def _from_sensor(boxes: np.ndarray, tolerance: Tolerance) -> np.ndarray:
    return boxes[:, :3] - np.array(tolerance.sensor)
