"""Pixels inside boxes, on the tiny scene whose depth is a closed form."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.geometry.moving import moving_pixels, pixels_in_boxes
from geoevs.methods.tiny import CAR, ROOM, tiny_camera, tiny_truth
from geoevs.projection import unproject_depth
from geoevs.scenes.boxes import Box
from geoevs.scenes.scene import TRACK_COLUMNS

CAMERA = tiny_camera("aside", 15.0, np.array([0.0, 0.5, 1.6]))
DEPTH = tiny_truth(CAMERA).depth
MARGIN = 0.1
PARKED = Box(0, "car-0", "car", *CAR.mean(axis=0), *(CAR[1] - CAR[0]), 0.0, False)


def by_complex_numbers(box: Box, margin: float) -> np.ndarray:
    """(H, W) bool: on the ground plane, a turn by the yaw is a product of complex numbers."""
    points, pixels = unproject_depth(DEPTH, CAMERA)
    away = (points[:, 0] - box.x) + 1j * (points[:, 1] - box.y)
    along = away * np.exp(-1j * np.deg2rad(box.yaw))
    inside = 2 * np.abs(along.real) <= box.length + 2 * margin
    inside &= 2 * np.abs(along.imag) <= box.width + 2 * margin
    inside &= 2 * np.abs(points[:, 2] - box.z) <= box.height + 2 * margin
    return np.isin(np.arange(DEPTH.size), pixels[inside]).reshape(DEPTH.shape)


boxes = st.builds(
    Box,
    frame=st.just(0),
    track=st.just("car-0"),
    label=st.just("car"),
    x=st.floats(2, 14),
    y=st.floats(-6, 6),
    z=st.floats(0, 3),
    length=st.floats(0.1, 6),
    width=st.floats(0.1, 6),
    height=st.floats(0.1, 4),
    yaw=st.floats(-180, 180),
    moving=st.booleans(),
)


@given(st.lists(boxes, max_size=3), st.floats(0, 1))
def test_pixels_lie_in_any_of_the_boxes(some, margin):
    expected = np.zeros(DEPTH.shape, bool)
    for box in some:
        expected |= by_complex_numbers(box, margin)
    np.testing.assert_array_equal(pixels_in_boxes(DEPTH, CAMERA, some, margin), expected)
    moved = [box for box in some if box.moving]
    tracks = pd.DataFrame(some, columns=list(TRACK_COLUMNS))
    np.testing.assert_array_equal(
        moving_pixels(DEPTH, CAMERA, 0, tracks), pixels_in_boxes(DEPTH, CAMERA, moved)
    )
    assert not moving_pixels(DEPTH, CAMERA, 1, tracks).any()


@given(boxes, st.floats(0.5, 2))
def test_a_scaled_box_has_all_sides_multiplied(box, scale):
    sides = (box.length, box.width, box.height)
    length, width, height = (scale * side for side in sides)
    grown = box._replace(length=length, width=width, height=height)
    tracks = pd.DataFrame([box._replace(moving=True)], columns=list(TRACK_COLUMNS))
    np.testing.assert_array_equal(
        moving_pixels(DEPTH, CAMERA, 0, tracks, scale), by_complex_numbers(grown, 0.0)
    )


def test_pixels_in_a_box_are_those_of_its_car():
    inside = pixels_in_boxes(DEPTH, CAMERA, [PARKED], MARGIN)
    rays = unproject_depth(np.ones_like(DEPTH), CAMERA)[0] - CAMERA.centre
    with np.errstate(divide="ignore"):
        wall = ((ROOM[:, None] - CAMERA.centre) / rays).max(axis=0).min(axis=1)
    car = wall.reshape(DEPTH.shape) - 1e-3 > DEPTH
    assert car.sum() > 100
    assert inside[car].all()
    assert (inside & ~car).sum() < 0.2 * car.sum()  # the floor that touches it
    turned = PARKED._replace(yaw=90.0, x=PARKED.x - 30)
    assert not pixels_in_boxes(DEPTH, CAMERA, [turned], MARGIN).any()


@pytest.mark.parametrize(("margin", "inside"), [(0.0, 0), (0.05, 0), (0.15, 1)])
def test_a_margin_reaches_beyond_every_face(margin, inside):
    """One pixel sees a point 0.1 m above, before or beside a box."""
    depth = np.zeros(DEPTH.shape)
    depth[24, 36] = 5.0
    point = unproject_depth(depth, CAMERA)[0][0]
    for axis, field in enumerate(("x", "y", "z")):
        centre = dict(zip(("x", "y", "z"), point, strict=True))
        centre[field] = point[axis] - 1.1
        box = PARKED._replace(**centre, length=2.0, width=2.0, height=2.0)
        assert pixels_in_boxes(depth, CAMERA, [box], margin).sum() == inside
