"""What goes wrong in the field, in graded levels: worse sensors, worse calibration, harder views.

Most stressors change what methods are given and nothing else: `write_stressed` makes a scene store
as an import from worse sensors would have left it, while targets, references and truth stay those
of the clean scene. The others choose harder targets, worlds or pixels.

All that is to be said of a stressor stands in STRESSORS, at the end.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.randomness import Rng
from geoevs.projection import colour_frame, zbuffer
from geoevs.scenes.scene import Frame, PointCloud
from geoevs.scenes.store import Scene, write_scene

USUAL_METRICS = ("sparse_psnr", "psnr", "psnr_supported", "psnr_new")
"""Metrics that are computed under most stressors, and without stress."""

FrameChange = Callable[[Frame], Frame]
StoreChange = Callable[[Scene, float, np.random.Generator], FrameChange]
"""Makes the change of every frame from a clean scene, a level and a random generator. It raises
GeoEvsError where the scene cannot have that level."""


@dataclass(frozen=True)
class Stressor:
    """One axis along which methods are stressed.

    Args:
        title: what its levels count, with their unit.
        kind: what it changes: `store` (what methods are given), `world` (an option of the data
            source), `targets` (poses farther away) or `pixels` (those that count).
        levels: those of a config that names none, mildest first.
        falling: whether lower levels are harder.
        change: of a `store`.
        option: of the data source, which the levels of a `world` set.
        metrics: what is asked, as far as the scene's answers allow.
    """

    title: str
    kind: str
    levels: tuple[float, ...]
    falling: bool = False
    change: StoreChange | None = None
    option: str = ""
    metrics: tuple[str, ...] = USUAL_METRICS


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
        stressor: one of STRESSORS, of kind `store`.
        level: how hard, in the stressor's unit.
        seed: what is lost, and which way errors go.

    Raises:
        GeoEvsError: there is no such stressor, it is of another kind, or the scene cannot have this
            level.
    """
    change = stressor_named(stressor).change
    if change is None:
        stores = ", ".join(name for name, other in STRESSORS.items() if other.kind == "store")
        raise GeoEvsError(f"'{stressor}' changes no scene store; choose one of {stores}")
    change_frame = change(scene, level, Rng(seed, "stress", scene.info.name, stressor).numpy)
    frames = [
        colour_frame(change_frame(_frame(scene, frame)), scene.ego_masks) for frame in scene.frames
    ]
    info = dataclasses.replace(scene.info, cameras=tuple(frames[0].cameras))
    write_scene(folder, info, scene.tracks, iter(frames), scene.extras(info.cameras))


def _frame(scene: Scene, frame: int) -> Frame:
    cameras = {name: scene.camera(name, frame) for name in scene.cameras}
    images = {name: scene.image(name, frame) for name in scene.cameras}
    exposures = {name: scene.exposure(name, frame) for name in scene.cameras}
    return Frame(
        frame,
        scene.timestamp(frame),
        cameras,
        images,
        scene.points(frame),
        exposures={name: exposure for name, exposure in exposures.items() if exposure},
    )


def _thin(scene: Scene, level: float, rng: np.random.Generator) -> FrameChange:
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


def _lose_beams(scene: Scene, level: float, rng: np.random.Generator) -> FrameChange:
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


def _rotate(scene: Scene, level: float, rng: np.random.Generator) -> FrameChange:
    """Turn each camera by `level` degrees about an axis of its own, the same in all frames."""
    errors = {}
    for name in scene.cameras:
        error = np.eye(4)
        turn = Rotation.from_rotvec(np.radians(level) * _direction(rng))
        error[:3, :3] = turn.as_matrix()
        errors[name] = error
    return lambda frame: _miscalibrate(frame, errors)


def _translate(scene: Scene, level: float, rng: np.random.Generator) -> FrameChange:
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


def _lose_cameras(scene: Scene, level: float, rng: np.random.Generator) -> FrameChange:
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


def _expose(scene: Scene, level: float, rng: np.random.Generator) -> FrameChange:
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


STRESSORS = {
    "support": Stressor(
        "valid pixels of the LiDAR condition, share",
        kind="store",
        levels=(0.1, 0.05, 0.01, 0.005),
        falling=True,
        change=_thin,
    ),
    "beams": Stressor(
        "LiDAR beams lost, share", kind="store", levels=(0.25, 0.5, 0.75, 0.9), change=_lose_beams
    ),
    "rotation": Stressor(
        "rotation error of every camera, degrees",
        kind="store",
        levels=(0.1, 0.5, 1, 2),
        change=_rotate,
    ),
    "translation": Stressor(
        "position error of every camera, metres",
        kind="store",
        levels=(0.01, 0.05, 0.1, 0.2),
        change=_translate,
    ),
    "cameras": Stressor(
        "source cameras lost", kind="store", levels=(1, 2, 3, 4), change=_lose_cameras
    ),
    "exposure": Stressor(
        "exposure difference between cameras, stops",
        kind="store",
        levels=(0.5, 1, 2, 3),
        change=_expose,
    ),
    "motion": Stressor(
        "speed of moving vehicles, m/s",
        kind="world",
        levels=(0, 5, 10, 20),
        option="traffic_speed",
        metrics=("psnr", "psnr_moving", "psnr_still"),
    ),
    "lateral": Stressor(
        "sideways offset of the target, metres", kind="targets", levels=(0, 1, 2, 3, 4)
    ),
    "yaw": Stressor("yaw of the target, degrees", kind="targets", levels=(0, 5, 10, 20, 30, 45)),
    "edges": Stressor(
        "pixels at most this far from a depth edge, pixels",
        kind="pixels",
        levels=(16, 8, 4, 2, 1),
        falling=True,
        metrics=("psnr",),
    ),
}
