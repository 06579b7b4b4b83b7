"""Sun, sky and exposure of a scene, and the way from radiance to an 8-bit picture.

The unit of radiance is arbitrary: `sun` and the ambient colours say what a white surface reflects.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SHOULDER = 0.55  # display-linear value above which highlights roll off
CLOUD_TILE = 256
EXPOSURE = 0.23  # display-linear value of a sunlit grey street


@dataclass(frozen=True)
class Light:
    """The light of one scene; colours are linear RGB.

    Args:
        mood: what people would call it.
        to_sun: unit vector towards the sun.
        sun: radiance of a white surface that faces the sun.
        above, beside, below: ambient radiance of a white surface that faces up, sideways, down.
        zenith, horizon: colours of the clear sky.
        cloud_cover: 0 for a clear sky, 1 for a closed one.
        clouds: periodic noise in [0, 1].
        skyline: heights of the far silhouette, tangent of the elevation, around the compass.
        exposure: factor from radiance to display-linear values.
        haze_distance: metres after which 63 % of the view is haze.
    """

    mood: str
    to_sun: np.ndarray  # [3]
    sun: np.ndarray  # [3]
    above: np.ndarray  # [3]
    beside: np.ndarray  # [3]
    below: np.ndarray  # [3]
    zenith: np.ndarray  # [3]
    horizon: np.ndarray  # [3]
    cloud_cover: float
    clouds: np.ndarray  # [CLOUD_TILE, CLOUD_TILE]
    skyline: np.ndarray  # [M]
    exposure: float
    haze_distance: float

    def ambient(self, normals: np.ndarray) -> np.ndarray:
        """(..., 3) ambient radiance of white surfaces with (..., 3) unit `normals`.

        Walls that face the sun's side of the sky get more than those that turn their back to it.
        """
        up = normals[..., 2:]
        compass = self.to_sun[:2] / np.linalg.norm(self.to_sun[:2])
        sunward = 1 + 0.22 * (normals[..., :2] @ compass)[..., None]
        level = self.beside * sunward * (1 - np.abs(up))
        return level + self.above * np.maximum(up, 0) + self.below * np.maximum(-up, 0)

    def sky(self, directions: np.ndarray) -> np.ndarray:
        """(..., 3) radiance that arrives from (..., 3) unit `directions`."""
        up = directions[..., 2]
        height = np.clip(up, 0, 1)[..., None] ** 0.55
        colour = self.horizon * (1 - height) + self.zenith * height
        towards = np.clip(directions @ self.to_sun, 0, 1)[..., None]
        colour = colour + self.sun * (0.05 * towards**6 + 0.25 * towards**64)
        colour = self._with_clouds(colour, directions, towards)
        azimuth = np.arctan2(directions[..., 1], directions[..., 0]) / (2 * np.pi)
        place = azimuth % 1 * len(self.skyline)
        top = np.interp(
            place, np.arange(len(self.skyline) + 1), np.append(self.skyline, self.skyline[0])
        )
        behind = np.clip((top - up) / 0.004 + 0.5, 0, 1)[..., None]
        far = self.horizon * np.array([0.62, 0.66, 0.70])
        return colour * (1 - behind) + far * behind

    def _with_clouds(
        self, colour: np.ndarray, directions: np.ndarray, towards: np.ndarray
    ) -> np.ndarray:
        up = directions[..., 2]
        plane = directions[..., :2] / np.maximum(up, 0.04)[..., None]
        places = np.moveaxis(plane * CLOUD_TILE / 9, -1, 0)
        noise = map_coordinates(self.clouds, places, order=1, mode="grid-wrap")
        cover = np.clip((noise - 1 + self.cloud_cover) / 0.25, 0, 1) * np.clip(up / 0.15, 0, 1)
        white = self.horizon * 0.75 + 0.10 * self.sun * (1 + towards**4)
        return colour + (white - colour) * (0.85 * cover)[..., None]

    def develop(self, radiance: np.ndarray) -> np.ndarray:
        """(H, W, 3) radiance as (H, W, 3) uint8 sRGB, exposed, with a soft shoulder."""
        value = np.maximum(radiance * self.exposure, 0)
        room = 1 - SHOULDER
        bright = SHOULDER + room * (1 - np.exp(-np.maximum(value - SHOULDER, 0) / room))
        value = np.where(value > SHOULDER, bright, value)
        encoded = np.where(value < 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
        return np.rint(255 * np.clip(encoded, 0, 1)).astype(np.uint8)


# elevation (degrees), sun colour, sky at the zenith and horizon, ambient level, cloud cover, haze
MOODS = (
    ((44, 60), (2.3, 2.15, 1.95), (0.22, 0.43, 0.95), (0.90, 1.06, 1.25), 0.38, (0.1, 0.5), 1200),
    ((28, 40), (2.3, 1.95, 1.55), (0.23, 0.41, 0.84), (0.95, 1.00, 1.07), 0.37, (0.2, 0.6), 900),
    ((20, 27), (2.2, 1.60, 1.00), (0.26, 0.40, 0.72), (1.05, 0.93, 0.78), 0.36, (0.2, 0.6), 750),
    ((32, 50), (1.2, 1.15, 1.08), (0.50, 0.58, 0.70), (0.82, 0.86, 0.90), 0.46, (0.6, 0.9), 900),
)
MOOD_NAMES = ("sunny", "afternoon", "low sun", "overcast")


def make_light(rng: np.random.Generator) -> Light:
    """A random time of day and weather."""
    drawn = rng.integers(len(MOODS))
    elevations, *colours, level, covers, haze = MOODS[drawn]
    elevation, azimuth = np.radians(rng.uniform(*elevations)), rng.uniform(0, 2 * np.pi)
    flat = np.cos(elevation)
    to_sun = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    sun, zenith, horizon = map(np.array, colours)
    tint = 0.45 * zenith / (zenith @ LUMINANCE) + 0.55 * horizon / (horizon @ LUMINANCE)
    above = level * tint
    warm = sun / (sun @ LUMINANCE)
    grey_lit = 0.2 * (sun @ LUMINANCE * np.sin(elevation) + level)
    return Light(
        mood=MOOD_NAMES[drawn],
        to_sun=to_sun,
        sun=sun,
        above=above,
        beside=0.62 * above + 0.10 * level * warm,
        below=level * (0.22 * warm + 0.12),
        zenith=zenith,
        horizon=horizon,
        cloud_cover=rng.uniform(*covers),
        clouds=_clouds(rng),
        skyline=_skyline(rng),
        exposure=rng.uniform(0.9, 1.15) * EXPOSURE / grey_lit,
        haze_distance=haze * rng.uniform(0.8, 1.3),
    )


def _clouds(rng: np.random.Generator) -> np.ndarray:
    noise = np.zeros((CLOUD_TILE, CLOUD_TILE))
    for blur in (3, 6, 12, 24):
        layer = gaussian_filter(rng.normal(size=noise.shape), blur, mode="wrap")
        noise += layer / layer.std() * blur**0.8
    rank = noise.ravel().argsort().argsort() / noise.size
    return rank.reshape(noise.shape)


def _skyline(rng: np.random.Generator) -> np.ndarray:
    hills = gaussian_filter(rng.normal(size=720), 22, mode="wrap")
    houses = np.repeat(rng.uniform(0, 1, 240), 3) ** 3
    return 0.022 + 0.012 * hills / hills.std() * 0.5 + 0.02 * houses
