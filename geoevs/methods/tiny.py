"""A tiny exact scene in pure NumPy: a textured box room with a parked car, for contract tests.

Depth and colour are closed forms, so that expectations can be derived by hand. Nothing here is
meant to look real; benchmark scenes come from `geoevs.scenes.sources`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from geoevs.methods.contract import Views
from geoevs.projection import colour_points
from geoevs.scenes.camera import Camera
from geoevs.scenes.road_map import Polygon, RoadMap
from geoevs.scenes.scene import (
    TRACK_COLUMNS,
    Frame,
    PointCloud,
    Rig,
    SceneExtras,
    SceneInfo,
    Truth,
)
from geoevs.scenes.store import Scene, write_scene

HEIGHT, WIDTH = 48, 72
FOCAL = 70.0  # pixels: about 54 degrees across
YAWS = {"front": 0.0, "left": 45.0, "right": -45.0}
FRAMES = (0, 1)
STEP = np.array([0.5, 0.0, 0.0])  # metres the ego drives each frame
MOUNT = np.array([0.0, 0.0, 1.6])  # of all cameras
LIDAR_ABOVE = np.array([0.0, 0.0, 1.0])  # the cameras, so that parallax hides some points

ROOM = np.array([[-10.0, -8.0, 0.0], [15.0, 8.0, 7.0]])  # seen from inside
CAR = np.array([[7.0, 1.0, 0.0], [9.0, 3.0, 1.4]])  # seen from outside
CAR_TINT = np.array([0.4, -0.2, -0.2])

FLOOR = {"drivable": (-4, 4), "sidewalk": (4, 8), "marking": (-0.1, 0.1), "crossing": (-4, 0)}
"""Surfaces of the floor, from one y to another along the whole room."""

BEAMS, AZIMUTHS = 32, 720
ELEVATIONS = (20.0, -25.0)  # degrees, the top beam's and the bottom one's


def tiny_camera(name: str, yaw: float, centre: np.ndarray) -> Camera:
    """A level camera of the tiny scene's size at `centre`, `yaw` degrees to the left of +x."""
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    pose = np.eye(4)
    pose[:3, :3] = [[s, 0, c], [-c, 0, s], [0, -1, 0]]
    pose[:3, 3] = centre
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return Camera(K, pose, HEIGHT, WIDTH, name)


def tiny_truth(camera: Camera) -> Truth:
    """Exact view of the tiny scene: (H, W, 3) uint8, and (H, W) float32 depth in metres."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    pixels = np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size)], axis=1)
    # With z = 1 in the camera, the distance along a ray is its depth.
    rays = pixels @ np.linalg.inv(camera.K).T @ camera.world_from_camera[:3, :3].T
    distance, tint = _cast(camera.centre, rays)
    rgb = _texture(camera.centre + distance[:, None] * rays) + tint
    shape = camera.height, camera.width
    image = np.rint(rgb * 255.0).astype(np.uint8).reshape(*shape, 3)
    return Truth(image, distance.astype(np.float32).reshape(shape))


def write_tiny_scene(
    folder: Path, cameras: Sequence[str] = tuple(YAWS), extras: SceneExtras | None = None
) -> Scene:
    """Write the tiny scene's store, with some of its cameras, and open it; with its map if no
    other extras are given.
    """
    extras = extras or SceneExtras(road_map=_road_map())
    info = SceneInfo(
        name="tiny",
        source="tiny",
        licence="CC0-1.0",
        rig=Rig("front", "left", "right", lidar_split="beam"),
        cameras=tuple(cameras),
        tags=("room",),
    )
    frames = _frames(info.cameras, extras.ego_masks)
    write_scene(folder, info, _tracks(), frames, extras)
    return Scene(folder)


def _frames(names: Sequence[str], ego_masks: Mapping[str, np.ndarray]) -> Iterator[Frame]:
    for frame in FRAMES:
        ego = MOUNT + frame * STEP
        cameras = {name: tiny_camera(name, YAWS[name], ego) for name in names}
        images = {name: tiny_truth(camera).rgb for name, camera in cameras.items()}
        points = colour_points(_sweep(ego + LIDAR_ABOVE), cameras, images, ego_masks)
        yield Frame(frame, 0.1 * frame, cameras, images, points)


def _sweep(centre: np.ndarray) -> PointCloud:
    elevation = np.radians(np.linspace(*ELEVATIONS, BEAMS))[:, None]
    azimuth = np.radians(np.arange(AZIMUTHS) * 360.0 / AZIMUTHS)[None]
    parts = np.broadcast_arrays(
        np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    )
    rays = np.stack(parts, axis=-1).reshape(-1, 3)
    distance, _ = _cast(centre, rays)
    beam = np.repeat(np.arange(BEAMS), AZIMUTHS)
    xyz = centre + distance[:, None] * rays
    return PointCloud.uncoloured(xyz, sensor=np.zeros_like(beam), beam=beam)


def _tracks() -> pd.DataFrame:
    centre, size = CAR.mean(axis=0), CAR[1] - CAR[0]
    rows = [(frame, "car-0", "car", *centre, *size, 0.0, False) for frame in FRAMES]
    return pd.DataFrame(rows, columns=list(TRACK_COLUMNS))


def with_hidden_black(scene: Scene, folder: Path, sees: str) -> Scene:
    """A copy of a scene whose pictures are black where a method must not see them.

    Args:
        scene: the original.
        folder: of the copy.
        sees: of `methods.contract.SEES`.
    """
    views = Views(scene, scene.cameras, (), sees)

    def image(name: str, frame: int) -> np.ndarray:
        shown = scene.image(name, frame)
        return shown if views.shows(frame) else np.zeros_like(shown)

    frames = (
        Frame(
            frame,
            scene.timestamp(frame),
            {name: scene.camera(name, frame) for name in scene.cameras},
            {name: image(name, frame) for name in scene.cameras},
            replace(points := scene.points(frame), rgb=np.zeros_like(points.rgb)),
        )
        for frame in scene.frames
    )
    write_scene(folder, scene.info, scene.tracks, frames, scene.extras(scene.cameras))
    return Scene(folder)


def _road_map() -> RoadMap:
    (west, *_), (east, *_) = ROOM
    rings = {
        surface: np.array([[west, y, 0], [east, y, 0], [east, z, 0], [west, z, 0]], float)
        for surface, (y, z) in FLOOR.items()
    }
    return RoadMap([Polygon(surface, [ring]) for surface, ring in rings.items()])


def _cast(
    centre: np.ndarray,  # [3]
    rays: np.ndarray,  # [N, 3]
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) in ray lengths to the first surface, and the surface's tint (N, 3)."""
    with np.errstate(divide="ignore"):
        room = (ROOM[:, None] - centre) / rays
        car = (CAR[:, None] - centre) / rays
    wall = room.max(axis=0).min(axis=1)
    enter, leave = car.min(axis=0).max(axis=1), car.max(axis=0).min(axis=1)
    hit = (enter < leave) & (enter > 0)
    return np.where(hit, enter, wall), hit[:, None] * CAR_TINT


def _texture(points: np.ndarray) -> np.ndarray:
    """(N, 3) smooth colours in [0.3, 0.6], to which any tint may be added."""
    waves = points @ np.array([[1.1, 0.7, 0.4], [0.9, -1.3, 0.8], [0.6, 0.5, -1.7]]).T
    return 0.45 + 0.15 * np.sin(waves)
