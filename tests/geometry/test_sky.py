"""The sky of an image made by hand."""

import numpy as np

from geoevs.geometry.sky import find_sky
from geoevs.methods.tiny import HEIGHT, WIDTH, tiny_camera
from geoevs.projection import project_points


def test_sky_is_bright_smooth_and_without_points():
    camera = tiny_camera("front", 0.0, np.zeros(3))
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 0.5, (HEIGHT, WIDTH, 3))  # rough
    image[:20] = 0.8
    image[:20, :30] = 0.2  # smooth but dark
    wall = np.array([[12.0, -6.0, 0.5]])  # on the right, above the camera and near
    ground = np.array([[12.0, -2.0, -0.5]])
    sky = find_sky(image, ground, camera)
    assert sky[1:19, 32:].all()
    assert not sky[21:].any()
    assert not sky[:, :29].any()
    image[:20, 60:] = rng.uniform(0.7, 0.9, (20, 12, 3))
    image[:20, 50:60] = [0.8, 0.8, 0.7]  # parted from the rest by its colour, and on the wall
    u = project_points(wall, camera)[0][0, 0]
    walls = np.array([[12.0, y, 0.5] for y in np.linspace(-2.3, -4.2, 12)])
    assert u > 60
    sky = find_sky(image, walls, camera)
    assert sky[1:19, 32:48].all()
    assert not sky[:, 51:].any()


def test_an_image_may_be_all_sky():
    camera = tiny_camera("front", 0.0, np.zeros(3))
    nothing = np.zeros((0, 3))
    even = np.full((HEIGHT, WIDTH, 3), (0.35, 0.5, 0.8))
    paler = even + np.linspace(0, 0.15, HEIGHT)[:, None, None]  # towards the horizon
    for image in (even, paler):
        assert find_sky(image, nothing, camera).all()
    assert not find_sky(0 * even, nothing, camera).any()  # a covered lens
