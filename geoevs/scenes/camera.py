"""A calibrated pinhole camera: OpenCV axes, pixel centres at +0.5, world z up, metres."""

from dataclasses import dataclass, replace

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.text import clean

RIGID_TOLERANCE = 1e-4
LARGEST_SIDE = 8192
"""Pixels of a side at most. One picture of this size fills gigabytes in float64."""

FOCAL_RANGE = (0.01, 100.0)
"""Focal lengths in sides of the image: from 178 degrees across to half a degree."""

WORLD_LIMIT = 10_000.0
"""Metres from the world's origin at most: float32 holds a millimetre up to there."""

PRINCIPAL_TOLERANCE = 1e-9
"""Sides of the image by which a principal point on its border may be rounded outwards."""


def view_key(camera: str, frame: int) -> str:
    """The name of a view in every folder of pictures: `<camera>/<frame>`.

    >>> view_key("front", 7)
    'front/000007'
    """
    return f"{camera}/{frame:06d}"


def is_rigid(pose: np.ndarray) -> bool:
    """Whether a (4, 4) transform only turns and moves: no scale, no mirroring, nothing else."""
    rotation = pose[:3, :3]
    return bool(
        np.abs(rotation).max() < 2  # whose products are no overflow
        and np.allclose(rotation @ rotation.T, np.eye(3), atol=RIGID_TOLERANCE)
        and np.linalg.det(rotation) > 0
        and np.allclose(pose[3], [0, 0, 0, 1])
    )


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera at one instant.

    Args:
        K: (3, 3) intrinsics in pixels; pixel (column i, row j) is centred at (i + 0.5, j + 0.5).
        world_from_camera: (4, 4) rigid transform; camera axes are x right, y down, z forward.
        height: image height in pixels.
        width: image width in pixels.
        name: which camera of the rig, or which target, this is.

    Raises:
        GeoEvsError: a value is not finite, K has skew, a focal length or principal point that its
            image cannot have, the pose is not rigid or beyond WORLD_LIMIT, or the size is none.
    """

    K: np.ndarray  # [3, 3] float64
    world_from_camera: np.ndarray  # [4, 4] float64
    height: int
    width: int
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "K", np.array(self.K, np.float64))
        object.__setattr__(self, "world_from_camera", np.array(self.world_from_camera, np.float64))
        who = f"camera '{self.name}'"
        if self.K.shape != (3, 3) or self.world_from_camera.shape != (4, 4):
            raise GeoEvsError(f"{who} needs a 3x3 K and a 4x4 pose; correct its calibration")
        if not (np.isfinite(self.K).all() and np.isfinite(self.world_from_camera).all()):
            raise GeoEvsError(f"{who} has NaN or infinite calibration; correct K and the pose")
        if self.K[[0, 1, 2, 2], [1, 0, 0, 1]].any() or self.K[2, 2] != 1:
            raise GeoEvsError(
                f"{who} has a K with skew or an odd last row; undistort it to fx, fy, cx, cy"
            )
        if min(self.K[0, 0], self.K[1, 1]) <= 0:
            raise GeoEvsError(f"{who} has a focal length that is not positive; correct fx and fy")
        self._check_size(who)
        self._check_lens(who)
        if not is_rigid(self.world_from_camera):
            raise GeoEvsError(
                f"{who} has a pose that is not rigid; its rotation must be orthonormal, without "
                "scale or mirroring"
            )
        if np.abs(self.centre).max() > WORLD_LIMIT:
            raise GeoEvsError(
                f"{who} stands more than {WORLD_LIMIT / 1000:g} km from the world's origin, where "
                "float32 loses millimetres; subtract an origin from all poses, points and boxes"
            )

    def _check_size(self, who: str) -> None:
        size = self.height, self.width
        if not all(isinstance(side, (int, np.integer)) and side is not True for side in size):
            raise GeoEvsError(f"{who} has a size that is no whole number; set height and width")
        if min(size) < 1:
            raise GeoEvsError(f"{who} has no pixels ({self.height} x {self.width}); set its size")
        if max(size) > LARGEST_SIDE:
            raise GeoEvsError(
                f"{who} has a side of {clean(str(max(size)), 20)} pixels; resize its image, and K "
                f"with it, to {LARGEST_SIDE} at most"
            )

    def _check_lens(self, who: str) -> None:
        """Check what can only be wrong with regard to the image's size."""
        sides = np.array([self.width, self.height])
        low, high = FOCAL_RANGE
        focal = np.diagonal(self.K)[:2] / sides
        if focal.min() < low or focal.max() > high:
            raise GeoEvsError(
                f"{who} has focal lengths {self.K[0, 0]:g} and {self.K[1, 1]:g}, which no image of "
                f"{self.height} x {self.width} has; correct fx and fy, or the size"
            )
        principal = self.K[:2, 2] / sides
        if np.abs(principal - 0.5).max() > 0.5 + PRINCIPAL_TOLERANCE:
            raise GeoEvsError(
                f"{who} has its principal point at ({self.K[0, 2]:g}, {self.K[1, 2]:g}), outside "
                f"its image of {self.height} x {self.width}; take the K that belongs to this size"
            )

    @property
    def camera_from_world(self) -> np.ndarray:
        """(4, 4) inverse of the pose, exact for a rigid transform."""
        rotation, centre = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        inverse = np.eye(4)
        inverse[:3, :3] = rotation.T
        inverse[:3, 3] = -rotation.T @ centre
        return inverse

    @property
    def centre(self) -> np.ndarray:
        """(3,) position in the world, metres."""
        return self.world_from_camera[:3, 3]

    @property
    def optical_axis(self) -> np.ndarray:
        """(3,) unit vector of the viewing direction in the world."""
        return self.world_from_camera[:3, 2]

    @property
    def yaw(self) -> float:
        """Heading of the optical axis in degrees, counter-clockwise from world x (left is +)."""
        return float(np.degrees(np.arctan2(self.optical_axis[1], self.optical_axis[0])))

    def resized(self, height: int, width: int) -> "Camera":
        """The same field of view on another pixel grid; fx and fy scale separately."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, height=height, width=width)


def angle_between(axis: np.ndarray, other: np.ndarray) -> float:
    """Angle in degrees between two (3,) unit vectors, exact near 0 and 180."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(axis, other)), np.dot(axis, other))))
