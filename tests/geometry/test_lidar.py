"""Completed depth against surfaces whose depth is known everywhere."""

import numpy as np
import pytest

from geoevs.geometry import lidar
from geoevs.geometry.lidar import complete_depth, lidar_reach, nearest
from geoevs.scenes.camera import Camera

HEIGHT, WIDTH = 40, 60
CAMERA = Camera([[60, 0, 30], [0, 60, 20], [0, 0, 1]], np.eye(4), HEIGHT, WIDTH, "test")
GREY = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)


def lift(uv, depth):
    """World points at pixel positions (N, 2) and depths (N,); CAMERA sits at the origin."""
    return np.column_stack([(uv - [30, 20]) / 60 * depth[:, None], depth])


def slanted(uv):
    """Depth of the plane z = 8 + x / 2 - y / 4 where it meets the ray of a pixel."""
    slope = (uv - [30, 20]) / 60
    return 8 / (1 - slope[..., 0] / 2 + slope[..., 1] / 4)


def test_a_plane_is_exact_within_its_points():
    rng = np.random.default_rng(0)
    uv = rng.uniform(0, [WIDTH, HEIGHT], (2000, 2))
    depth = complete_depth(lift(uv, slanted(uv)), CAMERA, GREY)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    truth = slanted(np.stack([columns, rows], axis=-1))
    inner = np.s_[4:-4, 4:-4]
    np.testing.assert_allclose(depth[inner], truth[inner], rtol=1e-5)
    np.testing.assert_allclose(depth, truth, rtol=0.1)  # beyond them, the nearest point's depth


def two_walls(image):
    """Points every 4 pixels on a wall at 5 m (columns below 28) and one at 20 m."""
    rows, columns = np.mgrid[2:HEIGHT:4, 2:WIDTH:4] + 0.5
    uv = np.column_stack([columns.ravel(), rows.ravel()])
    return complete_depth(lift(uv, np.where(uv[:, 0] < 28, 5.0, 20.0)), CAMERA, image)


def test_an_occlusion_edge_is_not_blended():
    depth = two_walls(GREY)
    assert set(np.unique(depth.round(3))) == {np.float32(5), np.float32(20)}
    # Points lie in columns 26 and 30: without any colour the edge is half-way.
    assert (depth[4:-4, :28] == 5).all()
    assert (depth[4:-4, 29:] == 20).all()


@pytest.mark.parametrize("edge", [28, 30])
def test_an_occlusion_edge_follows_the_image(edge):
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    image[:, edge:] = 1.0
    depth = two_walls(image)
    assert (depth[4:-4, :edge] == 5).all()
    assert (depth[4:-4, edge:] == 20).all()


def test_colour_extends_depth_above_the_highest_beam():
    # A near red post and a far wall, with points on their lower halves only.
    image = np.full((HEIGHT, WIDTH, 3), 0.3, np.float32)
    image[:, 28:34] = [1.0, 0.0, 0.0]
    rows, columns = np.mgrid[20:HEIGHT:3, 0:WIDTH:2] + 0.5
    uv = np.column_stack([columns.ravel(), rows.ravel()])
    post = (uv[:, 0] > 28) & (uv[:, 0] < 34)
    depth = complete_depth(lift(uv, np.where(post, 4.0, 12.0)), CAMERA, image)
    np.testing.assert_allclose(depth[10, 29:33], 4.0, rtol=1e-6)
    np.testing.assert_allclose(depth[10, :27], 12.0, rtol=1e-6)
    np.testing.assert_allclose(depth[10, 36:], 12.0, rtol=1e-6)


def test_long_triangles_are_no_surface():
    # Two dense patches of one depth, 40 pixels apart, with one far point between: interpolating
    # across the gap would bridge it at the patches' depth.
    rows, columns = np.mgrid[10:20:2, 2:10:2] + 0.5
    left = np.column_stack([columns.ravel(), rows.ravel()])
    middle = np.array([[30.5, 24.5]])
    uv = np.vstack([left, left + np.array([46, 0]), middle])
    z = np.where(np.arange(len(uv)) == len(uv) - 1, 30.0, 6.0)
    depth = complete_depth(lift(uv, z), CAMERA, GREY)
    assert depth[18, 30] == 30


