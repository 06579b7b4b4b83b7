"""What public depth networks are shown of a run's images."""

import cv2
import numpy as np
import pytest
from PIL import Image

from geoevs.core.images import to_float
from geoevs.geometry.network_input import public_input, public_size, recorded_ratio
from geoevs.geometry.vggt import VGGT_1B, VGGT_NANO, resize_image
from geoevs.scenes.camera import Camera


def recorded(height, width, focal=900.0):
    """A camera with square pixels."""
    K = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
    return Camera(np.array(K), np.eye(4), height, width)


def picture(height, width, seed=0):
    coarse = np.random.default_rng(seed).integers(0, 256, (9, 16, 3), np.uint8)
    return cv2.resize(coarse, (width, height))


@pytest.mark.parametrize(
    ("size", "shown"),
    [
        ((128, 192), (350, 518)),  # enlarged
        ((512, 512), (518, 518)),
        ((1080, 1920), (294, 518)),  # PandaSet's
        ((900, 1600), (294, 518)),  # nuScenes's
        ((1280, 1920), (350, 518)),  # Waymo's to the front
        ((886, 1920), (238, 518)),  # and to the sides
        ((1920, 1080), (518, 294)),
    ],
)
@pytest.mark.parametrize("run", [None, (128, 192), (512, 512), (300, 100)])
def test_the_recorded_aspect_decides(size, shown, run):
    camera = recorded(*size)
    if run:
        camera = camera.resized(*run)
    assert recorded_ratio(camera) == pytest.approx(size[0] / size[1])
    assert public_size(camera, 518, 14) == shown


@pytest.mark.parametrize("size", [(128, 192), (512, 512), (1080, 1920)])
def test_unsquashed_images_are_shown_as_the_public_loader_shows_them(size):
    image = picture(*size)
    shown, windows = VGGT_1B.shown([image], [recorded(*size)])
    # load_fn.py: width 518, height in proportion and whole patches, bicubic.
    height = round(size[0] * (518 / size[1]) / 14) * 14
    expected = Image.fromarray(image).resize((518, height), Image.Resampling.BICUBIC)
    np.testing.assert_array_equal(shown[0], np.asarray(expected))
    assert shown[0][windows[0]].shape == shown[0].shape
    floats, _ = VGGT_1B.shown([to_float(image)], [recorded(*size)])
    np.testing.assert_array_equal(floats, to_float(shown))


def test_squashed_images_are_stretched_again():
    original, camera = picture(1080, 1920), recorded(1080, 1920)
    squashed = cv2.resize(original, (512, 512), interpolation=cv2.INTER_AREA)
    (first,), _ = public_input([original], [camera], 518, 14)
    (again,), _ = public_input([squashed], [camera.resized(512, 512)], 518, 14)
    assert first.shape == again.shape == (294, 518, 3)
    assert np.abs(first.astype(int) - again).mean() < 3


def test_views_of_several_aspects_lie_in_the_middle_of_white():
    sizes = [(1280, 1920), (886, 1920), (1920, 1280)]
    cameras = [recorded(*size).resized(64, 64) for size in sizes]
    shown, windows = public_input([picture(64, 64) // 2] * 3, cameras, 518, 14)
    assert shown.shape == (3, 518, 518, 3)
    assert [shown[0][window].shape[:2] for window in windows] == [
        (350, 518),
        (238, 518),
        (518, 350),
    ]
    for view, (rows, columns) in zip(shown, windows, strict=True):
        inside = np.zeros((518, 518), bool)
        inside[rows, columns] = True
        assert (view[~inside] == 255).all()
        assert view[inside].max() < 255
        assert abs(rows.start - (518 - (rows.stop or 518))) <= 1
        assert abs(columns.start - (518 - (columns.stop or 518))) <= 1


@pytest.mark.parametrize("size", [(128, 192), (64, 96), (512, 512), (130, 101)])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_the_suites_own_network_sees_the_runs_images_as_they_are(size, kind):
    images = [picture(*size, seed) for seed in range(2)]
    images = images if kind == np.uint8 else [to_float(image) for image in images]
    shown, windows = VGGT_NANO.shown(images, [recorded(*size).resized(*size)] * 2)
    assert shown.dtype == kind
    for view, window, image in zip(shown, windows, images, strict=True):
        np.testing.assert_array_equal(view, resize_image(image, VGGT_NANO.nearest_size(*size)))
        assert view[window].shape == view.shape
