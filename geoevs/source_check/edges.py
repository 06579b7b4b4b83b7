"""Whether the outlines that LiDAR sees lie on the edges of the images."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from geoevs.projection import project_points, zbuffer
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import Frame

GAP = 1 / 16
"""Widths of the image between the two points of an outline at most."""

JUMP, RATIO = 1.0, 1.15
"""Metres, and the ratio, by which depth jumps at an outline at least."""

RISE = 0.4
"""Metres of height between the points of an outline along a column: road has none."""

NEAREST = 6.0
"""Metres to an outline at least: the LiDAR sees round the corners of what is nearer."""

MOST = 4000
"""Outlines of a view that are looked at."""


class Outlines(NamedTuple):
    """Where depth jumps along rows (axis 0) or columns (axis 1) of an image."""

    uv: np.ndarray  # [N, 2] pixels of the near points
    ends: np.ndarray  # [N] bool: the near thing ends here, and does not begin


def find_outlines(xyz: np.ndarray, camera: Camera, axis: int) -> Outlines:
    """The outlines of what stands in front of something else.

    Args:
        xyz: (N, 3) LiDAR points in the world.
        camera: that sees them.
        axis: 0 for jumps along rows, 1 along columns.
    """
    index, depth = zbuffer(xyz, camera, "footprint")
    if axis:
        index, depth = index.T, depth.T
    line, place = np.nonzero(index >= 0)
    depth, index = depth[line, place], index[line, place]
    near, jump = np.minimum(depth[1:], depth[:-1]), np.abs(np.diff(depth))
    side = camera.height if axis else camera.width
    found = (np.diff(line) == 0) & (np.diff(place) <= max(GAP * side, 2)) & (near > NEAREST)
    found &= (jump > JUMP) & (jump > (RATIO - 1) * near)
    if axis:
        found &= np.abs(np.diff(xyz[index, 2])) > RISE
    first = np.flatnonzero(found)
    ends = depth[first] < depth[first + 1]
    uv, _ = project_points(xyz[index[np.where(ends, first, first + 1)]], camera)
    return Outlines(uv, ends)


def edge_map(image: np.ndarray, axis: int) -> np.ndarray:
    """(H, W) float32: how strong an edge across an axis is, beside others in its neighbourhood."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (0, 0), 1)
    edges = np.abs(cv2.Sobel(grey, cv2.CV_32F, 1 - axis, axis))
    around = max(image.shape[1] // 6, 9)
    return edges / (cv2.blur(edges, (around, around)) + 4)


class Profile(NamedTuple):
    """The mean edge strength beside outlines along one axis, by pixels of shift."""

    shifts: np.ndarray  # [K] rising evenly, from -reach to reach
    begins: np.ndarray  # [K] where near things begin
    ends: np.ndarray  # [K] where they end
    counts: tuple[int, int]  # of beginnings and ends

    @property
    def both(self) -> np.ndarray:
        """(K,) the mean of all outlines, whichever end they are of."""
        begun, ended = self.counts
        return (self.begins * begun + self.ends * ended) / max(begun + ended, 1)


def measure(
    frames: Iterable[Frame], points_of: str, image_of: str, axis: int, shifts: np.ndarray
) -> Profile:
    """The mean edge strength of a camera's images beside the outlines in its view.

    Args:
        frames: to pool.
        points_of: the camera whose view of the points has the outlines.
        image_of: the camera whose images are looked at, the same one but for a comparison.
        axis: 0 for shifts along rows, 1 along columns.
        shifts: (K,) pixels.
    """
    sums, counts = np.zeros((2, len(shifts))), [0, 0]
    for frame in frames:
        edges = edge_map(frame.images[image_of], axis)
        uv, ends = find_outlines(frame.points.xyz, frame.cameras[points_of], axis)
        stride = max(len(uv) // MOST, 1)
        places = np.repeat(uv[::stride, None, ::-1] - 0.5, len(shifts), axis=1)  # [N, K, 2] y, x
        places[:, :, 1 - axis] += shifts
        strength = map_coordinates(edges, np.moveaxis(places, 2, 0), order=1, cval=np.nan)
        whole = np.isfinite(strength).all(axis=1)
        for side in (0, 1):
            chosen = strength[whole & (ends[::stride] == side)]
            sums[side] += chosen.sum(axis=0)
            counts[side] += len(chosen)
    begins, ends = sums / np.maximum(counts, 1)[:, None]
    return Profile(shifts, begins, ends, (counts[0], counts[1]))


def symmetric_shift(profile: Profile, most: float) -> float:
    """The shift in pixels about which beginnings mirror ends.

    What lies beside an outline, near or far, is alike at both ends of a thing. So is an error of
    half the way from one point to the next. About the place where an image's edges really are, the
    profile of the one is the mirror image of that of the other, whatever these errors are.

    Args:
        profile: of one camera and axis.
        most: pixels that are tried.
    """
    inner = profile.shifts[np.abs(profile.shifts) <= profile.shifts[-1] - most]
    tried = np.arange(-most, most + 1e-9, 0.05)
    alike = []
    for shift in tried:
        ends = np.interp(shift + inner, profile.shifts, profile.ends)
        begins = np.interp(shift - inner, profile.shifts, profile.begins)
        alike.append(_correlation(ends, begins))
    return float(tried[int(np.argmax(alike))])


def _correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Of two profiles; 0 where one of them is level."""
    one, other = one - one.mean(), other - other.mean()
    return float(one @ other / max(np.linalg.norm(one) * np.linalg.norm(other), 1e-12))


def pooled(profiles: Sequence[Profile]) -> Profile:
    """The profile of all outlines of some profiles together."""
    begun, ended = counts = np.sum([profile.counts for profile in profiles], axis=0)
    begins = sum(profile.begins * profile.counts[0] for profile in profiles) / max(begun, 1)
    ends = sum(profile.ends * profile.counts[1] for profile in profiles) / max(ended, 1)
    return Profile(profiles[0].shifts, np.asarray(begins), np.asarray(ends), tuple(counts.tolist()))
