"""What a detector is to find, and how wrong it is: Hungarian matching, focal and L1 losses."""

from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor
from torch.nn import functional

from geoevs.detection.bevformer.boxes import encoded
from geoevs.detection.bevformer.decoder import Found
from geoevs.detection.bevformer.encoder import Grid
from geoevs.detection.bevformer.settings import Detector
from geoevs.detection.labels import inside

CLASS, BOX, HEAT = 2.0, 0.25, 1.0
"""Weights of the losses, and of the costs of a match where it has them."""

ALPHA, GAMMA = 0.25, 2.0
"""Of the focal loss (Lin et al., ICCV 2017)."""

SPREAD = 0.8
"""Cells: the standard deviation of a centre on the heat map."""


class Wanted(NamedTuple):
    """What a detector is to find in one frame."""

    classes: Tensor  # [M] int64
    codes: Tensor  # [M, 8] (see `boxes`)
    heat: Tensor  # [K, rows, columns] in [0, 1]


def wanted(
    boxes: np.ndarray,  # [M, 7]
    classes: np.ndarray,  # [M]
    detector: Detector,
    count: int,
    device: torch.device,
) -> Wanted:
    """What a detector of `count` classes is to find: the boxes within its range."""
    kept = inside(boxes, detector.range)
    boxes, classes = boxes[kept], classes[kept]
    grid = Grid(detector)
    rows, columns = grid.size
    heat = np.zeros((count, rows, columns), np.float32)
    places = (boxes[:, :2] - grid.low[:2]) / grid.extent[:2] * (columns, rows) - 0.5
    for (x, y), kind in zip(places, classes, strict=True):
        square = (np.arange(rows)[:, None] - y) ** 2 + (np.arange(columns) - x) ** 2
        # The cell that holds a centre has the whole of it, as in CenterNet.
        square[int(np.clip(round(y), 0, rows - 1)), int(np.clip(round(x), 0, columns - 1))] = 0
        np.maximum(heat[kind], np.exp(-square / (2 * SPREAD**2)), out=heat[kind])
    return Wanted(
        torch.from_numpy(classes.astype(np.int64)).to(device),
        torch.from_numpy(encoded(boxes).astype(np.float32)).to(device),
        torch.from_numpy(heat).to(device),
    )


def match(
    logits: Tensor,  # [N, K]
    codes: Tensor,  # [N, 8]
    target: Wanted,
) -> tuple[Tensor, Tensor]:
    """Pairs of queries and of what they are to find, of the least focal and L1 cost.

    Returns:
        Two (min(N, M),) int64: which query, and which box.
    """
    with torch.no_grad():
        p = logits.sigmoid()[:, target.classes]
        found = ALPHA * (1 - p) ** GAMMA * -(p + 1e-8).log()
        empty = (1 - ALPHA) * p**GAMMA * -(1 - p + 1e-8).log()
        cost = CLASS * (found - empty) + BOX * torch.cdist(codes, target.codes, p=1)
        # A loss that is no number shall stop the training, not the matching before it.
        pairs = linear_sum_assignment(
            cost.nan_to_num(nan=1e6, posinf=1e6, neginf=-1e6).cpu().numpy()
        )
    query, box = (torch.from_numpy(one).to(logits.device) for one in pairs)
    return query, box


def focal_loss(logits: Tensor, truth: Tensor) -> Tensor:
    """Sum over all logits of -a (1 - p)^gamma log p, p being the probability of the truth."""
    entropy = functional.binary_cross_entropy_with_logits(logits, truth, reduction="none")
    p = logits.sigmoid()
    missed = p + truth - 2 * p * truth
    alpha = ALPHA * truth + (1 - ALPHA) * (1 - truth)
    return (alpha * missed**GAMMA * entropy).sum()


def heat_loss(logits: Tensor, truth: Tensor) -> Tensor:
    """The focal loss of CenterNet (Zhou et al., 2019), summed: near a centre, less is wrong."""
    p, found = logits.sigmoid(), truth == 1
    hit = (1 - p) ** 2 * functional.logsigmoid(logits)
    empty = (1 - truth) ** 4 * p**2 * functional.logsigmoid(-logits)
    return -torch.where(found, hit, empty).sum()


def detection_losses(found: Found, heat: Tensor, targets: list[Wanted]) -> dict[str, Tensor]:
    """Losses of a batch: all layers' classes and boxes, and the heat map, a box.

    Args:
        found: by the decoder.
        heat: (B, K, rows, columns) logits.
        targets: of every item.
    """
    boxes = max(1, sum(len(target.classes) for target in targets))
    classes, places = found.logits.new_zeros(()), found.codes.new_zeros(())
    for logits, codes in zip(found.logits, found.codes, strict=True):
        for item, target in enumerate(targets):
            query, box = match(logits[item], codes[item], target)
            truth = torch.zeros_like(logits[item])
            truth[query, target.classes[box]] = 1
            classes = classes + focal_loss(logits[item], truth)
            places = places + (codes[item][query] - target.codes[box]).abs().sum()
    losses = {
        "classes": CLASS * classes / boxes,
        "boxes": BOX * places / boxes,
        "heat": HEAT * heat_loss(heat, torch.stack([target.heat for target in targets])) / boxes,
    }
    return {"loss": sum(losses.values()), **losses}
