"""What goes wrong in the field, in graded levels: worse sensors, worse calibration, harder views.

Most stressors change what methods are given and nothing else: `write_stressed` makes a scene store
as an import from worse sensors would have left it, while targets, references and truth stay those
of the clean scene. The others choose harder targets, worlds or pixels.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.randomness import Rng
from geoevs.projection import colour_points, zbuffer
from geoevs.scenes.scene import Frame, PointCloud
from geoevs.scenes.store import Scene, write_scene

Change = Callable[[Frame], Frame]


class Stressor(NamedTuple):
    """One axis along which methods are stressed.

    Args:
        title: what its levels count, with their unit.
        acts_on: `store` (see `write_stressed`), `world` (a data source's option), `targets` (poses
            farther away) or `pixels` (those that count).
        falling: whether lower levels are harder.
    """

    title: str
    acts_on: str
    falling: bool = False


STRESSORS = {
    "support": Stressor("valid pixels of the LiDAR condition, share", "store", falling=True),
    "beams": Stressor("LiDAR beams lost, share", "store"),
    "rotation": Stressor("rotation error of every camera, degrees", "store"),
    "translation": Stressor("position error of every camera, metres", "store"),
    "cameras": Stressor("source cameras lost", "store"),
    "exposure": Stressor("exposure difference between cameras, stops", "store"),
    "motion": Stressor("speed of moving vehicles, m/s", "world"),
    "lateral": Stressor("sideways offset of the target, metres", "targets"),
    "yaw": Stressor("yaw of the target, degrees", "targets"),
    "edges": Stressor("pixels at most this far from a depth edge, pixels", "pixels", falling=True),
}
MOTION_OPTION = "traffic_speed"
"""The data source's option that the levels of `motion` set."""


def stressor_named(name: str) -> Stressor:
    """The stressor called `name`.

    Raises:
        GeoEvsError: there is none; the sentence names the nearest one.
    """
    if name not in STRESSORS:
        raise GeoEvsError(f"there is no stressor '{name}'; {did_you_mean(name, STRESSORS)}")
    return STRESSORS[name]


def write_stressed(folder: Path, scene: Scene, stressor: str, level: float, seed: int) -> None:
    """Write the scene store that worse sensors would have given, whole or not at all.

    LiDAR points are coloured again, by the cameras and points that are left. Levels of one seed
    differ in degree alone: a lower share of points is a part of a higher one, an error of
    calibration keeps its direction.

    Args:
        folder: the new store.
        scene: the clean scene.
        stressor: one of STRESSORS that acts on the store.
        level: how hard, in the stressor's unit.
        seed: what is lost, and which way errors go.

    Raises:
        GeoEvsError: there is no such stressor, it acts on something else, or the scene cannot have
            this level.
    """
    if stressor_named(stressor).acts_on != "store":
        raise GeoEvsError(
            f"'{stressor}' changes no scene store; choose one of {', '.join(CHANGES)}"
        )
    rng = Rng(seed, "stress", scene.info.name, stressor).numpy
    change = CHANGES[stressor](scene, level, rng)
    frames = [_coloured(change(_frame(scene, frame))) for frame in scene.frames]
    info = dataclasses.replace(scene.info, cameras=tuple(frames[0].cameras))
    write_scene(folder, info, scene.tracks, iter(frames))


def _frame(scene: Scene, frame: int) -> Frame:
    cameras = {name: scene.camera(name, frame) for name in scene.cameras}
    images = {name: scene.image(name, frame) for name in scene.cameras}
    return Frame(frame, scene.timestamp(frame), cameras, images, scene.points(frame))


def _coloured(frame: Frame) -> Frame:
    points = colour_points(frame.points, frame.cameras, frame.images)
    return dataclasses.replace(frame, points=points)


def _thin(scene: Scene, level: float, rng: np.random.Generator) -> Change:
    """Keep a random share of points, so that `level` of the source pixels hold one to condition."""
    ranks = {frame: rng.random(len(scene.points(frame))) for frame in scene.frames}

    def support(share: float) -> float:
        ratios = []
        for frame, rank in ranks.items():
            points = scene.points(frame)
            kept = points.xyz[~scene.info.rig.scores(points) & (rank < share)]
            ratios += [
                zbuffer(kept, scene.camera(name, frame)).mask.mean() for name in scene.cameras
            ]
        return float(np.mean(ratios))

    if not 0 < level <= support(1.0):
        raise GeoEvsError(
            f"scene '{scene.info.name}' cannot have {level:g} of its pixels valid: its LiDAR fills "
            f"{support(1.0):.3f} of them; choose a level above 0 and below that"
        )
    low, high = 0.0, 1.0
    for _ in range(12):  # to a four-thousandth of the points
        middle = (low + high) / 2
        low, high = (middle, high) if support(middle) < level else (low, middle)
    return lambda frame: _select(frame, ranks[frame.frame] < high)


