"""What was predicted in one frame, and what was there."""

from dataclasses import dataclass

import numpy as np

from geoevs.core.errors import GeoEvsError


@dataclass(frozen=True)
class Predictions:
    """The boxes that a detector reports.

    Args:
        boxes: (N, 7) float64, in the vehicle's frame (see `geoevs.detection.iou`).
        classes: (N,) places in CLASSES.
        scores: (N,) in [0, 1]; they are compared with cutoffs as float32.
        ignored: (N,) bool, those that are no false positives where nothing matches, since they
            overlap with a zone without labels.

    Raises:
        GeoEvsError: lengths differ.
    """

    boxes: np.ndarray
    classes: np.ndarray
    scores: np.ndarray
    ignored: np.ndarray

    def __post_init__(self) -> None:
        _check_lengths(self.boxes, self.classes, self.scores, self.ignored)

    def __len__(self) -> int:
        return len(self.boxes)

    def ordered(self) -> "Predictions":
        """The same by falling score, and among equal scores by what they are."""
        keys = (self.ignored, *self.boxes.T, self.classes, -np.float32(self.scores))
        return self.take(np.lexsort(keys))

    def take(self, which: np.ndarray) -> "Predictions":
        """Those that an index or a mask picks."""
        return Predictions(
            self.boxes[which], self.classes[which], self.scores[which], self.ignored[which]
        )


@dataclass(frozen=True)
class Truths:
    """The labelled boxes that count.

    Args:
        boxes: (M, 7) float64, in the vehicle's frame.
        classes: (M,) places in CLASSES.
        levels: (M,) LEVEL_1 or LEVEL_2.
        cameras: (M,) text, which camera sees each best, by its name in CAMERAS.

    Raises:
        GeoEvsError: lengths differ.
    """

    boxes: np.ndarray
    classes: np.ndarray
    levels: np.ndarray
    cameras: np.ndarray

    def __post_init__(self) -> None:
        _check_lengths(self.boxes, self.classes, self.levels, self.cameras)

    def __len__(self) -> int:
        return len(self.boxes)

    def ordered(self) -> "Truths":
        """The same in an order that follows from what they are."""
        keys = (np.asarray(self.cameras, str), self.levels, *self.boxes.T, self.classes)
        return self.take(np.lexsort(keys))

    def take(self, which: np.ndarray) -> "Truths":
        """Those that an index or a mask picks."""
        return Truths(
            self.boxes[which], self.classes[which], self.levels[which], self.cameras[which]
        )


def _check_lengths(boxes: np.ndarray, *others: np.ndarray) -> None:
    if boxes.shape != (len(boxes), 7) or any(np.shape(other) != (len(boxes),) for other in others):
        shapes = ", ".join(str(np.shape(array)) for array in (boxes, *others))
        raise GeoEvsError(
            f"boxes and what is said of them have the shapes {shapes}; give (N, 7) and (N,) each"
        )
