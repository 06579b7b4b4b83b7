"""From tracks to actor nodes: boxes, the LiDAR points in them, and where they show in a view."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch

from baselines.gaussians.constants import NEAR_PLANE
from baselines.gaussians.model import gaussians_from_points
from baselines.gaussians.nodes import FOURIER, Actor
from geoevs.methods.contract import Views
from geoevs.projection import project_points
from geoevs.scenes.boxes import Box, moving_boxes
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import PointCloud

PIXELS = 4
"""Pixels of the largest view of an actor for each of its Gaussians."""

FEWEST, MOST = 32, 1000
"""Fewest and most Gaussians of an actor."""

GROUND = 0.1
"""Metres above a box's bottom, up to which points may be of the road."""


@dataclass(frozen=True)
class Track:
    """The boxes of one moving thing, frame by frame, all as large as the largest of them."""

    name: str
    boxes: dict[int, Box]  # frames rise

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames in which it has a box, rising."""
        return tuple(self.boxes)

    @property
    def size(self) -> np.ndarray:
        """(3,) length, width and height, metres."""
        box = next(iter(self.boxes.values()))
        return np.array([box.length, box.width, box.height])

    def holds(self, xyz: np.ndarray, frame: int) -> np.ndarray:
        """(N,) bool: world positions in the box, above the ground."""
        box = self.boxes[frame]
        return box.holds(xyz) & (box.local(xyz)[:, 2] > GROUND - box.height / 2)

    def shown(self, camera: Camera, frame: int) -> np.ndarray:
        """(H, W) bool: the box's outline in a view, filled; nothing where it is absent."""
        outline = np.zeros((camera.height, camera.width), np.uint8)
        if frame in self.boxes:
            # Points on an even grid, so that a box partly behind the camera has an outline too.
            grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 9)] * 3), axis=-1).reshape(-1, 3)
            uv, depth = project_points(self.boxes[frame].world(grid * self.size), camera)
            ahead = np.nan_to_num(depth, nan=-1.0) > max(NEAR_PLANE, self.size.max() / 100)
            if np.count_nonzero(ahead) >= 3:
                far = 4 * max(outline.shape)  # cv2 draws with 32 bits
                hull = cv2.convexHull(uv[ahead].clip(-far, far).round().astype(np.int32))
                cv2.fillConvexPoly(outline, hull, 1)
        return outline.astype(bool)


def moving_tracks(views: Views) -> list[Track]:
    """A track for everything that moves, by name, with its boxes in the views' frames."""
    found: dict[str, list[Box]] = {}
    for box in moving_boxes(views.tracks, views.frames):
        found.setdefault(str(box.track), []).append(box)
    return [_track(name, found[name]) for name in sorted(found)]


def _track(name: str, found: Sequence[Box]) -> Track:
    boxes: dict[int, Box] = {}
    for box in sorted(found, key=lambda box: box.frame):
        boxes.setdefault(int(box.frame), box)
    sizes = np.array([[box.length, box.width, box.height] for box in boxes.values()], np.float64)
    length, width, height = sizes.max(axis=0).tolist()
    return Track(
        name,
        {
            frame: box._replace(length=length, width=width, height=height)
            for frame, box in boxes.items()
        },
    )


def outside_all(xyz: np.ndarray, tracks: Iterable[Track]) -> np.ndarray:
    """(N,) bool: points in no box at any time. What is driven through does not stand there."""
    outside = np.ones(len(xyz), bool)
    for track in tracks:
        for frame in track.frames:
            outside &= ~track.holds(xyz, frame)
    return outside


def make_actors(
    tracks: Sequence[Track],
    views: Views,
    clouds: dict[int, PointCloud],
    rng: np.random.Generator,
    device: torch.device,
) -> list[Actor]:
    """An actor for every track that a source view shows.

    It starts from the LiDAR points in its boxes; where those are too few, random ones in the box
    are added, of the points' mean colour.
    """
    actors = []
    for track in tracks:
        seers = [views.camera(name, frame) for frame in track.frames for name in views.cameras]
        moments = [frame for frame in track.frames for _ in views.cameras]
        largest = max(
            np.count_nonzero(track.shown(camera, frame))
            for camera, frame in zip(seers, moments, strict=True)
        )
        if largest:
            count = min(max(largest // PIXELS, FEWEST), MOST)
            xyz, rgb = _starting_points(track, clouds, count, rng)
            actors.append(_actor(track, xyz, rgb, device))
    return actors


def _starting_points(
    track: Track, clouds: dict[int, PointCloud], count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(count, 3) points in the box and their colours."""
    places, colours = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for frame in track.frames:
        cloud = clouds[frame]
        inside = cloud.select(track.holds(cloud.xyz, frame) & (cloud.camera >= 0))
        places.append(track.boxes[frame].local(inside.xyz))
        colours.append(inside.rgb)
    xyz, rgb = np.concatenate(places), np.concatenate(colours)
    keep = np.sort(rng.permutation(len(xyz))[:count])
    xyz, rgb = xyz[keep], rgb[keep]
    more = count - len(xyz)
    mean = rgb.mean(axis=0) if len(rgb) else np.full(3, 0.5)
    xyz = np.concatenate([xyz, rng.uniform(-0.5, 0.5, (more, 3)) * track.size])
    return xyz, np.concatenate([rgb, np.tile(mean, (more, 1))])


def _actor(track: Track, xyz: np.ndarray, rgb: np.ndarray, device: torch.device) -> Actor:
    gaussians = gaussians_from_points(xyz, rgb, sh_degree=1)
    later = gaussians.sh0.new_zeros(len(gaussians), FOURIER - 1, 3)
    centres = np.array([[box.x, box.y, box.z] for box in track.boxes.values()])
    yaws = np.radians([box.yaw for box in track.boxes.values()])
    gaussians.sh0 = torch.cat([gaussians.sh0, later], dim=1)

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.tensor(array, dtype=torch.float32, device=device)

    return Actor(
        f"actor {track.name}",
        gaussians.to(device),
        track.frames,
        size=tensor(track.size),
        centres=tensor(centres),
        yaws=tensor(yaws),
        shifts=tensor(np.zeros_like(centres)),
        turns=tensor(np.zeros_like(yaws)),
    )
