"""Pictures and depth at any camera, from the two Mitsuba scenes of an instant.

Every pass sees the same regular lattice of rays (no random sampling), so passes can be combined
ray by ray, and then averaged over each pixel's own area.
"""

from typing import Any

import numpy as np

from geoevs.scenes.camera import Camera
from geoevs.scenes.sources.street.light import Light
from geoevs.scenes.sources.street.stage import Scenes, cast, mitsuba
from geoevs.scenes.sources.street.traffic import Actor

NEAR = 0.01
SUN = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
GLOW = {"type": "path", "max_depth": 1}
REFLECTIONS = {"type": "path", "max_depth": 3}
DISTANCE = {"type": "depth"}


class Lattice:
    """A square grid of rays over a camera's image, and the average of its values per pixel.

    Mitsuba's pixels are square; a camera's need not be. So the lattice has its own spacing, and
    each of its rays counts for the pixel that it falls in.
    """

    def __init__(self, camera: Camera, density: int, shift: np.ndarray) -> None:
        """`density` rays a pixel each way at least; `shift` (2,) moves all, in lattice steps."""
        mi = mitsuba()
        focal = density * max(camera.K[0, 0], camera.K[1, 1])
        step = np.array([camera.K[0, 0], camera.K[1, 1]]) / focal  # pixels between rays
        size = np.array([camera.width, camera.height])
        count = np.ceil(size / step - 1e-6).astype(int)
        self._first = []
        for axis in (0, 1):
            centres = (np.arange(count[axis]) + 0.5) * step[axis]
            self._first.append(np.searchsorted(centres, np.arange(size[axis])))
        self._counts = [
            np.diff(np.append(first, total))
            for first, total in zip(self._first, count, strict=True)
        ]
        centre = camera.K[:2, 2] / step - shift
        opencv = np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba's x is left, its y is up
        self.sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov_axis": "x",
                "fov": float(np.degrees(2 * np.arctan(count[0] / 2 / focal))),
                "principal_point_offset_x": float(centre[0] / count[0] - 0.5),
                "principal_point_offset_y": float(centre[1] / count[1] - 0.5),
                "near_clip": NEAR,
                "far_clip": 5000.0,
                "to_world": mi.ScalarTransform4f(camera.world_from_camera @ opencv),
                "film": {
                    "type": "hdrfilm",
                    "width": int(count[0]),
                    "height": int(count[1]),
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                    "component_format": "float32",
                },
                "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
            }
        )

    def see(self, scene: Any, integrator: dict) -> np.ndarray:
        """(h, w, 3) what each ray of the lattice brings back."""
        mi = mitsuba()
        image = mi.render(scene, sensor=self.sensor, integrator=mi.load_dict(integrator), spp=1)
        return np.array(image)

    def average(self, values: np.ndarray) -> np.ndarray:
        """(H, W, C) means over each pixel of (h, w, C) values of the rays."""
        rows = np.add.reduceat(values, self._first[1], axis=0)
        sums = np.add.reduceat(rows, self._first[0], axis=1)
        return sums / np.outer(self._counts[1], self._counts[0])[..., None]


def pixel_rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) world directions through the pixel centres, with unit length along the axis."""
    x = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    y = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    rays = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
    return rays @ camera.world_from_camera[:3, :3].T


def render_depth(scenes: Scenes, camera: Camera) -> np.ndarray:
    """(H, W) float32 metres along the optical axis at the pixel centres, 0 for the sky."""
    rays = pixel_rays(camera).reshape(-1, 3)
    length = np.linalg.norm(rays, axis=1)
    distance, _ = cast(scenes.lit, camera.centre, rays / length[:, None])
    depth = np.where(np.isfinite(distance), distance / length, 0.0)
    return depth.reshape(camera.height, camera.width).astype(np.float32)


def render_image(
    scenes: Scenes,
    camera: Camera,
    light: Light,
    actors: list[Actor],
    time: float,
    density: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """(H, W, 3) uint8 picture.

    Args:
        scenes: the Mitsuba scenes of the instant.
        camera: from where.
        light: of the scene.
        actors: everybody, for the shade under them.
        time: seconds, tells where the actors are.
        density: rays a pixel, each way.
        rng: where in the pixels the lattice of rays lies.
    """
    shift = rng.uniform(-0.5, 0.5, 2)
    lattice = Lattice(camera, density, shift)
    distance = lattice.see(scenes.lit, DISTANCE)[..., :1]
    hit = (distance > 0).astype(np.float64)
    full = lattice.average(lattice.see(scenes.lit, SUN))
    glow = lattice.average(lattice.see(scenes.lit, GLOW))
    cover = lattice.average(hit)
    mean_distance = lattice.average(distance) / np.maximum(cover, 1e-9)

    rays = pixel_rays(camera)
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    points = camera.centre + mean_distance * unit
    radiance = full - glow * (1 - openness(points, actors, time))[..., None]
    radiance += _reflections(scenes, camera, max(density // 2, 1), shift)
    haze = cover * (1 - np.exp(-mean_distance / light.haze_distance))
    radiance = radiance * (1 - haze) + light.horizon * haze
    return light.develop(radiance + (1 - cover) * light.sky(unit))


def _reflections(scenes: Scenes, camera: Camera, density: int, shift: np.ndarray) -> np.ndarray:
    lattice = Lattice(camera, density, shift)
    hit = lattice.see(scenes.mirror, DISTANCE)[..., :1] > 0
    # In the mirror scene only glossy surfaces are without a glow of their own.
    glossy = hit & (lattice.see(scenes.mirror, GLOW).max(axis=-1, keepdims=True) == 0)
    return lattice.average(np.where(glossy, lattice.see(scenes.mirror, REFLECTIONS), 0.0))


def openness(points: np.ndarray, actors: list[Actor], time: float) -> np.ndarray:
    """(...) share of the sky that cars and pedestrians leave to (..., 3) points on the ground."""
    share = np.ones(points.shape[:-1])
    ground = points[..., 2] < 0.25
    below = points[ground]
    left = np.ones(len(below))
    for actor in actors:
        place = actor.at(time)
        cos, sin = np.cos(place.yaw), np.sin(place.yaw)
        away = below[:, :2] - [place.x, place.y]
        near = np.flatnonzero((np.abs(away) < 4.5).all(axis=1))
        along = np.abs(away[near] @ [cos, sin]) - actor.size[0] / 2 + 0.1
        aside = np.abs(away[near] @ [-sin, cos]) - actor.size[1] / 2 + 0.15
        outside = np.hypot(np.maximum(along, 0), np.maximum(aside, 0))
        inside = np.minimum(np.maximum(along, aside), 0)
        reach = 0.3 * actor.size[2]
        left[near] *= 1 - 0.75 * np.exp(-outside / reach) * (1 - 0.25 * np.exp(2 * inside))
    share[ground] = left
    return share
