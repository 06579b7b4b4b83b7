"""A picture of a frame's layout beside what its cameras recorded, for people to compare."""

import cv2
import numpy as np

from geoevs.conditions.layout import CAR, DRIVABLE, MARKING, NEARNESS, PEDESTRIAN, SIDEWALK, Layout
from geoevs.core.images import to_uint8
from geoevs.methods.contract import Views
from geoevs.scenes.road_map import SURFACES
from geoevs.scenes.store import Scene

GROUND = {DRIVABLE: (110, 110, 110), SIDEWALK: (90, 140, 90), MARKING: (255, 255, 255)}
"""Colours of the map's channels, each over those before it."""

BOXES = {CAR: (70, 130, 255), PEDESTRIAN: (255, 70, 70)}
"""Colours of boxes at NEARNESS 1; farther ones are darker."""

FROM_ABOVE = 60.0
"""Metres of a side of the view from above."""

GAP = 4
"""Pixels between pictures."""


def layout_sheet(scene: Scene, frame: int) -> np.ndarray:
    """(H, W, 3) uint8: a column a camera, left to right, and one from above.

    Its rows are what was recorded, the layout, and the one over the other.

    Raises:
        GeoEvsError: the scene has no such frame, or an image, box or map of it is damaged.
    """
    views = Views(scene, scene.cameras, ("tracks", "map"))
    layout = Layout.of(views, frame)
    cameras = [views.camera(name, frame) for name in views.cameras]
    turned = sorted(cameras, key=lambda camera: (camera.yaw - layout.yaw + 180) % 360, reverse=True)
    columns = []
    for camera in turned:
        recorded = to_uint8(views.image(camera.name, frame))
        drawn = false_colour(layout.image(camera))
        columns.append([recorded, drawn, cv2.addWeighted(recorded, 0.5, drawn, 0.5, 0)])
    height = max(picture.shape[0] for column in columns for picture in column)
    padded = [np.concatenate([_framed(one, height) for one in column]) for column in columns]
    above = _from_above(layout, 3 * (height + GAP))
    return np.concatenate([*padded, above], axis=1)


def false_colour(
    layout: np.ndarray,  # [H, W, 9]
) -> np.ndarray:
    """(H, W, 3) uint8: a layout image in colours."""
    picture = np.zeros((*layout.shape[:2], 3), np.float32)
    for channel, colour in GROUND.items():
        share = layout[..., channel, None]
        picture = (1 - share) * picture + share * np.array(colour, np.float32)
    for channel, colour in BOXES.items():
        covered = layout[..., channel] > 0
        shade = 0.35 + 0.65 * layout[covered, NEARNESS, None]
        picture[covered] = shade * np.array(colour, np.float32)
    return np.rint(picture).astype(np.uint8)


def _framed(picture: np.ndarray, height: int) -> np.ndarray:
    missing = height - picture.shape[0]
    return np.pad(picture, ((0, missing + GAP), (0, GAP), (0, 0)), constant_values=255)


def _from_above(layout: Layout, side: int) -> np.ndarray:
    """(side, side, 3) uint8, ahead upwards."""
    seen = layout.bev(FROM_ABOVE, side)
    picture = np.full((side, side, 3), 30, np.uint8)
    order = (DRIVABLE, SIDEWALK, MARKING)
    for channel, surface in zip(order, ("drivable", "sidewalk", "marking"), strict=True):
        picture[seen[..., SURFACES.index(surface)]] = GROUND[channel]
    for place, colour in enumerate(BOXES.values(), start=len(SURFACES)):
        picture[seen[..., place]] = colour
    return picture
