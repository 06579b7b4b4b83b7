"""Surface finishes: repeating albedo tiles made from scikit-image's own photographs, and gloss."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, zoom
from skimage import data
from skimage.transform import ProjectiveTransform, resize, warp

WALLS = 9  # wall finishes of a scene: wall-0 ... wall-8
BRICK_WALLS = 4  # the first of them are brick
BRICK_COLOURS = (
    (0.36, 0.13, 0.08),
    (0.27, 0.12, 0.09),
    (0.45, 0.27, 0.16),
    (0.33, 0.19, 0.12),
    (0.50, 0.38, 0.25),
)
PLASTER_COLOURS = (
    (0.70, 0.62, 0.46),
    (0.66, 0.48, 0.34),
    (0.72, 0.70, 0.65),
    (0.46, 0.52, 0.56),
    (0.58, 0.62, 0.50),
    (0.62, 0.36, 0.28),
    (0.76, 0.66, 0.36),
    (0.42, 0.42, 0.44),
)


@dataclass(frozen=True)
class Finish:
    """The material of a surface.

    Args:
        tile: albedo, or None where the mesh carries its own colours.
        metres: width and height of the tile on the surface.
        index: refractive index of the clear coat, or None for a matt surface.
    """

    tile: np.ndarray | None = None  # [S, S, 3] linear
    metres: tuple[float, float] = (1.0, 1.0)
    index: float | None = None


def make_finishes(rng: np.random.Generator) -> dict[str, Finish]:
    """The finishes of one scene."""
    finishes = {
        "matte": Finish(),
        "paint": Finish(index=1.5),
        "glass": Finish(index=2.0),
        "asphalt": Finish(_grained("gravel", (0.125, 0.125, 0.13), 0.16), (1.6, 1.6)),
        "patch": Finish(_grained("gravel", (0.085, 0.085, 0.09), 0.14), (1.6, 1.6)),
        "gravel": Finish(_grained("gravel", (0.36, 0.33, 0.29), 0.5), (1.8, 1.8)),
        "grass": Finish(_grass(rng.uniform(0.8, 1.2)), (2.2, 2.2)),
        "hedge": Finish(0.6 * _grass(0.9), (1.4, 1.4)),
        "worn": Finish(_grained("gravel", (0.105, 0.105, 0.11), 0.13), (1.6, 1.6)),
        "paving": Finish(_paving(rng), (2.4, 2.4)),
        "roof": Finish(_roof(rng), (1.6, 1.6)),
    }
    bricks = rng.choice(len(BRICK_COLOURS), BRICK_WALLS, replace=False)
    plasters = rng.choice(len(PLASTER_COLOURS), WALLS - BRICK_WALLS, replace=False)
    for number, colour in enumerate(bricks):
        tint = np.array(BRICK_COLOURS[colour]) * rng.uniform(0.9, 1.15)
        finishes[f"wall-{number}"] = Finish(_brick_wall(tint, rng), (2.5, 0.76))
    for number, colour in enumerate(plasters):
        tint = np.array(PLASTER_COLOURS[colour]) * rng.uniform(0.85, 1.05)
        finishes[f"wall-{BRICK_WALLS + number}"] = Finish(_grained("gravel", tint, 0.07), (2, 2))
    return finishes


@cache
def _photo(name: str) -> np.ndarray:
    """(256, 256) periodic, evenly lit grain with mean 0 and standard deviation 1."""
    image = resize(getattr(data, name)() / 255.0, (256, 256), anti_aliasing=True)
    image -= gaussian_filter(image, 32, mode="reflect")
    ramp = 1 - np.abs(np.linspace(-1, 1, 256))
    weight = np.clip(3 * np.minimum.outer(ramp, ramp), 0, 1)
    rolled = np.roll(image, (128, 128), (0, 1))  # its seams lie where the first image counts fully
    mixed = weight * image + (1 - weight) * rolled
    mixed /= np.sqrt(weight**2 + (1 - weight) ** 2)  # mixing two grains must not flatten them
    return (mixed - mixed.mean()) / mixed.std()


def _grained(photo: str, colour: ArrayLike, contrast: float) -> np.ndarray:
    grain = np.clip(_photo(photo), -2.5, 2.5)
    return np.clip(np.array(colour) * (1 + contrast * grain[..., None]), 0.01, 0.9)


def _grass(lush: float) -> np.ndarray:
    grain = np.clip(_photo("grass"), -2.5, 2.5)[..., None]
    dry, green = np.array([0.20, 0.19, 0.075]), np.array([0.065, 0.125, 0.03]) * lush
    mix = np.clip(0.35 + 0.25 * grain, 0, 1)
    return np.clip((green * (1 - mix) + dry * mix) * (1 + 0.25 * grain), 0.01, 0.9)


@cache
def _brick_photo() -> np.ndarray:
    """(192, 640) ten courses of the photographed brick paving, seen straight on, periodic."""
    corners = np.array([[99, 0], [396, 0], [467, 500], [48, 500]], float)  # between mortar joints
    flat = np.array([[0, 0], [192, 0], [192, 320], [0, 320]], float)
    straight = ProjectiveTransform.from_estimate(flat, corners)
    courses = warp(data.brick() / 255.0, straight, output_shape=(320, 192)).T
    return np.concatenate([courses, courses[:, ::-1]], axis=1)


def _brick_wall(colour: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    photo = _brick_photo()
    mortar = np.clip((photo - 0.42) / 0.14, 0, 1)[..., None]
    shade = photo / np.median(photo)
    drift = zoom(rng.normal(size=(12, 20)), (16, 32), order=1)
    bricks = colour * (shade * (1 + 0.08 * drift))[..., None]
    joint = 0.55 * np.array([0.55, 0.52, 0.47]) + 0.3 * colour
    return np.clip(bricks * (1 - mortar) + joint * mortar, 0.01, 0.9)


def _paving(rng: np.random.Generator) -> np.ndarray:
    """Slabs of 60 cm with joints, four by four."""
    slabs = np.kron(rng.normal(size=(4, 4)), np.ones((64, 64)))
    place = np.arange(256) % 64
    joint = np.minimum.outer(np.minimum(place, 63 - place), np.full(256, 99))
    joint = np.minimum(joint, joint.T) < 1
    grain = np.clip(_photo("gravel"), -2, 2)
    tone = 0.33 * (1 + 0.05 * slabs + 0.06 * grain) * np.where(joint, 0.55, 1)
    return np.clip(tone[..., None] * np.array([1.0, 0.97, 0.91]), 0.01, 0.9)


def _roof(rng: np.random.Generator) -> np.ndarray:
    """Rows of roof tiles."""
    colour = np.array([(0.34, 0.13, 0.08), (0.22, 0.21, 0.22), (0.28, 0.17, 0.11)][rng.integers(3)])
    rows = 0.65 + 0.5 * (np.arange(256) % 32) / 32
    columns = 1 + 0.12 * np.cos(2 * np.pi * np.arange(256) / 32)
    tiles = np.kron(rng.normal(size=(8, 8)), np.ones((32, 32)))
    tone = rows[:, None] * columns * (1 + 0.08 * tiles)
    return np.clip(tone[..., None] * colour, 0.01, 0.9)
