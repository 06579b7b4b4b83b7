"""Random boxes that hide parts of a condition map: what artifact masks are compared with."""

import numpy as np

MOST_BOXES = 4
# Random Erasing (Zhong et al., AAAI 2020) hides one box of 2 to 40 % of the image whose aspect
# ratio lies between 0.3 and 1 / 0.3. Here up to four boxes overlap, so each takes at most half.
AREAS = (0.02, 0.2)
ASPECTS = (0.3, 1 / 0.3)
HALVINGS = 40  # of the scale's range; few enough to be fast, and edges rarely move together


def random_boxes(rng: np.random.Generator, height: int, width: int, hidden: float) -> np.ndarray:
    """Boxes at random places that together hide a wanted share of the pixels.

    Places and relative sizes are drawn first; one scale then grows all boxes until their union in
    the frame is as near to the share as whole rows and columns allow.

    Args:
        rng: draws the boxes.
        height: of the mask, in pixels.
        width: likewise.
        hidden: the share to hide, in [0, 1].

    Returns:
        (H, W) bool, False where hidden; the share is met within half a row or column of pixels.
    """
    count = rng.integers(1, MOST_BOXES + 1)
    sizes = _sizes(rng, height, width, count)
    centres = rng.uniform(size=(count, 2)) * (height, width)
    target = hidden * height * width
    few, many = 0.0, 2 * np.max([height, width] / sizes[0])  # at which the first box hides all
    for _ in range(HALVINGS):
        scale = (few + many) / 2
        if _area(_outside(centres, scale * sizes, height, width)) < target:
            few = scale
        else:
            many = scale
    masks = [_outside(centres, scale * sizes, height, width) for scale in (few, many)]
    return min(masks, key=lambda keep: abs(_area(keep) - target))


def random_erasing(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """(H, W) bool, False where hidden: one to four boxes within the frame, of any area.

    Areas are uniform in AREAS, aspect ratios log-uniform in ASPECTS.
    """
    count = rng.integers(1, MOST_BOXES + 1)
    sizes = np.minimum(_sizes(rng, height, width, count), (height, width))
    centres = sizes / 2 + rng.uniform(size=(count, 2)) * ((height, width) - sizes)
    return _outside(centres, sizes, height, width)


def _sizes(rng: np.random.Generator, height: int, width: int, count: int) -> np.ndarray:
    """(count, 2) heights and widths in pixels."""
    area = rng.uniform(*AREAS, count) * height * width
    aspect = np.exp(rng.uniform(*np.log(ASPECTS), count))
    return np.sqrt(np.stack([area * aspect, area / aspect], axis=1))


def _outside(
    centres: np.ndarray,  # [B, 2] rows and columns
    sizes: np.ndarray,  # [B, 2]
    height: int,
    width: int,
) -> np.ndarray:
    """(H, W) bool: the pixels in none of the boxes."""
    ends = np.rint([centres - sizes / 2, centres + sizes / 2]).clip(0, (height, width)).astype(int)
    keep = np.ones((height, width), bool)
    for (top, left), (bottom, right) in ends.swapaxes(0, 1):
        keep[top:bottom, left:right] = False
    return keep


def _area(keep: np.ndarray) -> int:
    """The number of hidden pixels."""
    return keep.size - np.count_nonzero(keep)
