"""A frame of a rig as a detector is given it: pictures or their features, cameras, labels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.mapped import Stack

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
"""Of the vehicle's frame: left becomes right."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LabelledRig:
    """What a frame has besides pictures.

    Args:
        scene: the frames of one scene are ordered in time.
        frame: its number.
        seconds: its time.
        image_from_vehicle: (N, 3, 4) float64 projections, from metres in the vehicle's frame (x
            ahead, y left, z up) to homogeneous pixels whose centres lie at +0.5. The third row
            gives metres along the optical axis.
        recorded: (N,) bool, False for generated views.
        world_from_vehicle: (4, 4) float64.
        boxes: (M, 7) float64, as `geoevs.detection.rows.BOX`, in the vehicle's frame.
        classes: (M,) int64 places in the detector's classes.

    Raises:
        GeoEvsError: shapes do not fit, or a number is not finite.
    """

    scene: str
    frame: int
    seconds: float
    image_from_vehicle: np.ndarray
    recorded: np.ndarray
    world_from_vehicle: np.ndarray
    boxes: np.ndarray
    classes: np.ndarray

    def __post_init__(self) -> None:
        count, boxes = len(self.recorded), len(self.classes)
        wanted = {
            "image_from_vehicle": (count, 3, 4),
            "world_from_vehicle": (4, 4),
            "boxes": (boxes, 7),
        }
        for name, shape in wanted.items():
            value = getattr(self, name)
            if np.shape(value) != shape:
                raise GeoEvsError(
                    f"{self.name}: {name} has the shape {np.shape(value)}; give {shape}"
                )
            if not np.isfinite(value).all():
                raise GeoEvsError(f"{self.name}: {name} has NaN or infinite numbers; correct it")
        if not count:
            raise GeoEvsError(f"{self.name} has no camera; give it one at least")

    @property
    def name(self) -> str:
        """The frame in errors: scene/frame."""
        return f"{self.scene}/{self.frame}"


@dataclass(frozen=True, eq=False, kw_only=True)
class RigFrame(LabelledRig):
    """A frame with its pictures.

    Args:
        images: (N, H, W, 3) float32 in [0, 1], of one size.

    Raises:
        GeoEvsError: shapes do not fit, or a number is not finite.
    """

    images: np.ndarray

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = np.shape(self.images)
        if len(shape) != 4 or shape[0] != len(self.recorded) or shape[3] != 3 or 0 in shape:
            raise GeoEvsError(
                f"{self.name}: images have the shape {shape}; give one of (H, W, 3) for each of "
                f"the {len(self.recorded)} cameras"
            )

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images."""
        return self.images.shape[1], self.images.shape[2]

    def resized(self, size: tuple[int, int]) -> "RigFrame":
        """The whole images at another height and width, and the projections into them."""
        if size == self.size:
            return self
        height, width = size
        scale = np.diag([width / self.size[1], height / self.size[0], 1.0])
        shrinks = height < self.size[0] or width < self.size[1]
        how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        images = [cv2.resize(np.asarray(image), (width, height), None, 0, 0, how)
                  for image in self.images]  # fmt: skip
        return replace(
            self, images=np.stack(images), image_from_vehicle=scale @ self.image_from_vehicle
        )

    def mirrored(self) -> "RigFrame":
        """The frame of a world in which left and right are exchanged."""
        projections = self.image_from_vehicle.copy()
        projections[:, 0] = self.size[1] * projections[:, 2] - projections[:, 0]
        return replace(
            self,
            images=np.ascontiguousarray(self.images[:, :, ::-1]),
            image_from_vehicle=projections @ MIRROR,
            world_from_vehicle=MIRROR @ self.world_from_vehicle @ MIRROR,
            boxes=self.boxes * [1, -1, 1, 1, 1, 1, -1],
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class FeatureFrame(LabelledRig):
    """A frame with the features that a backbone made of its pictures (see `features`).

    Args:
        stack: (N, C, h, w) float16, read when asked for.
        size: height and width of the pictures that the projections are of.
        pictures: (R, H, W, 3) uint8, those of recorded views, for previews.
        backbone: fingerprint of the backbone.
    """

    stack: Stack
    size: tuple[int, int]
    pictures: Stack
    backbone: str

    @property
    def features(self) -> np.ndarray:
        """(N, C, h, w) float16."""
        return np.asarray(self.stack)


Frame = TypeVar("Frame", RigFrame, FeatureFrame)


def in_scenes(frames: Sequence[Frame]) -> dict[str, list[int]]:
    """Where the frames of each scene stand, in their order of time.

    Raises:
        GeoEvsError: there are none, or a scene's frames are not ordered in time.
    """
    if not frames:
        raise GeoEvsError("there are no frames to detect anything in; name scenes with frames")
    places: dict[str, list[int]] = {}
    for place, frame in enumerate(frames):
        earlier = places.setdefault(frame.scene, [])
        if earlier and frames[earlier[-1]].seconds >= frame.seconds:
            raise GeoEvsError(
                f"frames of scene '{frame.scene}' are not ordered in time: "
                f"{frames[earlier[-1]].frame} is not before {frame.frame}; sort them"
            )
        earlier.append(place)
    return places
