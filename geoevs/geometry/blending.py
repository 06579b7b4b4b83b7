"""A view's surface from neighbouring frames, and its colours from all source views of the scene.

One frame lifted by its depth is wrong wherever that depth is: pixels land beside their place. A
source view that looks along the target's own ray shows the right colour whatever the depth, and a
drive has passed many places. So the views that see a surface are blended, the more the nearer they
look along that ray: unstructured lumigraph rendering (Buehler et al. 2001). What moves is where it
is in its own frame alone, and is left to it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geoevs.geometry.lift import lift_depth
from geoevs.geometry.lifted import LiftedViews
from geoevs.geometry.moving import moving_pixels
from geoevs.projection import (
    Raster,
    project_points,
    rasterize_points,
    sample_bilinear,
    unproject_depth,
)
from geoevs.scenes.camera import Camera

NEIGHBOURS = 1
"""Frames before and after whose clouds help to find the surface."""

TOLERANCE = 0.15
"""Relative error of a source view's depth at which the view counts for 1 / e."""

LEAST_ANGLE = 0.002
"""Angle between two rays, in radians, below which neither is the better one: a third of a pixel."""

MARGIN = 1.1
"""Factor by which boxes are enlarged to find what moves: labels are tight, depth is not."""

Maps = Mapping[str, np.ndarray]
"""Arrays (H, W, ...) by the name of their camera."""


@dataclass(frozen=True)
class BlendedViews(LiftedViews):
    """Source views that explain a view together, all frames of them; they must allow tracks."""

    @cached_property
    def images(self) -> dict[int, Maps]:
        """(H, W, 3) float32 colours by frame and camera, read once."""
        views = self.views
        return {
            frame: {name: views.image(name, frame) for name in views.cameras}
            for frame in views.frames
        }

    @cached_property
    def still(self) -> dict[int, Maps]:
        """(H, W) metres by frame and camera: the depths without what moves, 0 = none."""
        return {
            frame: {
                name: depth * ~self._moving(depth, self.views.camera(name, frame), frame)
                for name, depth in depths.items()
            }
            for frame, depths in self.depths.items()
        }

    def _explained(self, camera: Camera, frame: int) -> Raster:
        """What all frames saw of a view."""
        own = super()._explained(camera, frame)
        moving = self._moving(own.depth, camera, frame)
        depth = self._surface(own.depth, moving, camera, frame)
        image, seen = self._colours(depth, moving, camera, frame)
        # At outlines a pixel may be in the cloud of a view whose own depth there is another.
        image = np.where(seen[..., None], image, own.image)
        mask = seen | own.mask
        return Raster(image, mask, depth * mask)

    def _moving(self, depth: np.ndarray, camera: Camera, frame: int) -> np.ndarray:
        """(H, W) bool: pixels whose point lies in or near a box that moves."""
        return moving_pixels(depth, camera, frame, self.views.tracks, MARGIN)

    def _surface(
        self,
        own: np.ndarray,  # [H, W] metres, 0 = none
        moving: np.ndarray,  # [H, W] bool
        camera: Camera,
        frame: int,
    ) -> np.ndarray:
        """(H, W) metres: the frame's own depth, set right and its holes filled by neighbours.

        Where all clouds have a point, it is the median; in holes it is the neighbours' nearest.
        A drive's first and last frame have one neighbour, and two depths have no median: their mean
        lies between a pole and the wall behind it, so that the frame's own stays.
        """
        near = [n for n in self.views.frames if 0 < abs(n - frame) <= NEIGHBOURS]
        depths = np.stack([own, *(self._still_depth(camera, number) for number in near)])
        nearest = np.where(depths > 0, depths, np.inf).min(axis=0)
        filled = np.where(own > 0, own, np.where(np.isfinite(nearest), nearest, 0.0))
        agreed = (depths > 0).all(axis=0) & ~moving & (len(depths) > 2)
        return np.where(agreed, np.median(depths, axis=0), filled)

    def _still_depth(self, camera: Camera, frame: int) -> np.ndarray:
        """(H, W) metres: a view of the still part of a frame's cloud."""
        clouds = [
            lift_depth(depth, self.views.camera(name, frame), camera)[0]
            for name, depth in self.still[frame].items()
        ]
        xyz = np.concatenate(clouds)
        return rasterize_points(xyz, xyz[:, :0], camera).depth

    def _colours(
        self,
        depth: np.ndarray,  # [H, W] metres, 0 = none
        moving: np.ndarray,  # [H, W] bool
        camera: Camera,
        frame: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Colours (H, W, 3) float32 of a surface, and (H, W) bool where any view sees it.

        A view counts with exp(-(e / TOLERANCE)^2) / (angle + LEAST_ANGLE)^2: e is how far its own
        depth is from the surface, relative; the angle is that between the rays from both cameras.
        """
        points, pixels = unproject_depth(depth, camera)
        everything, still = np.arange(len(points)), np.flatnonzero(~moving.reshape(-1)[pixels])
        total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
        for number in self.views.frames:
            own = number == frame
            asked, known = (everything, self.depths) if own else (still, self.still)
            for name in self.views.cameras:
                source = self.views.camera(name, number)
                found, uv, weights = weigh(points[asked], camera, source, known[number][name])
                found = asked[found]
                weight[found] += weights
                total[found] += weights[:, None] * sample_bilinear(self.images[number][name], uv)
        seen = weight > 0
        image, mask = np.zeros((depth.size, 3), np.float32), np.zeros(depth.size, bool)
        image[pixels[seen]] = total[seen] / weight[seen, None]
        mask[pixels[seen]] = True
        return image.reshape(*depth.shape, 3), mask.reshape(depth.shape)


def weigh(
    points: np.ndarray,  # [N, 3]
    target: Camera,
    source: Camera,
    known: np.ndarray,  # [H, W] metres, 0 = none
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weigh a source view's evidence at points of a target's surface.

    Args:
        points: in the world, metres.
        target: the view to synthesise.
        source: the source view.
        known: its depth, which tells what it sees.

    Returns:
        Indices (M,) of the points that it sees, their places uv (M, 2) in it, and weights (M,).
    """
    uv, z = project_points(points, source)
    u, v = uv.T
    inside = np.flatnonzero((u >= 0) & (u < source.width) & (v >= 0) & (v < source.height))
    columns, rows = uv[inside].astype(np.int64).T
    depth = known[rows, columns]
    error = depth / z[inside] - 1
    agreed = (depth > 0) & (np.abs(error) < 3 * TOLERANCE)
    indices = inside[agreed]
    rays = [points[indices] - view.centre for view in (target, source)]
    lengths = [np.linalg.norm(ray, axis=1) for ray in rays]
    angle = np.linalg.norm(np.cross(*rays), axis=1) / (lengths[0] * lengths[1])
    weights = np.exp(-((error[agreed] / TOLERANCE) ** 2)) / (angle + LEAST_ANGLE) ** 2
    return indices, uv[indices], weights
