"""The validity operator: which points a camera sees, and in which pixels (section 3.2).

A point is valid where its depth is positive, its pixel lies in the frame, and no other point of
that pixel is nearer. Condition maps, sparse references and LiDAR colours all come from here, so
that training, inference and evaluation agree; nothing else in the project decides validity.

Points may be numpy arrays or torch tensors; tensors give tensors on the same device, and carry
no gradient. All paths, on any device, agree bit for bit.
"""

import dataclasses
import sys
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import cv2
import numpy as np

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.projection.kernels import (
    lens_of,
    placing_of,
    project_numba,
    project_torch,
    unproject_numba,
    unproject_torch,
    zbuffer_numba,
    zbuffer_torch,
)
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import MOST_CAMERAS, Frame, PointCloud

if TYPE_CHECKING:
    import torch  # importing it costs seconds, so only those who hold tensors pay
    from typing_extensions import TypeIs

Array = TypeVar("Array", np.ndarray, "torch.Tensor")

VISIBILITIES = ("pixel", "footprint")
NOTHING_HIDDEN: Mapping[str, np.ndarray] = MappingProxyType({})

# A sparse z-buffer lets background leak between foreground points. At the paper's support ratios
# (0.02 to 0.1) points lie 3 to 7 pixels apart, so a 5 x 5 window around a leak holds foreground.
FOOTPRINT_RADIUS = 2
# A wider tolerance lets leaks stay; a narrower one takes far road, whose depth rises by about
# depth / (focal x height) a pixel: over this window it keeps road up to 35 m at 128 x 192.
# Measured on PandaSet 002, one LiDAR at supports of 0.03 to 0.08, nine poses up to 22.5 degrees and
# 1 m aside: drops 28 to 39 % of the leaks (the same pixel of twelve sweeps together is nearer by
# 15 %) and 3 to 6 % of the other points; at 0.1 instead, 36 to 51 % and 6 to 10 %.
FOOTPRINT_TOLERANCE = 0.2


class ZBuffer(NamedTuple, Generic[Array]):
    """The front-most point of every pixel."""

    index: Array  # type: ignore[assignment]  # [H, W] int64, -1 = none; hides tuple.index
    depth: Array  # [H, W] float64 metres along the optical axis, 0 = none

    @property
    def mask(self) -> Array:
        """(H, W) bool: pixels that hold a point."""
        return self.index >= 0


class Raster(NamedTuple, Generic[Array]):
    """Points' values in the pixels of a camera."""

    image: Array  # [H, W, C], zero where no point is
    mask: Array  # [H, W] bool
    depth: Array  # [H, W] float64 metres along the optical axis, 0 = none


def project_points(
    points: Array,  # [N, 3]
    camera: Camera,
) -> tuple[Array, Array]:
    """Project world points, in float64 whatever their type (section 3.2, the operator Pi).

    Args:
        points: (N, 3) world positions in metres.
        camera: the view.

    Returns:
        uv (N, 2) in pixels, so that the pixel of a point is (floor(u), floor(v)), and NaN where
        the depth is not positive and finite; depth (N,) in metres along the optical axis.

    Raises:
        GeoEvsError: `points` is not (N, 3).

    >>> camera = Camera([[100, 0, 50], [0, 100, 40], [0, 0, 1]], np.eye(4), 80, 100)
    >>> project_points(np.array([[0.5, -1.0, 4.0], [0.0, 0.0, -1.0]]), camera)
    (array([[62.5, 15. ],
           [ nan,  nan]]), array([ 4., -1.]))
    """
    _check_points(points)
    lens = lens_of(camera)
    if not _is_tensor(points):
        return project_numba(_readable(points), lens)
    if points.device.type != "cpu":
        return project_torch(points.detach(), lens)
    return tuple(map(sys.modules["torch"].from_numpy, project_numba(_readable(points), lens)))


def unproject_depth(
    depth: Array,  # [H, W]
    camera: Camera,
) -> tuple[Array, Array]:
    """Lift a depth map to world points through the pixels' centres.

    Args:
        depth: (H, W) metres along the optical axis, 0 = none.
        camera: the view that it belongs to.

    Returns:
        points (M, 3) float64 in the world, and the flat indices (M,) int64 of their pixels,
        rising: the pixels whose depth is positive and finite.

    Raises:
        GeoEvsError: the depth map is not of the camera's size.

    >>> camera = Camera([[100, 0, 50], [0, 100, 40], [0, 0, 1]], np.eye(4), 80, 100)
    >>> depth = np.zeros((80, 100))
    >>> depth[40, 60] = 2.0
    >>> unproject_depth(depth, camera)
    (array([[0.21, 0.01, 2.  ]]), array([4060]))
    """
    if tuple(depth.shape) != (camera.height, camera.width):
        raise GeoEvsError(
            f"the depth map is {' x '.join(map(str, depth.shape))} but camera '{camera.name}' is "
            f"{camera.height} x {camera.width}; resize one to the other"
        )
    placing = placing_of(camera)
    if _is_tensor(depth):
        return unproject_torch(depth, placing)
    return unproject_numba(np.asarray(depth), placing)


