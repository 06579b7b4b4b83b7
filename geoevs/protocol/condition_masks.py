"""Raw reprojection's validity masks, and those that degrade a condition map (section 3.4)."""

from dataclasses import dataclass

import numpy as np

from geoevs.geometry.lift import lidar_depths, lift_frame
from geoevs.methods.contract import Views
from geoevs.projection import zbuffer
from geoevs.protocol.records import Records, check_array
from geoevs.protocol.targets import ALL_CAMERAS, Target
from geoevs.scenes.camera import Camera
from geoevs.scenes.store import Scene


class RawReprojection:
    """All sources of a frame, lifted with completed LiDAR depth: one geometry for all methods."""

    def __init__(self, scene: Scene) -> None:
        self._views = Views(scene, scene.cameras, needs=("lidar",))
        self._depths: dict[int, dict[str, np.ndarray]] = {}  # by frame and camera, [H, W] metres
        self._lifted: tuple[tuple[int, float, float], np.ndarray] | None = None

    def validity(self, camera: Camera, frame: int) -> np.ndarray:
        """(H, W) bool: the pixels of `camera` that a point of `frame` lands in."""
        return zbuffer(self._cloud(camera, frame), camera).index >= 0

    def _cloud(self, camera: Camera, frame: int) -> np.ndarray:
        """(N, 3) points; the last cloud is kept, as a frame's virtual cameras share one lens."""
        lens = (frame, camera.K[0, 0], camera.K[1, 1])
        if self._lifted is None or self._lifted[0] != lens:
            if frame not in self._depths:
                self._depths[frame] = lidar_depths(self._views, frame)
            xyz, _ = lift_frame(self._views, frame, self._depths[frame], camera)
            self._lifted = lens, xyz
        return self._lifted[1]


@dataclass(frozen=True)
class ConditionMask:
    """The degradation of one masked target's condition map (section 3.4).

    Args:
        keep: the validity mask of the target's mask camera; the condition is hidden elsewhere.
        reprojected: which pixels of the target raw reprojection supports.
    """

    keep: np.ndarray  # [H, W] bool
    reprojected: np.ndarray  # [H, W] bool

    def check(self) -> None:
        """Check what was read of a file.

        Raises:
            GeoEvsError: an array is of another type or shape.
        """
        check_array(self.keep, "keep", "b", (None, None))
        check_array(self.reprojected, "reprojected", "b", self.keep.shape)

    @property
    def supported(self) -> np.ndarray:
        """(H, W) bool: pixels that the degraded condition still has."""
        return self.reprojected & self.keep

    @property
    def removed(self) -> np.ndarray:
        """(H, W) bool: pixels that the mask took from it."""
        return self.reprojected & ~self.keep


def make_condition_masks(
    targets: list[Target], reprojection: RawReprojection
) -> dict[str, ConditionMask]:
    """The masks of every masked target, by target key.

    As the paper's injection does, a mask is laid onto the target pixel by pixel: it has the shape
    of losses at another pose, not the losses of this one.
    """
    masked = [target for target in targets if target.masked]
    for target in masked:
        if target.sources != ALL_CAMERAS:
            raise ValueError(f"no condition mask is defined for sources {target.sources}")
    # All mask cameras have one lens, so they come first.
    keeps = [reprojection.validity(target.mask_camera, target.frame) for target in masked]
    return {
        target.key: ConditionMask(keep, reprojection.validity(target.camera, target.frame))
        for target, keep in zip(masked, keeps, strict=True)
    }


class ConditionMasks(Records[ConditionMask]):
    """A file of condition masks; it holds nothing that scores, so steps that render may read it."""

    kind = ConditionMask
