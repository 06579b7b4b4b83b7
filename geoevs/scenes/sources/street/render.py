"""Pictures and depth at any camera, from the two Mitsuba scenes of an instant.

Rays go through regular lattices of places in the pixels, never to random places, so passes over
one lattice can be combined ray by ray.
"""

from typing import Any

import numpy as np

from geoevs.scenes.camera import Camera
from geoevs.scenes.sources.street.light import Light
from geoevs.scenes.sources.street.stage import Scenes, cast, mitsuba
from geoevs.scenes.sources.street.traffic import Actor

NEAR = 0.01
INTEGRATORS = {
    "lit": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},  # sun and glow
    "glow": {"type": "path", "max_depth": 1},
    "reflections": {"type": "path", "max_depth": 3},
    "distance": {"type": "depth"},
}


class Lattice:
    """One ray in every pixel of a camera's image, all at the same place in their pixels.

    Mitsuba's pixels are square; a camera's need not be. So the lattice is square, dense enough for
    the narrower side of a pixel, and each of its rays counts for the pixel that it falls in.
    """

    def __init__(self, camera: Camera, shift: np.ndarray) -> None:
        """`shift` (2,) is the place of a ray in its cell, in [0, 1)."""
        focal = np.array([camera.K[0, 0], camera.K[1, 1]])
        step = focal / focal.max()  # pixels between rays
        size = np.array([camera.width, camera.height])
        count = np.ceil(size / step - 1e-6).astype(int)
        places = [(np.arange(count[axis]) + shift[axis]) * step[axis] for axis in (0, 1)]
        self._first = [np.searchsorted(places[i], np.arange(size[i]) - 1e-9) for i in (0, 1)]
        ends = [np.append(self._first[i][1:], count[i]) for i in (0, 1)]
        self.rays = np.outer(ends[1] - self._first[1], ends[0] - self._first[0])[..., None]
        centre = camera.K[:2, 2] / step - shift + 0.5
        self._sensor = _make_sensor(camera, focal.max(), count, 0.5 - centre / count)

    def see(self, scene: Any, what: str) -> np.ndarray:
        """(h, w, 3) values that the rays bring back; `what` is one of INTEGRATORS."""
        mi = mitsuba()
        integrator = mi.load_dict(INTEGRATORS[what])
        image = mi.render(scene, sensor=self._sensor, integrator=integrator, spp=1)
        return np.array(image)

    def per_pixel(self, values: np.ndarray) -> np.ndarray:
        """(H, W, C) sums over each pixel of (h, w, C) values of the rays."""
        if values.shape[:2] == self.rays.shape[:2]:
            return values
        rows = np.add.reduceat(values, self._first[1], axis=0)
        return np.add.reduceat(rows, self._first[0], axis=1)


def _make_sensor(camera: Camera, focal: float, count: np.ndarray, offset: np.ndarray) -> Any:
    """`offset` is where the middle of the film lies from the principal point, in film widths."""
    mi = mitsuba()
    opencv = np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba's x is left, its y is up
    return mi.load_dict(
        {
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(np.degrees(2 * np.arctan(count[0] / 2 / focal))),
            "principal_point_offset_x": float(offset[0]),
            "principal_point_offset_y": float(offset[1]),
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


def lattice_shifts(count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 2) places in [0, 1)^2, as far apart as a lattice allows, moved at random together.

    No two share a row or a column, so that edges along the pixel grid come out smooth as well.
    """
    index = np.arange(count)

    def spread(step: int) -> float:
        apart = np.stack([index[1:], step * index[1:] % count], axis=1) / count
        return np.linalg.norm(np.minimum(apart, 1 - apart), axis=1).min(initial=1.0)

    coprime = [step for step in range(1, count + 1) if np.gcd(step, count) == 1]
    places = np.stack([index, max(coprime, key=spread) * index], axis=1) / count
    return (places + rng.uniform(0, 1, 2)) % 1.0


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
    samples: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """(H, W, 3) uint8 picture of a street at one instant.

    Args:
        scenes: the Mitsuba scenes of the instant.
        camera: from where.
        light: of the scene.
        actors: everybody, for the shade under them.
        time: seconds, tells where the actors are.
        samples: rays a pixel.
        rng: where in the pixels the rays go.
    """
    lit, glow_share = _lit(scenes.lit, camera, lattice_shifts(samples, rng))
    middle = Lattice(camera, np.array([0.5, 0.5]))
    distance = middle.per_pixel(middle.see(scenes.lit, "distance")) / middle.rays
    distance = distance[..., :1]

    rays = pixel_rays(camera)
    points = camera.centre + distance * rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    radiance = lit * (1 - glow_share * (1 - openness(points, actors, time))[..., None])
    mirrored = -(-samples // 4)  # reflections are dim, so fewer rays do
    radiance += _reflections(scenes.mirror, camera, lattice_shifts(mirrored, rng))
    haze = 1 - np.exp(-distance / light.haze_distance)
    return light.develop(radiance + (light.horizon - radiance) * haze)


def _lit(scene: Any, camera: Camera, shifts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) radiance under sun and ambient light, and the share that is ambient light.

    The share varies little, so every sixth lattice decides it; comparing the same rays makes it
    exactly 1 in the shade.
    """
    total, glow, whole = np.zeros((3, 1, 1, 1), np.float32)
    rays = np.zeros((1, 1, 1))
    for number, shift in enumerate(shifts):
        lattice = Lattice(camera, shift)
        values = lattice.per_pixel(lattice.see(scene, "lit"))
        total, rays = total + values, rays + lattice.rays
        if number % 6 == 0:
            glow = glow + lattice.per_pixel(lattice.see(scene, "glow"))
            whole = whole + values
    return total / rays, glow / np.maximum(whole, 1e-9)


def _reflections(mirror: Any, camera: Camera, shifts: np.ndarray) -> np.ndarray:
    """(H, W, 3) what glossy surfaces mirror."""
    total, rays = np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1))
    for shift in shifts:
        lattice = Lattice(camera, shift)
        # In the mirror scene only glossy surfaces are without a glow of their own.
        glossy = lattice.see(mirror, "glow").max(axis=-1, keepdims=True) == 0
        values = lattice.see(mirror, "reflections")
        total = total + lattice.per_pixel(np.where(glossy, values, 0.0))
        rays = rays + lattice.rays
    return total / rays


def openness(points: np.ndarray, actors: list[Actor], time: float) -> np.ndarray:
    """(...) share of the sky that reaches (..., 3) points past houses, cars and pedestrians."""
    share = 1 - 0.25 * np.exp(-np.maximum(points[..., 2], 0) / 3.0)  # streets are darker below
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
        left[near] *= 1 - 0.85 * np.exp(-outside / reach) * (1 - 0.25 * np.exp(2 * inside))
    share[ground] *= left
    return share
