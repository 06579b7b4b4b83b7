"""Pseudo-images of points placed by hand, one a pixel."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from baselines.freevs.pseudo_images import Sweeps
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import TRACK_COLUMNS, PointCloud

FRAMES = range(9)
# Looks along +x; a point (10, 0.5 - k, 0.5) falls into column k + 9 of row 9.
LOOKS = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
CAMERA = Camera([[10, 0, 10], [0, 10, 10], [0, 0, 1]], LOOKS, 20, 20)


def at(column, depth=10.0):
    """The point of row 9 and a column, at a depth."""
    return np.array([depth, (9.5 - column) * depth / 10, 0.05 * depth])


def cloud(points, colours=None, camera=0):
    points = np.array(points, np.float32).reshape(-1, 3)
    made = PointCloud.uncoloured(points, np.zeros(len(points)), np.zeros(len(points)))
    made.camera[:] = camera
    made.rgb[:] = 0.5 if colours is None else np.array(colours)[:, None]
    return made


def box(frame, column, track="car", moving=True, depth=10.0):
    x, y, z = at(column, depth)
    return (frame, track, "car", x, y, z, 0.6, 0.6, 0.6, 0.0, moving)


@pytest.fixture
def sweeps():
    """Makes sweeps of a cloud a frame and of boxes."""

    def make(clouds, boxes=()):
        tracks = pd.DataFrame(list(boxes), columns=list(TRACK_COLUMNS))
        views = SimpleNamespace(frames=tuple(FRAMES), lidar=clouds, tracks=tracks)
        return Sweeps.read(views)

    return make


def columns(raster):
    """The columns that hold a point; all lie in row 9."""
    assert not np.delete(raster.mask, 9, axis=0).any()
    return np.flatnonzero(raster.mask[9]).tolist()


@pytest.mark.parametrize(
    ("frame", "shift", "shown"),
    [
        (4, 0, [2, 3, 4, 5, 6]),
        (0, 0, [0, 1, 2]),
        (8, 0, [6, 7, 8]),
        (4, 4, [6, 7, 8]),
        (3, -4, [0, 1, 2]),  # no frame is there: the scene's first
        (2, 4, [4, 5, 6, 7, 8]),
    ],
)
def test_neighbouring_frames_are_accumulated(sweeps, frame, shift, shown):
    made = sweeps(lambda number: cloud([at(number)]))
    assert columns(made.pseudo_image(CAMERA, frame, shift)) == shown
    assert made.count == len(FRAMES)


def test_the_nearest_point_of_a_pixel_shows(sweeps):
    made = sweeps(lambda frame: cloud([at(5, 8.0), at(5, 4.0), at(5, 6.0)], [0.1, 0.2, 0.3]))
    seen = made.pseudo_image(CAMERA, 4)
    assert seen.image[9, 5] == pytest.approx(0.2)
    assert seen.depth[9, 5] == pytest.approx(4.0)
    assert not seen.image[~seen.mask].any()
    assert not seen.depth[~seen.mask].any()


def test_points_without_a_colour_are_left_out(sweeps):
    made = sweeps(lambda frame: cloud([at(frame)], camera=-1 if frame == 3 else 0))
    assert columns(made.pseudo_image(CAMERA, 4)) == [2, 4, 5, 6]


@pytest.mark.parametrize("moving", [True, False])
def test_what_moves_is_shown_where_it_is_now(sweeps, moving):
    boxes = [box(frame, 2 + frame, moving=moving) for frame in FRAMES]
    made = sweeps(lambda frame: cloud([at(2 + frame)] if frame in (2, 6) else []), boxes)
    # Measured in columns 4 and 8, and in frame 4 in column 6.
    assert columns(made.pseudo_image(CAMERA, 4)) == ([6] if moving else [4, 8])
    assert columns(made.pseudo_image(CAMERA, 5, 4)) == ([7] if moving else [8])


def test_what_is_gone_is_not_shown(sweeps):
    made = sweeps(lambda frame: cloud([at(2 + frame)]), [box(frame, 2 + frame) for frame in (2, 3)])
    assert columns(made.pseudo_image(CAMERA, 4)) == [6, 7, 8]


def test_objects_hide_the_background_and_nearer_objects_the_farther(sweeps):
    wide = Camera(CAMERA.K * [[24, 1, 24], [1, 1, 1], [1, 1, 1]], LOOKS, 20, 480)
    points = [at(5), at(6, 20.0), at(5, 5.0), at(9)]
    boxes = [box(4, 5, "near"), box(4, 6, "far", depth=20.0)]
    made = sweeps(
        lambda frame: cloud(points, [0.1, 0.2, 0.3, 0.4]) if frame == 4 else cloud([]), boxes
    )
    seen = made.pseudo_image(wide, 4)
    middle = [24 * column + 12 for column in (5, 6, 9)]
    # The nearer background point at column 5 is hidden all the same: objects come first.
    np.testing.assert_allclose(seen.image[9, middle, 0], [0.1, 0.2, 0.4], atol=1e-6)
    np.testing.assert_allclose(seen.depth[9, middle], [10, 20, 10], rtol=1e-6)
    # Two pixels beside the near object, the far one would be hidden.
    shifted = [box(4, 5, "near"), box(4, 5 + 2 / 24, "far", depth=20.0)]
    beside = [at(5), at(5 + 2 / 24, 20.0)]
    made = sweeps(lambda frame: cloud(beside, [0.1, 0.2]) if frame == 4 else cloud([]), shifted)
    assert made.pseudo_image(wide, 4).mask.sum() == 1


def test_nothing_at_all(sweeps):
    seen = sweeps(lambda frame: cloud([])).pseudo_image(CAMERA, 4)
    assert seen.image.shape == (20, 20, 3)
    assert not seen.mask.any()
