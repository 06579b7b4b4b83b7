"""Bins: every tile holds what may be drawn in it, front to back, and no more."""

import itertools

import numpy as np
import pytest
import torch

from baselines.gaussians.binning_kernels import TILE, bin_splats, depth_order
from baselines.gaussians.projection_kernels import COLUMNS, DEPTH, project
from baselines.gaussians.reference import project as project_reference
from geoevs.projection.kernels import lens_of
from geoevs.scenes.camera import Camera

CAMERA = Camera([[60, 0, 40], [0, 60, 30], [0, 0, 1]], np.eye(4), 50, 75)
ROWS, TILES_ACROSS = 4, 5


def ellipses(rng: np.random.Generator, count: int) -> tuple:
    """(splats, radii, centres [N, 2], covariances [N, 2, 2], reach [N]), some long and thin."""
    z = rng.uniform(1, 4, (count, 1))
    means = np.hstack([rng.uniform(-0.9, 0.9, (count, 2)) * z, z])
    scales = z * np.exp(rng.normal(-3, 1, (count, 3)))
    quats, opacities = rng.normal(size=(count, 4)), rng.uniform(0.01, 1, count)
    arrays = [array.astype(np.float32) for array in (means, quats, scales, opacities)]
    splats, radii = project(*arrays, np.zeros((count, 1, 3), np.float32), lens_of(CAMERA))
    tensors = [torch.from_numpy(array).double() for array in arrays[:3]]
    centres, covariances = (part.numpy() for part in project_reference(*tensors, CAMERA))
    return splats, radii, centres, covariances, 2 * np.log(255 * arrays[3].astype(np.float64))


def nearest_in_tile(centre: np.ndarray, covariance: np.ndarray, left: int, top: int) -> float:
    """The least squared Mahalanobis distance of the rectangle of a tile's pixel centres."""
    low, high = np.array([left, top]) + 0.5, np.array([left, top]) + TILE - 0.5
    if ((low <= centre) & (centre <= high)).all():
        return 0.0
    along = np.linspace(0, 1, 501)[:, None]
    corners = [low, [high[0], low[1]], high, [low[0], high[1]], low]
    edges = [(1 - along) * a + along * b for a, b in itertools.pairwise(corners)]
    offsets = np.concatenate(edges) - centre
    return np.einsum("ni,ij,nj->n", offsets, np.linalg.inv(covariance), offsets).min()


@pytest.mark.parametrize("threads", [1, 3])
def test_bins_hold_the_ellipses_that_reach_them(threads: int) -> None:
    splats, radii, centres, covariances, reach = ellipses(np.random.default_rng(0), 80)
    order = depth_order(splats, radii)
    ids, starts = bin_splats(splats, order, ROWS, TILES_ACROSS, threads)
    assert starts[0] == 0
    assert starts[-1] == len(ids) > 200
    checked = 0
    for tile in range(ROWS * TILES_ACROSS):
        found = ids[starts[tile] : starts[tile + 1]]
        depths = splats[found, DEPTH]
        assert (np.diff(depths) >= 0).all()
        left, top = tile % TILES_ACROSS * TILE, tile // TILES_ACROSS * TILE
        for i in np.flatnonzero(radii > 0):
            margin = nearest_in_tile(centres[i], covariances[i], left, top) - reach[i]
            if abs(margin) > 1e-2:  # of a length that the sampling of edges resolves
                assert (i in found) == (margin < 0), (i, tile)
                checked += 1
    assert checked > 800


def test_depth_order_is_a_stable_sort() -> None:
    rng = np.random.default_rng(1)
    splats = np.zeros((5000, COLUMNS), np.float32)
    splats[:, DEPTH] = np.exp(rng.uniform(-4, 10, 5000)).astype(
        np.float16
    )  # so that many are equal
    radii = rng.integers(0, 3, 5000).astype(np.float32)
    visible = np.flatnonzero(radii)
    expected = visible[np.argsort(splats[visible, DEPTH], kind="stable")]
    np.testing.assert_array_equal(depth_order(splats, radii), expected)


def test_footprint_wider_than_any_integer() -> None:
    means = np.array([[0.0, 0, 0.011], [1e6, 0, 0.011]], np.float32)
    quats = np.array([[1.0, 0, 0, 0]] * 2, np.float32)
    scales = np.array([[1e18] * 3] * 2, np.float32)
    splats, radii = project(
        means, quats, scales, np.ones(2, np.float32), np.zeros((2, 1, 3), np.float32),
        lens_of(CAMERA),
    )  # fmt: skip
    assert (radii > 2.0**63).all()
    _, starts = bin_splats(splats, depth_order(splats, radii), ROWS, TILES_ACROSS, 1)
    np.testing.assert_array_equal(np.diff(starts), 2)
