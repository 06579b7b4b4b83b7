"""Which pixels show the sky, told from one image and its LiDAR points without any network."""

import cv2
import numpy as np

from geoevs.projection import zbuffer
from geoevs.scenes.camera import Camera

SMOOTH = 3.0 / 255  # most that a pixel of the sky differs from its neighbours
SMALLEST = 0.003  # share of the image that a patch of sky has at least
REACH = 0.02  # share of the image's height around a LiDAR point that is no sky
BRIGHT = 0.75  # share of all that cannot be sky which a patch of it is brighter than
WALL = 30.0  # metres: what rises above the camera nearer than this is taken to go on upwards


def find_sky(
    image: np.ndarray,  # [H, W, 3] float in [0, 1]
    points: np.ndarray,  # [N, 3]
    camera: Camera,
) -> np.ndarray:
    """(H, W) bool: smooth patches without LiDAR points that reach the image's top and are bright.

    A stand-in for the segmentation networks of published methods. It rather misses sky than
    calls a wall sky.
    """
    shape = camera.height, camera.width
    wide = 2 * round(REACH * camera.height) + 1
    index, depth = zbuffer(points, camera)
    hit = index >= 0
    high = points[np.where(hit, index, 0), 2] > camera.centre[2] if len(points) else hit
    walls = (hit & high & (depth < WALL)).any(axis=0, keepdims=True).astype(np.uint8)
    walled = cv2.dilate(walls, np.ones((1, wide), np.uint8)).astype(bool).repeat(len(image), axis=0)
    hit = cv2.dilate(hit.astype(np.uint8), np.ones((wide, wide), np.uint8))
    steps = np.zeros(shape, np.float32)
    for axis in (0, 1):
        change = np.abs(np.diff(image, axis=axis)).max(axis=2)
        before = [(0, 0), (0, 0)]
        before[axis] = (1, 0)
        steps = np.maximum(steps, np.pad(change, before))
    smooth = ((steps <= SMOOTH) & (hit == 0)).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(smooth, connectivity=4)
    grey = image.mean(axis=2)
    patches = []
    for label in range(1, count):
        patch = labels == label
        tops = stats[label, cv2.CC_STAT_TOP] <= 1
        large = stats[label, cv2.CC_STAT_AREA] >= SMALLEST * patch.size
        if tops and large and walled[patch].mean() < 0.5:
            patches.append(patch)
    rest = grey[~np.any(patches, axis=0)] if patches else grey
    bright = np.quantile(rest, BRIGHT) if rest.size else 0.0  # all is sky
    sky = np.zeros(shape, bool)
    for patch in patches:
        if grey[patch].mean() > bright:
            sky |= patch
    # Edges of clouds part the patches.
    kernel = np.ones((wide, wide), np.uint8)
    closed = cv2.morphologyEx(sky.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    return (closed == 1) & (hit == 0)