def _lose_beams(scene: Scene, level: float, rng: np.random.Generator) -> Change:
    """Lose a share of the beams that condition methods, the same ones in all frames."""
    clouds = [scene.points(frame) for frame in scene.frames]
    beams = np.unique(np.concatenate([_conditioning(scene, cloud).beam for cloud in clouds]))
    count = round(level * len(beams))
    if not 0 <= count < len(beams):
        raise GeoEvsError(
            f"scene '{scene.info.name}' has {len(beams)} LiDAR beams that condition methods; "
            f"losing {level:g} of them leaves none, so choose a lower level"
        )
    lost = rng.permutation(beams)[:count]
    return lambda frame: _select(
        frame, scene.info.rig.scores(frame.points) | ~np.isin(frame.points.beam, lost)
    )


def _conditioning(scene: Scene, points: PointCloud) -> PointCloud:
    return points.select(~scene.info.rig.scores(points))


def _select(frame: Frame, keep: np.ndarray) -> Frame:
    return dataclasses.replace(frame, points=frame.points.select(keep))


def _rotate(scene: Scene, level: float, rng: np.random.Generator) -> Change:
    """Turn each camera by `level` degrees about an axis of its own, the same in all frames."""
    errors = {}
    for name in scene.cameras:
        error = np.eye(4)
        turn = Rotation.from_rotvec(np.radians(level) * _direction(rng))
        error[:3, :3] = turn.as_matrix()
        errors[name] = error
    return lambda frame: _miscalibrate(frame, errors)


def _translate(scene: Scene, level: float, rng: np.random.Generator) -> Change:
    """Move each camera by `level` metres, the same way in all frames."""
    errors = {}
    for name in scene.cameras:
        error = np.eye(4)
        error[:3, 3] = level * _direction(rng)
        errors[name] = error
    return lambda frame: _miscalibrate(frame, errors)


def _direction(rng: np.random.Generator) -> np.ndarray:
    """(3,) unit vector, uniform on the sphere."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _miscalibrate(frame: Frame, errors: dict[str, np.ndarray]) -> Frame:
    """Poses as believed: the true ones, then (4, 4) errors in camera axes."""
    cameras = {
        name: dataclasses.replace(camera, world_from_camera=camera.world_from_camera @ errors[name])
        for name, camera in frame.cameras.items()
    }
    return dataclasses.replace(frame, cameras=cameras)


def _lose_cameras(scene: Scene, level: float, rng: np.random.Generator) -> Change:
    """Lose `level` of the cameras, never the front one."""
    others = [name for name in scene.cameras if name != scene.info.rig.front]
    if not 0 <= level <= len(others) or level != int(level):
        raise GeoEvsError(
            f"scene '{scene.info.name}' has {len(others)} cameras beside the front one; choose a "
            f"whole number of cameras to lose up to that, not {level:g}"
        )
    lost = set(rng.permutation(others)[: int(level)])

    def change(frame: Frame) -> Frame:
        cameras = {name: camera for name, camera in frame.cameras.items() if name not in lost}
        images = {name: frame.images[name] for name in cameras}
        return dataclasses.replace(frame, cameras=cameras, images=images)

    return change


def _expose(scene: Scene, level: float, rng: np.random.Generator) -> Change:
    """Spread the cameras' exposures evenly over `level` stops, in random order."""
    stops = np.linspace(-level / 2, level / 2, len(scene.cameras))
    chosen = dict(zip(scene.cameras, rng.permutation(stops), strict=True))

    def change(frame: Frame) -> Frame:
        images = {name: _exposed(image, chosen[name]) for name, image in frame.images.items()}
        return dataclasses.replace(frame, images=images)

    return change


def _exposed(image: np.ndarray, stops: float) -> np.ndarray:
    """(H, W, 3) of an image under 2^stops times the light, clipped; through the sRGB curve."""
    linear = np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear * 2.0**stops, 0.0, 1.0)
    curved = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    return curved.astype(np.float32)


CHANGES: dict[str, Callable[[Scene, float, np.random.Generator], Change]] = {
    "support": _thin,
    "beams": _lose_beams,
    "rotation": _rotate,
    "translation": _translate,
    "cameras": _lose_cameras,
    "exposure": _expose,
}
