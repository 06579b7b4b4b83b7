"""Deformable attention, beside plain twins."""

import math

import numpy as np
import pytest
import torch

from geoevs.detection.bevformer.attention import (
    Aim,
    BevAttention,
    Past,
    SpatialCrossAttention,
    TemporalSelfAttention,
    look_up,
    sample,
)
from geoevs.detection.bevformer.settings import HEADS


def bilinear(image, x, y):
    """A twin of bilinear sampling: (C,) of a (C, h, w) image at cells, whose middles are at .5."""
    found = np.zeros(len(image))
    left, top = math.floor(x - 0.5), math.floor(y - 0.5)
    for column in (left, left + 1):
        for row in (top, top + 1):
            share = (1 - abs(x - 0.5 - column)) * (1 - abs(y - 0.5 - row))
            if 0 <= row < image.shape[1] and 0 <= column < image.shape[2]:
                found += share * image[:, row, column]
    return found


def looked(values, places, weights):
    """A twin of `sample` for one query: (M C,) of (M, C, h, w), (M, P, 2) and (M, P)."""
    height, width = values.shape[2:]
    parts = []
    for head in range(len(values)):
        total = np.zeros(values.shape[1])
        for (x, y), weight in zip(places[head], weights[head], strict=True):
            total += weight * bilinear(values[head], x * width, y * height)
        parts.append(total)
    return np.concatenate(parts)


@pytest.fixture
def random():
    return torch.Generator().manual_seed(0)


def drawn(random, *shape):
    return torch.rand(*shape, generator=random, dtype=torch.float64)


def shaken(module, random):
    """A module in float64 whose offsets and weights depend on the query."""
    module = module.double()
    with torch.no_grad():
        for weight in module.parameters():
            weight += 0.2 * torch.randn(weight.shape, generator=random, dtype=torch.float64)
    return module


def test_sampling_is_its_twin(random):
    values, weights = drawn(random, 2, 3, 4, 5, 6), drawn(random, 2, 3, 7, 2)
    places = drawn(random, 2, 3, 7, 2, 2) * 1.4 - 0.2  # some are outside
    got = sample(values, places, weights).numpy()
    for item in range(2):
        for query in range(7):
            parts = (values[item], places[item, :, query], weights[item, :, query])
            twin = looked(*(part.numpy() for part in parts))
            np.testing.assert_allclose(got[item, query], twin, atol=1e-12)


def test_gradients_of_sampling_are_right(random):
    inputs = [drawn(random, 1, 2, 2, 3, 4), drawn(random, 1, 2, 3, 2, 2), drawn(random, 1, 2, 3, 2)]
    assert torch.autograd.gradcheck(sample, [part.requires_grad_() for part in inputs])


def test_a_query_looks_on_rings_first():
    offsets, weights = Aim(8, points=4, groups=2, maps=1)(torch.randn(1, 1, 8))
    assert offsets.shape == (1, 1, HEADS, 1, 4, 2)
    for head, direction in enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)]):
        rings = np.outer([1, 1, 2, 2], direction)
        np.testing.assert_allclose(offsets[0, 0, head, 0].detach(), rings, atol=1e-6)
    np.testing.assert_allclose(weights.detach(), 1 / 4)


def test_looks_into_a_bev_are_their_twin(random):
    look = shaken(BevAttention(8, (3, 4)), random)
    query, reference, bev = (
        drawn(random, 2, 5, 8),
        drawn(random, 2, 5, 2),
        drawn(random, 2, 12, 8),
    )
    with torch.no_grad():
        got = look(query, reference, bev)
        values = look.values(bev, (3, 4)).numpy()
        offsets, weights = (part[0].numpy() for part in look.aim(query))
        for item in range(2):
            seen = [
                looked(values[item], at + offsets[item, :, n] / [4, 3], weights[item, :, n])
                for n, at in enumerate(reference[item].numpy())
            ]
            twin = look.out(torch.from_numpy(np.stack(seen)))
            np.testing.assert_allclose(got[item], twin, atol=1e-12)


def seen_views(random, views, items, cells=6, heights=2):
    """Views with features of 2 x 3 places, in turns of each item, and which cells they see."""
    features, places = drawn(random, views, 8, 2, 3), drawn(random, views, cells, heights, 2)
    visible = drawn(random, views, cells, heights) < 0.3
    visible[:, 0] = False  # a cell that nobody sees
    return features, torch.arange(views) % items, places, visible, items


