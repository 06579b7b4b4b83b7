"""Boxes of frames, by a trained detector that remembers the frames before."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from geoevs.detection.bevformer.boxes import decoded
from geoevs.detection.bevformer.decoder import Found
from geoevs.detection.bevformer.features import check_features
from geoevs.detection.bevformer.inputs import FeatureFrame, RigFrame, in_scenes
from geoevs.detection.bevformer.network import Memory, load_bevformer
from geoevs.detection.bevformer.settings import Detector
from geoevs.detection.rows import BOX, PREDICTION_TYPES


@torch.inference_mode()
def detect(
    weights: Path,
    frames: Sequence[RigFrame] | Sequence[FeatureFrame],
    device: str | None = None,
) -> pd.DataFrame:
    """What a detector finds in frames, of all scenes one after the other.

    A scene's frames are looked at in their order, each with the BEV of the one before; scenes begin
    without one, and so does every frame where the detector has no history. The best of all queries
    and classes are told, without any suppression of their neighbours.

    Args:
        weights: what `train` wrote.
        frames: with any number of views each.
        device: where; None: the CPU.

    Returns:
        Rows of `geoevs.detection.rows.PREDICTION_TYPES`, by falling score in every frame.

    Raises:
        GeoEvsError: the file is no detector, frames are not ordered in time, or their features are
            another backbone's.
    """
    model = load_bevformer(weights).to(device or "cpu")
    check_features(frames, model.backbone)
    parts = [_empty()]
    for places in in_scenes(frames).values():
        memory = None
        for place in places:
            frame = frames[place]
            bev = model.bev([frame], [memory])
            if model.detector.history:
                memory = Memory(frame, bev[0])
            boxes, classes, scores = found_boxes(model.decoder(bev), model.detector)[0]
            rows = pd.DataFrame(boxes, columns=list(BOX))
            parts.append(
                rows.assign(
                    **{"scene": frame.scene, "frame": frame.frame, "score": scores, "ignored": 0},
                    **{"class": np.array(model.classes, object)[classes]},
                )
            )
    return pd.concat(parts, ignore_index=True)[list(PREDICTION_TYPES)].astype(PREDICTION_TYPES)


def _empty() -> pd.DataFrame:
    return pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in PREDICTION_TYPES.items()})


def found_boxes(
    found: Found, detector: Detector
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """What the last layer finds in every item: the best pairs of a query and a class.

    Centres lie within the detector's range, because that is what a query can say.

    Returns:
        For each: (P, 7) float64 boxes, (P,) int64 classes, (P,) float64 scores, falling.
    """
    told = []
    for logits, codes in zip(found.logits[-1], found.codes[-1], strict=True):
        scores = logits.float().sigmoid().flatten().cpu().numpy().astype(np.float64)
        best = np.argsort(-scores, kind="stable")[: detector.predictions]
        query, kind = np.divmod(best, logits.shape[-1])
        told.append((decoded(codes.float().cpu().numpy()[query]), kind, scores[best]))
    return told
