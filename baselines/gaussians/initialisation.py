"""Where Gaussians start: points of SfM, LiDAR or both, or random ones along the views' rays."""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from baselines.gaussians.options import FEWEST
from baselines.gaussians.sfm import triangulate
from geoevs.core.code_hash import code_hash
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.files import read_arrays, write_arrays
from geoevs.core.optimising import fingerprint
from geoevs.methods.contract import Views
from geoevs.scenes.scene import PointCloud

SOURCES = ("sfm", "lidar", "sfm and lidar", "random")

RANDOM_POINTS = 5000
RANDOM_DEPTHS, FAR_DEPTHS = (2.0, 100.0), (50.0, 200.0)
"""Ranges of depth in metres: from the bonnet to where a street's facades end, and where neither SfM
nor LiDAR sees."""

EXTENT_MARGIN = 1.1
LEAST_EXTENT = 20.0
"""Least extent of a scene in metres, as Street Gaussians has it. After a short drive far Gaussians
could hardly move without it."""


@dataclass(frozen=True)
class StartingPoints:
    """Coloured points, and a note that says where they come from and why not from elsewhere."""

    xyz: np.ndarray  # [N, 3] float32, world, metres
    rgb: np.ndarray  # [N, 3] float32 in [0, 1]
    note: str


def starting_points(
    views: Views,
    most: int,
    rng: np.random.Generator,
    first: str = "sfm",
    cache: str | Path | None = None,
) -> StartingPoints:
    """Points to put the first Gaussians at, from the first source that has enough of them.

    `first` is tried first, then SfM, the LiDAR where the method declared it, and random points.
    Of `sfm and lidar`, SfM's all stay, up to half of them: LiDAR is dense, and ends low on facades.

    Args:
        views: what the method may see.
        most: a random choice of this many points is kept of more.
        rng: chooses, and draws random points.
        first: one of SOURCES.
        cache: a folder that keeps the points of SfM, one file for each set of views and version of
            what finds them.

    Raises:
        GeoEvsError: there is no such source, or the cache is damaged.
    """
    if first not in SOURCES:
        raise GeoEvsError(f"points cannot start from '{first}'; {did_you_mean(first, SOURCES)}")
    sfm = functools.cache(lambda: _sfm_points(views, cache))  # seconds, and two sources have them
    makers: dict[str, Callable[[], StartingPoints]] = {
        "sfm": sfm,
        "lidar": lambda: _lidar_points(views),
        "sfm and lidar": lambda: _both(
            _at_most(sfm(), most // 2, rng), _lidar_points(views), most, rng
        ),
        "random": lambda: _random_points(views, rng, RANDOM_POINTS, RANDOM_DEPTHS),
    }
    reasons = []
    for source in dict.fromkeys([first, "sfm", "lidar", "random"]):
        if "lidar" in source and not views.has("lidar"):
            continue
        points = makers[source]()
        if len(points.xyz) >= FEWEST or source == "random":
            break
        reasons.append(f"{points.note}, too few")
    points = _at_most(points, most, rng)
    return dataclasses.replace(points, note="; ".join([f"starts from {points.note}", *reasons]))


def scene_extent(views: Views) -> float:
    """1.1 times the farthest source camera's distance from their mean, metres, as 3DGS has it."""
    centres = np.array(
        [views.camera(name, frame).centre for frame in views.frames for name in views.cameras]
    )
    radius = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    return max(EXTENT_MARGIN * float(radius), LEAST_EXTENT)


def _sfm_points(views: Views, cache: str | Path | None) -> StartingPoints:
    if cache is None:
        return _from_sfm(*triangulate(views))
    path = Path(cache) / f"{_identity(views)}.npz"
    if path.exists():
        arrays = read_arrays(path)
        kept = _from_sfm(arrays["xyz"], arrays["rgb"])
        return dataclasses.replace(kept, note=f"{kept.note}, kept from before")
    xyz, rgb = triangulate(views)
    write_arrays(path, {"xyz": xyz, "rgb": rgb})
    return _from_sfm(xyz, rgb)


def _from_sfm(xyz: np.ndarray, rgb: np.ndarray) -> StartingPoints:
    return StartingPoints(xyz, rgb, f"{len(xyz)} points of SfM")


def _identity(views: Views) -> str:
    """What decides the points: calibration, images, and what triangulates them."""
    parts = [pycolmap.__version__, code_hash("baselines.gaussians.sfm")]
    for frame in views.frames:
        for name in views.cameras:
            camera = views.camera(name, frame)
            parts += [frame, name, camera.K, camera.world_from_camera, views.image(name, frame)]
    return fingerprint(*parts)


def _lidar_points(views: Views) -> StartingPoints:
    """All frames' points that a camera gave a colour."""
    clouds = [views.lidar(frame) for frame in views.frames]
    coloured: list[PointCloud] = [cloud.select(cloud.camera >= 0) for cloud in clouds]
    xyz = np.concatenate([cloud.xyz for cloud in coloured])
    rgb = np.concatenate([cloud.rgb for cloud in coloured])
    return StartingPoints(xyz, rgb, f"{len(xyz)} LiDAR points")


def _at_most(points: StartingPoints, most: int, rng: np.random.Generator) -> StartingPoints:
    """A random choice of so many points, if there are more."""
    if len(points.xyz) <= most:
        return points
    keep = np.sort(rng.choice(len(points.xyz), most, replace=False))
    return StartingPoints(points.xyz[keep], points.rgb[keep], f"{most} of {points.note}")


def _both(
    all_of: StartingPoints, some_of: StartingPoints, most: int, rng: np.random.Generator
) -> StartingPoints:
    """All of some points, and as many of others as there is room for."""
    some_of = _at_most(some_of, most - len(all_of.xyz), rng)
    return _joined(all_of, some_of, f"{all_of.note} and {some_of.note}")


def _joined(one: StartingPoints, other: StartingPoints, note: str) -> StartingPoints:
    xyz, rgb = ([getattr(points, field) for points in (one, other)] for field in ("xyz", "rgb"))
    return StartingPoints(np.concatenate(xyz), np.concatenate(rgb), note)


def with_far_points(
    points: StartingPoints, count: int, views: Views, rng: np.random.Generator
) -> StartingPoints:
    """Some points, and random ones behind them, for the sky and what else has no features."""
    far = _random_points(views, rng, count, FAR_DEPTHS)
    return _joined(points, far, f"{points.note}; {count} far ones")


def _random_points(
    views: Views, rng: np.random.Generator, total: int, depths: tuple[float, float]
) -> StartingPoints:
    """Random pixels at random depths, as many in every octave of them."""
    seers = [(name, frame) for frame in views.frames for name in views.cameras]
    shares = np.bincount(rng.integers(len(seers), size=total), minlength=len(seers))
    xyz, rgb = [], []
    for (name, frame), count in zip(seers, shares, strict=True):
        camera, image = views.camera(name, frame), views.image(name, frame)
        rows = rng.integers(camera.height, size=count)
        columns = rng.integers(camera.width, size=count)
        depth = np.exp(rng.uniform(*np.log(depths), count))
        pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(count)])
        rays = camera.world_from_camera[:3, :3] @ np.linalg.solve(camera.K, pixels)
        xyz.append(camera.centre + (depth * rays).T)
        rgb.append(image[rows, columns])
    return StartingPoints(
        np.concatenate(xyz).astype(np.float32),
        np.concatenate(rgb).astype(np.float32),
        f"{total} random points",
    )
