"""What EmerNeRF learns from: rays through pixels and LiDAR points, the scene's box, its motion."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from baselines.emernerf.model import Rays
from geoevs.core.images import to_uint8
from geoevs.geometry.sky import find_sky
from geoevs.methods.contract import Views
from geoevs.projection import visible
from geoevs.scenes.boxes import moving_boxes
from geoevs.scenes.camera import Camera

QUANTILE = 0.02  # of LiDAR coordinates that the box leaves out at either end, as published
HEIGHT = 20.0  # metres that the box reaches up at least
AROUND = 40.0  # metres around the cameras, where there is no LiDAR
ERROR_SHARE, ERROR_CELL = 0.5, 8  # share of rays that go where errors are; pixels of their map
LEAST_ERROR = 1e-8  # so that all may be right
SMALLEST = 1.0  # metre of the box, so that it can be divided by


class Place(NamedTuple):
    """The box of a scene around zero, and the world position that was subtracted."""

    centre: np.ndarray  # [3] world position of the box's middle, metres
    half: np.ndarray  # [3] half of the box's size, metres
    first: int  # the first frame
    last: int

    def time(self, frame: int) -> float:
        """A frame's time in [0, 1], frames being evenly spaced."""
        span = max(self.last - self.first, 1)
        return min(max((frame - self.first) / span, 0.0), 1.0)

    @property
    def step(self) -> float:
        """The time between neighbouring frames, as a share of the scene."""
        return 1 / max(self.last - self.first, 1)


def find_place(views: Views, points: np.ndarray) -> Place:
    """The box of a scene, from all its LiDAR points (N, 3), or from its cameras without any."""
    cameras = [views.camera(name, frame) for frame in views.frames for name in views.cameras]
    centres = np.array([camera.centre for camera in cameras])
    if len(points):
        low, high = np.quantile(points.astype(np.float64), [QUANTILE, 1 - QUANTILE], axis=0)
        # The published code lifts the top to 20 m; here the world's zero may be anywhere.
        high[2] = max(high[2], low[2] + HEIGHT)
    else:
        around = np.array([AROUND, AROUND, HEIGHT / 2])
        low, high = centres.min(axis=0) - around, centres.max(axis=0) + around
    half = np.maximum(high - low, SMALLEST) / 2
    return Place((low + high) / 2, half, views.frames[0], views.frames[-1])