def zbuffer(
    points: Array,  # [N, 3]
    camera: Camera,
    visibility: str = "pixel",
) -> ZBuffer[Array]:
    """The front-most point of every pixel: the validity rule (section 3.2, the operator R).

    Args:
        points: (N, 3) world positions in metres; those with NaN are never valid.
        camera: the view.
        visibility: `pixel` is the paper's rule, ties to the lower point index; `footprint` also
            drops points that lie behind a nearer surface of the pixels around them.

    Returns:
        index (H, W) int64 of the front-most point or -1, and its depth (H, W) float64 or 0.

    Raises:
        GeoEvsError: `points` is not (N, 3), or there is no such visibility.

    >>> camera = Camera([[1, 0, 1], [0, 1, 0.5], [0, 0, 1]], np.eye(4), 1, 2)
    >>> zbuffer(np.array([[0.0, 0.0, 9.0], [0.0, 0.0, 5.0], [0.0, 0.0, 5.0]]), camera)
    ZBuffer(index=array([[-1,  1]]), depth=array([[0., 5.]]))
    """
    if visibility not in VISIBILITIES:
        raise GeoEvsError(
            f"there is no visibility '{visibility}'; {did_you_mean(visibility, VISIBILITIES)}"
        )
    _check_points(points)
    lens = lens_of(camera)
    if _is_tensor(points) and points.device.type != "cpu":
        on_device = ZBuffer(*zbuffer_torch(points.detach(), lens))
        return _drop_leaks_torch(on_device) if visibility == "footprint" else on_device
    buffer = ZBuffer(*zbuffer_numba(_readable(points), lens))
    if visibility == "footprint":
        buffer = _drop_leaks(buffer)
    if _is_tensor(points):
        return ZBuffer(*map(sys.modules["torch"].from_numpy, buffer))
    return buffer


def rasterize_points(
    points: Array,  # [N, 3]
    values: Array,  # [N, C]
    camera: Camera,
    visibility: str = "pixel",
) -> Raster[Array]:
    """Write the values of the valid points into an image that is zero elsewhere (section 3.2).

    Args:
        points: (N, 3) world positions in metres.
        values: (N, C) what each point carries, such as its colour; on the points' device.
        camera: the view.
        visibility: `pixel` or `footprint`, see `zbuffer`.

    Returns:
        image (H, W, C) of the values' type, mask (H, W) bool and depth (H, W) float64.

    Raises:
        GeoEvsError: the points and values do not pair up, or there is no such visibility.

    >>> camera = Camera([[1, 0, 1], [0, 1, 0.5], [0, 0, 1]], np.eye(4), 1, 2)
    >>> points = np.array([[0.0, 0.0, 9.0], [0.0, 0.0, 5.0]])
    >>> rasterize_points(points, np.array([[0.1], [0.7]]), camera).image.tolist()
    [[[0.0], [0.7]]]
    """
    if values.ndim != 2 or len(values) != len(points):
        raise GeoEvsError(
            f"{len(points)} points came with values of shape {tuple(values.shape)}; give each "
            "point one row"
        )
    index, depth = zbuffer(points, camera, visibility)
    mask = index >= 0
    shape = camera.height, camera.width, values.shape[1]
    if _is_tensor(values):
        image = values.new_zeros(shape)
        image[mask] = values[index[mask]]
    elif len(values):
        image = values.take(index, axis=0, mode="wrap")  # and clear: faster than masked writing
        image[~mask] = 0
    else:
        image = np.zeros(shape, values.dtype)
    return Raster(image, mask, depth)


def visible(
    points: Array,  # [N, 3]
    camera: Camera,
    visibility: str = "pixel",
) -> Array:
    """(N,) bool: the points that survive in `zbuffer`, which names the arguments and errors.

    >>> camera = Camera([[1, 0, 1], [0, 1, 0.5], [0, 0, 1]], np.eye(4), 1, 2)
    >>> visible(np.array([[0.0, 0.0, 9.0], [0.0, 0.0, 5.0]]), camera).tolist()
    [False, True]
    """
    index = zbuffer(points, camera, visibility).index
    if _is_tensor(points):
        front = points.new_zeros(len(points), dtype=sys.modules["torch"].bool)
    else:
        front = np.zeros(len(points), bool)
    front[index[index >= 0]] = True
    return front


