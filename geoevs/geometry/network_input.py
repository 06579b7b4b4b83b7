"""What a public depth network is shown: pictures as its own loader makes them.

Such a network was trained on pictures of one width and of square pixels. A run squashes recorded
images to its own height and width, which scales fx and fy apart; the focal lengths therefore say
what was recorded.
"""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from geoevs.core.images import to_float, to_uint8
from geoevs.scenes.camera import Camera

Window = tuple[slice, slice]
"""Rows and columns of what the network is shown in which a view lies."""


def recorded_ratio(camera: Camera) -> float:
    """Height over width of the image that a camera recorded, whatever it was resized to.

    It is (height / fy) / (width / fx), the ratio at which pixels are square. Resizing does not
    change it.

    >>> recorded = Camera(np.diag([1970.0, 1970.0, 1.0]), np.eye(4), 1080, 1920)
    >>> recorded_ratio(recorded), recorded_ratio(recorded.resized(512, 512))
    (0.5625, 0.5625)
    """
    return float((camera.height / camera.K[1, 1]) / (camera.width / camera.K[0, 0]))


def public_size(camera: Camera, longest: int, patch: int) -> tuple[int, int]:
    """Height and width at which a camera's image is shown: its longer side is `longest` pixels.

    The shorter one keeps the recorded ratio, rounded to whole patches.

    >>> recorded = Camera(np.diag([1970.0, 1970.0, 1.0]), np.eye(4), 1080, 1920)
    >>> public_size(recorded.resized(512, 512), 518, 14)
    (294, 518)
    """
    ratio = recorded_ratio(camera)
    sides = (longest * min(1.0, ratio), longest * min(1.0, 1 / ratio))
    height, width = (patch * max(1, round(side / patch)) for side in sides)
    return height, width


def public_input(
    images: Sequence[np.ndarray],  # each [H, W, 3] uint8, or float in [0, 1]
    cameras: Sequence[Camera],
    longest: int,
    patch: int,
) -> tuple[np.ndarray, list[Window]]:
    """The views of a frame as VGGT's loader (`load_fn.py`) makes them, from a run's images.

    Each is resized to `public_size` by bicubic interpolation and lies in the middle of white: all
    are as wide as `longest`, and as high as the highest. A view that is higher than wide is
    padded, as by the loader's mode `pad`; its mode `crop` would leave pixels without depth.

    Args:
        images: a frame's views, at the run's resolution.
        cameras: theirs.
        longest: pixels of the longer side.
        patch: pixels a side of the network's patches.

    Returns:
        (V, h, w, 3) in the images' own type, and where each view lies in it.
    """
    sizes = [public_size(camera, longest, patch) for camera in cameras]
    rows, columns = max(height for height, _ in sizes), patch * round(longest / patch)
    shown = np.full((len(images), rows, columns, 3), 255, np.uint8)
    windows = []
    for canvas, image, (height, width) in zip(shown, images, sizes, strict=True):
        top, left = (rows - height) // 2, (columns - width) // 2
        window = slice(top, top + height), slice(left, left + width)
        pixels = Image.fromarray(to_uint8(image))
        canvas[window] = np.asarray(pixels.resize((width, height), Image.Resampling.BICUBIC))
        windows.append(window)
    return (shown if images[0].dtype == np.uint8 else to_float(shown)), windows