def test_looks_into_views_are_their_twin(random):
    cross = shaken(SpatialCrossAttention(8, points=4, heights=2), random)
    query, views = drawn(random, 2, 6, 8), seen_views(random, 5, 2)
    features, item, places, visible, _ = views
    with torch.no_grad():
        got = cross(query, look_up(*views))
        values = cross.values(features.flatten(2).transpose(1, 2), (2, 3)).numpy()
        offsets, weights = (part[0].numpy() for part in cross.aim(query))
        for batch in range(2):
            twin = np.zeros((6, 8))
            for cell in range(6):
                seeing = [v for v in range(5) if item[v] == batch and visible[v, cell].any()]
                for view in seeing:
                    points = places[view, cell].numpy()[[0, 1, 0, 1]]
                    at = points + offsets[batch, :, cell] / [3, 2]
                    twin[cell] += looked(values[view], at, weights[batch, :, cell]) / len(seeing)
            np.testing.assert_allclose(got[batch], cross.out(torch.from_numpy(twin)), atol=1e-12)
            np.testing.assert_allclose(got[batch, 0], cross.out.bias, atol=1e-12)


def test_gradients_of_looks_into_views_are_right(random):
    cross = shaken(SpatialCrossAttention(8, points=2, heights=2), random)
    query, (features, *rest) = drawn(random, 2, 6, 8), seen_views(random, 3, 2)

    def cross_attention(query, features):
        return cross(query, look_up(features, *rest))

    inputs = query.requires_grad_(), features.requires_grad_()
    assert torch.autograd.gradcheck(cross_attention, inputs, fast_mode=True)


ROWS, COLUMNS = 5, 12


def grid_places():
    y, x = np.meshgrid((np.arange(ROWS) + 0.5) / ROWS, (np.arange(COLUMNS) + 0.5) / COLUMNS,
                       indexing="ij")  # fmt: skip
    return torch.from_numpy(np.stack([x, y], axis=-1).reshape(-1, 2))


def moved_past(bev, turn=((1, 0), (0, 1)), shift=(0.0, 0.0)):
    """A past whose places are those of the present turned, then shifted by shares of the BEV."""
    affine = torch.from_numpy(
        np.concatenate([turn, np.array(shift)[:, None]], axis=1).astype(float)
    )
    motion = bev.new_zeros(len(bev), 4)
    return Past(
        bev, torch.ones(len(bev), dtype=torch.bool), affine.expand(len(bev), -1, -1), motion
    )


def test_a_still_world_looks_the_same_after_the_vehicle_moved(random):
    attention = shaken(TemporalSelfAttention(8, (ROWS, COLUMNS)), random)
    world = drawn(random, 1, ROWS, COLUMNS + 2, 8)  # two columns more than a BEV has
    query, position = drawn(random, 1, ROWS * COLUMNS, 8), drawn(random, ROWS * COLUMNS, 8)
    attention.aim.offsets.bias.data *= 0.2  # within a cell or two
    here, before = world[:, :, 2:].flatten(1, 2), world[:, :, :-2].flatten(1, 2)
    with torch.no_grad():
        still = attention(query, position, grid_places(), moved_past(here))
        # Ahead is along a row: the vehicle has gone two columns since then.
        moved = moved_past(before, shift=(2 / COLUMNS, 0))
        gone = attention(query, position, grid_places(), moved)
        wrong = attention(query, position, grid_places(), moved_past(before))
    inner = (slice(None), slice(None), slice(4, COLUMNS - 5))
    still, gone, wrong = (
        part.unflatten(1, (ROWS, COLUMNS))[inner] for part in (still, gone, wrong)
    )
    np.testing.assert_allclose(gone, still, atol=1e-12)
    assert (wrong - still).abs().max() > 0.01


def test_a_still_world_looks_the_same_after_half_a_turn(random):
    attention = shaken(TemporalSelfAttention(8, (ROWS, COLUMNS)), random)
    world, query = drawn(random, 1, ROWS * COLUMNS, 8), drawn(random, 1, ROWS * COLUMNS, 8)
    position = drawn(random, ROWS * COLUMNS, 8)
    with torch.no_grad():
        still = attention(query, position, grid_places(), moved_past(world))
        turned = moved_past(world.flip(1), -np.eye(2), (1.0, 1.0))  # (x, y) to (1 - x, 1 - y)
        got = attention(query, position, grid_places(), turned)
    np.testing.assert_allclose(got, still, atol=1e-12)


def test_without_a_past_the_present_stands_for_it(random):
    attention = shaken(TemporalSelfAttention(8, (ROWS, COLUMNS)), random)
    query, position = drawn(random, 2, ROWS * COLUMNS, 8), drawn(random, ROWS * COLUMNS, 8)
    past = moved_past(query)
    absent = Past(torch.full_like(query, 7), torch.zeros(2, dtype=torch.bool),
                  torch.full_like(past.from_here, 3), past.motion)  # fmt: skip
    with torch.no_grad():
        got = attention(query, position, grid_places(), absent)
        one = attention(query, position, grid_places(), past)
    np.testing.assert_allclose(got, one, atol=1e-12)
