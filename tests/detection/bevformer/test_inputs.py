"""Frames that are resized, mirrored and refused."""

from dataclasses import replace

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.detection.bevformer.inputs import in_scenes


def pixels(projection, points):
    seen = points @ projection[:, :3].T + projection[:, 3]
    return seen[:, :2] / seen[:, 2:], seen[:, 2]


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform([2, -9, 0], [20, 9, 3], (50, 3))


def test_a_mirrored_frame_shows_mirrored_points_at_mirrored_pixels(make_frame, points):
    frame = make_frame()
    mirrored = frame.mirrored()
    width = frame.size[1]
    for n, projection in enumerate(frame.image_from_vehicle):
        (uv, depth), (mirror, same) = (
            pixels(projection, points),
            pixels(mirrored.image_from_vehicle[n], points * [1, -1, 1]),
        )
        np.testing.assert_allclose(same, depth)
        np.testing.assert_allclose(mirror, uv * [-1, 1] + [width, 0])
        np.testing.assert_array_equal(mirrored.images[n], frame.images[n, :, ::-1])
    x, y, heading = mirrored.boxes[:, 0], mirrored.boxes[:, 1], mirrored.boxes[:, 6]
    np.testing.assert_array_equal(x, frame.boxes[:, 0])
    np.testing.assert_array_equal((y, heading), (-frame.boxes[:, 1], -frame.boxes[:, 6]))


def test_mirrored_twice_a_frame_is_itself(make_frame):
    frame = make_frame(turned=0.3, x=4.0)
    twice = frame.mirrored().mirrored()
    for name in ("images", "image_from_vehicle", "world_from_vehicle", "boxes"):
        np.testing.assert_allclose(getattr(twice, name), getattr(frame, name), atol=1e-12)


def test_a_mirrored_vehicle_turns_the_other_way(make_frame):
    before, after = make_frame(), make_frame(frame=1, x=3.0, turned=0.2)
    move = np.linalg.inv(before.world_from_vehicle) @ after.world_from_vehicle
    pair = [frame.mirrored().world_from_vehicle for frame in (before, after)]
    mirrored = np.linalg.inv(pair[0]) @ pair[1]
    assert np.arctan2(mirrored[1, 0], mirrored[0, 0]) == pytest.approx(-0.2)
    np.testing.assert_allclose(mirrored[:3, 3], move[:3, 3] * [1, -1, 1])


def test_a_resized_frame_shows_points_at_scaled_pixels(make_frame, points):
    frame = make_frame()
    smaller = frame.resized((8, 8))
    assert smaller.images.shape == (5, 8, 8, 3)
    assert frame.resized(frame.size) is frame
    uv, scaled = (pixels(one.image_from_vehicle[2], points)[0] for one in (frame, smaller))
    np.testing.assert_allclose(scaled, uv * [8 / 24, 8 / 16])
    assert smaller.images.mean() == pytest.approx(frame.images.mean(), abs=1e-6)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"images": np.zeros((5, 16, 24))}, "images have the shape .* for each of the 5 cameras"),
        ({"images": np.zeros((4, 16, 24, 3))}, "images have the shape"),
        ({"image_from_vehicle": np.zeros((5, 3, 3))}, r"image_from_vehicle has the shape \(5, 3,"),
        ({"boxes": np.full((2, 7), np.nan)}, "street/0: boxes has NaN or infinite numbers"),
        ({"classes": np.zeros(3, int)}, "boxes has the shape"),
        ({"recorded": np.zeros(0, bool), "image_from_vehicle": np.zeros((0, 3, 4))}, "no camera"),
    ],
)
def test_frames_that_are_none_are_refused(make_frame, values, sentence):
    with pytest.raises(GeoEvsError, match=sentence):
        replace(make_frame(), **values)


def test_scenes_are_told_apart_and_ordered(make_frame):
    frames = [make_frame(scene=scene, frame=n) for scene, n in (("a", 0), ("b", 0), ("a", 1))]
    assert in_scenes(frames) == {"a": [0, 2], "b": [1]}
    with pytest.raises(GeoEvsError, match="'a' are not ordered in time: 1 is not before 0"):
        in_scenes(frames[::-1])
    with pytest.raises(GeoEvsError, match="there are no frames"):
        in_scenes([])
