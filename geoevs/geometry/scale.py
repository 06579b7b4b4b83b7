"""Fitting the scale of predicted depth to sparse LiDAR (section 3.2)."""

from collections.abc import Iterable

import numpy as np

from geoevs.geometry.lidar import lidar_reach, nearest
from geoevs.scenes.camera import Camera

# Distances are tangents (pixels over focal length), so that nothing depends on the resolution.
# Values were chosen on true depth of procedural streets, distorted smoothly and by depth.

# A factor of e in predicted depth keeps pixels as far apart as this distance in the image: an
# object's correction stays on the object.
DEPTH_REACH = 1.0
# A LiDAR pixel at this distance weighs as much as the factor of the whole frame.
PRIOR_REACH = 0.2
NEIGHBOURS = 8
# Distance below which LiDAR decides alone, far less than a pixel.
AT_LIDAR = 1e-6


def frame_factor(
    pairs: Iterable[tuple[np.ndarray, np.ndarray]],  # each [H, W] and [H, W], 0 = none
) -> float:
    """The median LiDAR / predicted depth over all views of a frame, or 1 where there is no LiDAR.

    Args:
        pairs: each view's predicted depth, and the depth of its LiDAR pixels.
    """
    logs = [
        np.log(lidar[both]) - np.log(depth[both], dtype=np.float64)
        for depth, lidar in pairs
        if (both := (depth > 0) & (lidar > 0)).any()
    ]
    return float(np.exp(np.median(np.concatenate(logs)))) if logs else 1.0


def fit_scale(
    depth: np.ndarray,  # [H, W] predicted, 0 = none
    confidence: np.ndarray | None,  # [H, W] positive
    lidar_depth: np.ndarray,  # [H, W] metres, 0 = none
    camera: Camera,
    factor: float,
) -> np.ndarray:
    """Multiply predicted depth by a smooth field that LiDAR gives.

    A network's depth is right in shape but drifts in scale, and not by one factor: roads, objects
    and the far differ. The logarithm of the factor at a pixel is the average of log(LiDAR /
    predicted) over the nearest LiDAR pixels, near in the image and in predicted depth, weighted by
    inverse squared distance and by the prediction's confidence there, together with the frame's
    factor. It is the LiDAR's own at LiDAR pixels, and the frame's far from all of them or where
    LiDAR does not reach (`lidar_reach`).

    Args:
        depth: what was predicted, in any unit.
        confidence: of the prediction, in any unit; None weighs all LiDAR pixels alike.
        lidar_depth: depth of the points that are visible in the view.
        camera: the view; only its focal lengths count.
        factor: of the whole frame (see `frame_factor`).

    Returns:
        (H, W) float32 metres, 0 where `depth` is.
    """
    known = depth > 0
    sampled = known & (lidar_depth > 0)
    if not sampled.any():
        return (depth * factor).astype(np.float32)
    log_depth = np.log(depth[known], dtype=np.float64)
    rows, columns = np.nonzero(known)
    places = np.column_stack(
        [columns / camera.K[0, 0], rows / camera.K[1, 1], DEPTH_REACH * log_depth]
    )
    samples = sampled[known]
    ratios = np.log(lidar_depth[sampled], dtype=np.float64) - log_depth[samples]
    gains = np.ones(len(ratios)) if confidence is None else confidence[sampled]
    gains = gains / gains.mean()

    distance, index = nearest(places[samples], places, NEIGHBOURS)
    weights = gains[index] * (PRIOR_REACH / np.maximum(distance, AT_LIDAR)) ** 2
    prior = np.log(factor)
    local = (weights * (ratios[index] - prior)).sum(axis=1) / (1 + weights.sum(axis=1))
    shift = prior + lidar_reach(lidar_depth > 0, camera)[known] * local
    fitted = np.zeros(depth.shape, np.float32)
    fitted[known] = np.exp(log_depth + shift)
    return fitted