def pixel_rays(
    camera: Camera,
    uv: np.ndarray,  # [R, 2] pixels
    place: Place,
) -> tuple[np.ndarray, np.ndarray]:
    """(R, 3) float32 origins and unit directions of the rays through positions in an image."""
    rays = np.linalg.solve(camera.K, np.column_stack([uv, np.ones(len(uv))]).T).T
    rays = rays @ camera.world_from_camera[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    origins = np.broadcast_to(camera.centre - place.centre, rays.shape)
    return origins.astype(np.float32), rays.astype(np.float32)


class PixelBatch(NamedTuple):
    """Rays through pixels, and what was seen there."""

    rays: Rays
    rgb: Tensor  # [R, 3]
    sky: Tensor  # [R] bool
    cell: Tensor  # [R] int64: of the error map, for `learn_errors`


@dataclass(frozen=True)
class TrainingRays:
    """Every pixel of a scene's images, and every LiDAR point as its cameras see it.

    Scene stores do not say where their LiDAR stood, so a point's ray starts at each camera that
    sees the point; points that no camera sees teach nothing.
    """

    rgb: Tensor  # [I, H, W, 3] uint8
    sky: Tensor  # [I, H, W] bool
    rotations: Tensor  # [I, 3, 3] float32, of camera axes to the world's
    intrinsics: Tensor  # [I, 4] float32: fx, fy, cx, cy
    origins: Tensor  # [I, 3] float32
    times: Tensor  # [I] float32
    ends: Tensor  # [P, 3] float32: LiDAR points
    seen_from: Tensor  # [P] int64: the image that sees each
    errors: Tensor  # [I, H / ERROR_CELL, W / ERROR_CELL] recent squared errors, learned

    @classmethod
    def make(cls, views: Views, clouds: dict[int, np.ndarray], place: Place) -> "TrainingRays":
        """Collect them; `clouds` has the (N, 3) LiDAR points of every frame."""
        columns: dict[str, Any] = {name: [] for name in cls.__dataclass_fields__}
        for frame in views.frames:
            points = clouds[frame]
            for name in views.cameras:
                camera, image = views.camera(name, frame), views.image(name, frame)
                seen = points[visible(points, camera, visibility="footprint")]
                K = camera.K
                columns["rgb"].append(to_uint8(image))
                columns["sky"].append(find_sky(image, points, camera))
                columns["rotations"].append(camera.world_from_camera[:3, :3])
                columns["intrinsics"].append([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
                columns["origins"].append(camera.centre - place.centre)
                columns["times"].append(place.time(frame))
                columns["seen_from"].append(np.full(len(seen), len(columns["seen_from"])))
                columns["ends"].append(seen - place.centre)
        for name in ("rotations", "intrinsics", "origins", "times"):
            columns[name] = torch.tensor(np.array(columns[name]), dtype=torch.float32)
        for name in ("rgb", "sky"):
            columns[name] = torch.from_numpy(np.stack(columns[name]))
        columns["seen_from"] = torch.from_numpy(np.concatenate(columns["seen_from"]))
        columns["ends"] = torch.from_numpy(np.concatenate(columns["ends"]).astype(np.float32))
        images, height, width = columns["sky"].shape
        columns["errors"] = torch.ones(images, -(-height // ERROR_CELL), -(-width // ERROR_CELL))
        return cls(**columns)

    def pixels(self, count: int, generator: torch.Generator) -> PixelBatch:
        """Rays through random pixels' centres, a part of them where errors were large."""
        _, height, width = self.sky.shape
        often = round(ERROR_SHARE * count)
        anywhere = torch.randint(self.sky.numel(), (count - often,), generator=generator)
        _, down, across = self.errors.shape
        wrong = self.errors.view(-1) + LEAST_ERROR
        cell = torch.multinomial(wrong, often, replacement=True, generator=generator)
        inside = torch.randint(ERROR_CELL**2, (often,), generator=generator)
        row = cell // across % down * ERROR_CELL + inside // ERROR_CELL
        column = cell % across * ERROR_CELL + inside % ERROR_CELL
        row, column = row.clamp_max(height - 1), column.clamp_max(width - 1)
        there = (cell // (down * across) * height + row) * width + column
        pixel = torch.cat([anywhere, there])
        image, row, column = (
            pixel // (height * width),
            pixel // width % height,
            pixel % width,
        )
        uv = torch.stack([column, row], dim=1) + 0.5
        focal, middle = self.intrinsics[image].split(2, dim=1)
        ahead = torch.cat([(uv - middle) / focal, torch.ones(count, 1)], dim=1)
        directions = (self.rotations[image] @ ahead[..., None])[..., 0]
        directions = directions / directions.norm(dim=1, keepdim=True)
        rays = Rays(self.origins[image], directions, self.times[image], image)
        rgb, sky = self.rgb.view(-1, 3)[pixel].float() / 255, self.sky.view(-1)[pixel]
        cell = (image * down + row // ERROR_CELL) * across + column // ERROR_CELL
        return PixelBatch(rays, rgb, sky, cell)

    def learn_errors(
        self,
        cell: Tensor,  # [R] int64
        errors: Tensor,  # [R]
    ) -> None:
        """Remember how wrong a batch's colours were: each cell the mean of now and before."""
        self.errors.view(-1).scatter_reduce_(0, cell, errors, "mean", include_self=True)

    def measured(self, count: int, generator: torch.Generator) -> tuple[Rays, Tensor]:
        """Rays to random LiDAR points, and (R,) metres to them."""
        point = torch.randint(len(self.ends), (count,), generator=generator)
        image = self.seen_from[point]
        ahead = self.ends[point] - self.origins[image]
        ranges = ahead.norm(dim=1)
        rays = Rays(self.origins[image], ahead / ranges[:, None], self.times[image], image)
        return rays, ranges


def find_motion(views: Views, clouds: dict[int, np.ndarray]) -> tuple[bool, str]:
    """Whether a scene needs a dynamic field, and what to say of it.

    Tracks tell whether anything moves, and LiDAR whether it is near enough to matter: boxes that
    hold no point show in no image, or are a few pixels large. Without any LiDAR, what moves is
    what has a moving box in two frames or more.
    """
    if len(views.frames) < 2:
        return False, "one frame: no dynamic field"
    if not len(views.tracks):
        return True, "no tracks: a dynamic field in case something moves"
    boxes = moving_boxes(views.tracks, views.frames)
    if any(len(points) for points in clouds.values()):
        moves = any(box.holds(clouds[box.frame]).any() for box in boxes)
    else:
        seen = {(box.track, box.frame) for box in boxes}
        moves = len({track for track, _ in seen}) < len(seen)
    return (True, "") if moves else (False, "static scene: no dynamic field")
