"""The nearest source image of the frame, turned to the target's direction: rotation only."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import cv2
import numpy as np

from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Rendering, Views
from geoevs.scenes.camera import Camera, angle_between

# Rays from behind the source camera are pushed this far before it, hence to its border.
NEAR = 1e-6


@dataclass
class Method:
    """Warps by the infinite homography, as if the whole scene were infinitely far away.

    Outside the source image its border is replicated, so that every pixel has content.
    """

    info: ClassVar[MethodInfo] = MethodInfo("Nearest view", paradigm="control")
    views: Views = field(init=False)

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Keep the source views; nothing is learned."""
        self.views = views
        return FitReport()

    def render(self, camera: Camera, frame: int) -> Rendering:
        """Sample the source image bilinearly; `support` is where the target looks inside it."""
        source = min(
            (self.views.camera(name, frame) for name in self.views.cameras),
            key=lambda candidate: _distance(candidate, camera),
        )
        place, support = infinite_homography(source, camera)
        image = self.views.image(source.name, frame)
        rgb = cv2.remap(image, place, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return Rendering(rgb, support=support)

    def render_masked(
        self,
        camera: Camera,
        frame: int,
        keep: np.ndarray,  # [H, W] bool
    ) -> Rendering:
        """The same: no condition map is used, so that masked views can be compared with it."""
        return self.render(camera, frame)

    def save(self, folder: Path) -> None:
        """Write the source views as a scene store."""
        self.views.save(folder / "views")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Open the scene store of the source views."""
        method = cls()
        method.views = Views.load(folder / "views")
        return method


def _distance(candidate: Camera, camera: Camera) -> tuple[float, float]:
    """Angle between the optical axes first (parallel to 1e-6 degrees is a tie), then metres."""
    angle = angle_between(candidate.optical_axis, camera.optical_axis)
    return round(angle, 6), float(np.linalg.norm(candidate.centre - camera.centre))


def infinite_homography(source: Camera, target: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The place of each target pixel in the source image if only the rotation counts.

    Returns:
        (H, W, 2) float32 for `cv2.remap`, whose pixel centres are integers, clamped to the
        source image; and (H, W) bool, where it lay inside before.
    """
    rotation = source.world_from_camera[:3, :3].T @ target.world_from_camera[:3, :3]
    rows, columns = np.mgrid[: target.height, : target.width] + 0.5
    pixels = np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1)
    rays = rotation @ np.linalg.solve(target.K, pixels)
    ahead = rays[2] > NEAR
    rays[2] = np.maximum(rays[2], NEAR)
    u, v, _ = source.K @ (rays / rays[2])
    support = ahead & (u >= 0) & (u <= source.width) & (v >= 0) & (v <= source.height)
    u = np.clip(u - 0.5, 0, source.width - 1)
    v = np.clip(v - 0.5, 0, source.height - 1)
    shape = target.height, target.width
    return np.stack([u, v], axis=-1).astype(np.float32).reshape(*shape, 2), support.reshape(shape)
