"""Whether distances of pictures rise with every grade of a known harm: rows of the audit."""

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np

from geoevs.core.randomness import Rng
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.set_metrics import SET_METRICS, SetMetric, real_floor, standardise
from geoevs.run import Answers

HOLE = 8
"""Pixels of a hole's side."""
MOST_FRAMES = 4
"""Frames of a scene whose pictures are harmed."""


def blur(image: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Gaussian blur of an (H, W, 3) image; sigma in pixels."""
    return cv2.GaussianBlur(image, (0, 0), sigma)


def noise(image: np.ndarray, deviation: float, rng: np.random.Generator) -> np.ndarray:
    """Gaussian noise on an (H, W, 3) image in [0, 1], clipped."""
    noisy = image + deviation * rng.standard_normal(image.shape, np.float32)
    return np.clip(noisy, 0, 1, dtype=np.float32)


def holes(image: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Black squares on about a share of an (H, W, 3) image, a larger share over a smaller one."""
    height, width = (-(-side // HOLE) for side in image.shape[:2])
    keep = np.kron(rng.random((height, width)) >= share, np.ones((HOLE, HOLE), bool))
    return image * keep[: image.shape[0], : image.shape[1], None]


HARMS: dict[str, tuple[Callable[..., np.ndarray], tuple[float, ...]]] = {
    "blur": (blur, (0.5, 1, 2, 4)),
    "noise": (noise, (0.02, 0.05, 0.1, 0.2)),
    "holes": (holes, (0.05, 0.1, 0.2, 0.4)),
}
"""What is done to pictures, and its grades from slight to strong."""


def harmed(images: list[np.ndarray], harm: str, grade: float, seed: int) -> list[np.ndarray]:
    """(H, W, 3) images with a grade of a harm; what is random is the same for all grades."""
    apply, _ = HARMS[harm]
    return [
        apply(image, grade, Rng(seed, "harm", harm, str(number)).numpy)
        for number, image in enumerate(images)
    ]


def harm_rows(answers: Answers, seed: int) -> Iterator[dict[str, Any]]:
    """Rows of a scene's recorded pictures under every grade of every harm, as AUDIT_TYPES says.

    `target` is the harm, `share` its grade, `value` the distance of harmed pictures from what they
    were, and `dense` the distance of one instant from another. A set's instants are alternate
    frames; a view's distance is to its camera's next picture. Distances whose weights are not on
    this machine have no rows.
    """
    scene = answers.scene
    frames = scene.frames[:: -(-len(scene.frames) // MOST_FRAMES)]
    views = [(name, frame) for frame in frames for name in scene.cameras]
    images = [scene.image(*view) for view in views]
    labels = np.array([frame for _, frame in views])
    floors = _floors(images, labels, len(scene.cameras))
    for harm, (_, grades) in HARMS.items():
        for grade in grades:
            pictures = harmed(images, harm, grade, seed)
            for name, value in distances(pictures, images, labels).items():
                yield {
                    "part": "harm",
                    "metric": name,
                    "target": harm,
                    "frame": frames[0],
                    "share": float(grade),
                    "support_ratio": 1.0,
                    "pixels": sum(image[..., 0].size for image in images),
                    "value": value,
                    "dense": floors[name],
                }


def distances(
    pictures: list[np.ndarray], images: list[np.ndarray], frames: np.ndarray
) -> dict[str, float]:
    """Distances of pictures from images, by their names: those that this machine can compute.

    Args:
        pictures: (H, W, 3) each.
        images: what they should look like.
        frames: the frame of each.
    """
    found = {}
    for name, metric in _measured().items():
        preds, true = (
            np.array([metric.features(one) for one in some]) for some in (pictures, images)
        )
        if metric.standardised:
            preds, true = standardise(preds, true), standardise(true, true)
        found[name] = metric.distance(preds, true, frames, 0.5).value
    return found | _means(pictures, images)


def _floors(images: list[np.ndarray], frames: np.ndarray, cameras: int) -> dict[str, float]:
    """Distances of one instant from another, by name."""
    found = {}
    for name, metric in _measured().items():
        true = np.array([metric.features(image) for image in images])
        true = standardise(true, true) if metric.standardised else true
        found[name] = real_floor(metric, true, frames)
    return found | _means(images[cameras:], images[:-cameras])


def _measured() -> dict[str, SetMetric]:
    return {name: metric for name, metric in SET_METRICS.items() if not metric.missing()}


def _means(pictures: list[np.ndarray], images: list[np.ndarray]) -> dict[str, float]:
    """Mean distances of views by the metrics that share features with those of sets."""
    found = {}
    for name, spec in METRICS.items():
        if spec.with_sets and not spec.kind.missing():
            metric = spec.kind()
            for pair in zip(pictures, images, strict=True):
                metric.update(*pair, np.ones(pair[0].shape[:2], bool))
            found[name] = metric.compute()
    return found