@pytest.mark.parametrize("count", [0, 2])
def test_too_few_points_give_no_depth(count):
    points = lift(np.array([[10.5, 10.5], [20.5, 20.5]]), np.array([5.0, 6.0]))[:count]
    depth = complete_depth(points, CAMERA, GREY)
    assert depth.dtype == np.float32
    assert depth.shape == (HEIGHT, WIDTH)
    assert not depth.any()


def test_points_behind_the_camera_give_no_depth():
    points = np.random.default_rng(0).uniform(-9, -1, (50, 3))
    assert not complete_depth(points, CAMERA, GREY).any()


def test_points_in_one_line_give_the_nearest_depth():
    uv = np.array([[10.5, 20.5], [30.5, 20.5], [50.5, 20.5]])
    depth = complete_depth(lift(uv, np.array([5.0, 6.0, 7.0])), CAMERA, GREY)
    assert (depth[:21, 7:14] == 5).all()
    assert (depth[:21, 27:34] == 6).all()
    assert (depth[:21, 47:54] == 7).all()


def test_lidar_reaches_what_stands_above_it_and_little_else():
    seen = np.zeros((HEIGHT, WIDTH), bool)
    seen[15:25:3, 40:50] = True  # down to row 24; REACH is 6 pixels
    reach = lidar_reach(seen, CAMERA)
    assert reach.shape == seen.shape
    assert (reach[:25, 40:50] == 1).all()
    across, down = reach[10], reach[:, 45]
    np.testing.assert_allclose(across[33:41], np.arange(8) / 7, atol=1e-6)
    np.testing.assert_allclose(across[49:57], np.arange(7, -1, -1) / 7, atol=1e-6)
    np.testing.assert_allclose(down[24:32], np.arange(7, -1, -1) / 7, atol=1e-6)
    assert not across[:34].any()
    assert not lidar_reach(np.zeros_like(seen), CAMERA).any()


def test_depth_ends_where_lidar_does():
    rows, columns = np.mgrid[10:20:2, 0:9] + 0.5
    uv = np.column_stack([columns.ravel(), rows.ravel()])
    depth = complete_depth(lift(uv, slanted(uv)), CAMERA, GREY)
    assert (depth[:20, :9] > 0).all()
    assert not depth[:, 16:].any()
    assert not depth[26:].any()


def test_resolution_changes_nothing_but_the_grid():
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    image[:, 30:] = 1.0
    rows, columns = np.mgrid[2:HEIGHT:4, 2:WIDTH:4] + 0.5
    uv = np.column_stack([columns.ravel(), rows.ravel()])
    points = lift(uv, np.where(uv[:, 0] < 28, 5.0, 20.0))
    fine = image.repeat(2, axis=0).repeat(2, axis=1)
    twice = complete_depth(points, CAMERA.resized(2 * HEIGHT, 2 * WIDTH), fine)
    np.testing.assert_array_equal(twice[8:-8, :60], 5)
    np.testing.assert_array_equal(twice[8:-8, 60:], 20)


def test_the_nearest_are_the_same_on_any_number_of_threads(monkeypatch):
    rng = np.random.default_rng(0)
    candidates, queries = rng.random((40, 3)), rng.random((500, 3))
    far = np.linalg.norm(queries[:, None] - candidates, axis=2)
    asked, query = [], lidar.cKDTree.query

    class Tree(lidar.cKDTree):
        def query(self, *arguments, **options):
            asked.append(options["workers"])
            return query(self, *arguments, **options)

    monkeypatch.setattr(lidar, "cKDTree", Tree)
    for threads in (1, 2):
        monkeypatch.setattr(lidar.numba.config, "NUMBA_NUM_THREADS", threads)
        distance, index = nearest(candidates, queries, 4)
        np.testing.assert_array_equal(index, far.argsort(axis=1)[:, :4])
        np.testing.assert_allclose(distance, np.sort(far, axis=1)[:, :4])
        assert [part.shape for part in nearest(candidates[:3], queries[:0], 4)] == [(0, 3)] * 2
    assert asked == [1, 1, 2, 2]