def colour_points(
    cloud: PointCloud,
    cameras: dict[str, Camera],
    images: dict[str, np.ndarray],  # each [H, W, 3]
    hidden: Mapping[str, np.ndarray] = NOTHING_HIDDEN,  # each [H, W] bool
) -> PointCloud:
    """Give LiDAR points the colours of the images they are valid in (section 3.5).

    A point takes the bilinear sample of the camera whose optical axis is nearest to it, of those
    that it is valid in (the first of equals). Points valid in none stay black, with camera -1.

    Args:
        cloud: the points; colours that it has are discarded.
        cameras: by name; the result's `camera` counts them in this order.
        images: (H, W, 3) by the same names, uint8 or float in [0, 1].
        hidden: pixels that colour nothing, such as those of the car that carries the camera.

    Returns:
        The same points with `rgb` and `camera` set.

    Raises:
        GeoEvsError: an image is missing, or is not of its camera's size; or there are more than
            MOST_CAMERAS.
    """
    if len(cameras) > MOST_CAMERAS:
        raise GeoEvsError(
            f"{len(cameras)} cameras are too many to colour points; give {MOST_CAMERAS} at most"
        )
    rgb = np.zeros((len(cloud), 3), np.float32)
    chosen = np.full(len(cloud), -1, np.int8)
    least = np.full(len(cloud), np.inf)
    for number, (name, camera) in enumerate(cameras.items()):
        shape = camera.height, camera.width, 3
        if name not in images or images[name].shape != shape:
            raise GeoEvsError(
                f"camera '{name}' needs a {camera.height} x {camera.width} RGB image; supply it "
                "or resize them together"
            )
        candidates = np.flatnonzero(visible(cloud.xyz, camera))
        if name in hidden:
            uv, _ = project_points(cloud.xyz[candidates], camera)
            column, row = uv.astype(np.int64).T
            candidates = candidates[~hidden[name][row, column]]
        slope = _squared_slope(cloud.xyz[candidates], camera)
        nearer = slope < least[candidates]
        winners = candidates[nearer]
        least[winners] = slope[nearer]
        chosen[winners] = number
        uv, _ = project_points(cloud.xyz[winners], camera)
        rgb[winners] = sample_bilinear(images[name], uv)
    return dataclasses.replace(cloud, rgb=rgb, camera=chosen)


def colour_frame(frame: Frame, hidden: Mapping[str, np.ndarray] = NOTHING_HIDDEN) -> Frame:
    """The frame with its LiDAR points coloured by its own cameras (see `colour_points`)."""
    points = colour_points(frame.points, frame.cameras, frame.images, hidden)
    return dataclasses.replace(frame, points=points)


def _check_points(points: Array) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeoEvsError(f"points have shape {tuple(points.shape)}; reshape them to (N, 3)")


def _is_tensor(array: object) -> "TypeIs[torch.Tensor]":
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(array, torch.Tensor)


def _readable(points: Array) -> np.ndarray:
    """The points as the kernel reads them: float32 and float64 as they are, others as float64."""
    if _is_tensor(points):
        torch = sys.modules["torch"]
        tensor = points.detach()
        native = tensor.dtype in (torch.float32, torch.float64)
        array = (tensor if native else tensor.double()).numpy()
    else:
        array = points
    native = array.dtype in (np.float32, np.float64)
    return np.ascontiguousarray(array if native else array.astype(np.float64))


def _drop_leaks(buffer: ZBuffer[np.ndarray]) -> ZBuffer[np.ndarray]:
    """The footprint rule: no point far behind the nearest one of the window around it."""
    solid = np.where(buffer.index >= 0, buffer.depth, np.inf)
    side = 2 * FOOTPRINT_RADIUS + 1
    nearest = cv2.erode(solid, np.ones((side, side), np.uint8))
    hidden = nearest < buffer.depth * (1 - FOOTPRINT_TOLERANCE)
    return ZBuffer(np.where(hidden, -1, buffer.index), np.where(hidden, 0.0, buffer.depth))


def _drop_leaks_torch(buffer: "ZBuffer[torch.Tensor]") -> "ZBuffer[torch.Tensor]":
    """`_drop_leaks` in torch ops."""
    torch = sys.modules["torch"]
    solid = buffer.depth.masked_fill(buffer.index < 0, torch.inf)
    side = 2 * FOOTPRINT_RADIUS + 1
    nearest = -torch.nn.functional.max_pool2d(-solid[None], side, 1, FOOTPRINT_RADIUS)[0]
    hidden = nearest < buffer.depth * (1 - FOOTPRINT_TOLERANCE)
    return ZBuffer(buffer.index.masked_fill(hidden, -1), buffer.depth.masked_fill(hidden, 0))


def _squared_slope(points: np.ndarray, camera: Camera) -> np.ndarray:
    """(N,) squared tangent of the angle to the optical axis; unlike a cosine, exact near it."""
    x, y, z = (
        row[0] * points[:, 0] + row[1] * points[:, 1] + row[2] * points[:, 2] + row[3]
        for row in camera.camera_from_world[:3]
    )
    return (x * x + y * y) / (z * z)


def sample_bilinear(
    image: np.ndarray,  # [H, W, 3] uint8 or float
    uv: np.ndarray,  # [N, 2] in the frame
) -> np.ndarray:
    """(N, 3) float64 in [0, 1]: pixel centres lie at +0.5, and the border is clamped."""
    scale = 255.0 if image.dtype == np.uint8 else 1.0
    last = np.array([image.shape[1] - 1, image.shape[0] - 1])
    place = np.maximum(uv - 0.5, 0)
    left, top = low = place.astype(np.int64).T
    right, bottom = np.minimum(low + 1, last[:, None])
    across, down = (place - low.T).T[:, :, None]
    upper = image[top, left] * (1 - across) + image[top, right] * across
    lower = image[bottom, left] * (1 - across) + image[bottom, right] * across
    return (upper * (1 - down) + lower * down) / scale
