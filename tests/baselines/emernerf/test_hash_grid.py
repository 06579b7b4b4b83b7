"""The hash grid's kernels against their float64 twin, and both against values by hand."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.emernerf import tcnn_backend
from baselines.emernerf.hash_grid import HashGrid
from baselines.emernerf.hash_grid_kernels import PRIMES, WIDTH
from baselines.emernerf.hash_grid_reference import hash_encode_reference
from baselines.emernerf.tcnn_backend import encode_tcnn


def make_grid(dims=3, levels=3, coarsest=2, finest=40, log2_entries=8, seed=0):
    generator = torch.Generator().manual_seed(seed)
    grid = HashGrid(dims, levels, coarsest, finest, log2_entries, generator)
    with torch.no_grad():
        grid.table.copy_(torch.randn(grid.table.shape, generator=generator))
    return grid


def twin(grid, positions, table):
    return hash_encode_reference(positions, table, grid.cells.tolist(), grid.offsets.tolist())


@settings(max_examples=12, deadline=None)
@given(
    dims=st.sampled_from([3, 4]),
    count=st.sampled_from([1, 127, 128, 300]),
    finest=st.integers(2, 4000),
    seed=st.integers(0, 99),
)
def test_features_and_both_gradients_are_those_of_the_float64_twin(dims, count, finest, seed):
    grid = make_grid(dims, finest=finest, seed=seed)
    generator = torch.Generator().manual_seed(seed)
    positions = torch.rand(count, dims, generator=generator)
    positions[:: count // 3 + 1] = positions[:: count // 3 + 1].round()  # corners of the cube
    slopes = torch.randn(count, grid.out_features, generator=generator)

    positions.requires_grad_()
    features = grid(positions)
    features.backward(slopes)
    exact = positions.detach().double().requires_grad_()
    table = grid.table.detach().double().requires_grad_()
    expected = twin(grid, exact, table)
    expected.backward(slopes.double())

    # A float32 position is off by 6e-8 of the cube, which is `finest` times as much of a cell.
    near = 1e-5 + 4e-7 * finest
    torch.testing.assert_close(features.double(), expected, atol=near, rtol=1e-5)
    torch.testing.assert_close(grid.table.grad.double(), table.grad, atol=10 * near, rtol=1e-5)
    slack = near * finest * 10
    torch.testing.assert_close(positions.grad.double(), exact.grad, atol=slack, rtol=1e-4)


@pytest.mark.parametrize("log2_entries", [6, 4], ids=["dense", "hashed"])
def test_the_twins_gradients_are_those_of_finite_differences(log2_entries):
    grid = make_grid(2, levels=2, finest=5, log2_entries=log2_entries)
    generator = torch.Generator().manual_seed(1)
    # Away from the cells' borders, where there is no gradient.
    cell = torch.randint(5, (6, 2), generator=generator)
    positions = (cell + 0.3 + 0.1 * torch.rand(6, 2, generator=generator).double()) / 10
    table = grid.table.detach().double().requires_grad_()
    positions.requires_grad_()
    assert torch.autograd.gradcheck(lambda p, t: twin(grid, p, t), (positions, table))


def test_a_vertex_has_its_own_entry_and_a_middle_the_mean_of_its_corners():
    grid = make_grid(3, levels=1, coarsest=2, finest=2)  # 27 vertices, x first
    places = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [1, 1, 1], [0.25, 0, 0], [0.25, 0.25, 0.25]])
    rows = grid.table.detach()
    cube = rows[[0, 1, 3, 4, 9, 10, 12, 13]].mean(0)
    expected = torch.stack([rows[0], rows[1], rows[26], (rows[0] + rows[1]) / 2, cube])
    torch.testing.assert_close(grid(places).detach(), expected)


def test_levels_grow_geometrically_and_hold_no_more_than_they_may():
    grid = make_grid(3, levels=3, coarsest=2, finest=32, log2_entries=9)
    assert grid.cells.tolist() == [2, 8, 32]
    assert np.diff(grid.offsets).tolist() == [27, 512, 512]


def test_the_bytes_do_not_depend_on_the_number_of_threads():
    grid = make_grid(4, levels=4, finest=100)
    positions = torch.rand(2000, 4, generator=torch.Generator().manual_seed(3)).requires_grad_()
    slopes = torch.randn(2000, grid.out_features, generator=torch.Generator().manual_seed(4))
    results = []
    before = torch.get_num_threads()
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            grid.zero_grad()
            positions.grad = None
            features = grid(positions)
            features.backward(slopes)
            results.append((features.detach(), grid.table.grad.clone(), positions.grad.clone()))
    finally:
        torch.set_num_threads(before)
    for one, three in zip(*results, strict=True):
        assert torch.equal(one, three)


class TcnnLevel(torch.nn.Module):
    """A grid of one level as tiny-cuda-nn has it (its `kernel_grid` and `grid_index`)."""

    def __init__(self, dims, settings, dtype):
        super().__init__()
        assert (settings["otype"], settings["type"], settings["n_levels"]) == ("Grid", "Hash", 1)
        assert settings["interpolation"] == "Linear"
        self.scale = settings["base_resolution"] - 1
        self.dense = settings["base_resolution"] ** dims
        self.strides = [settings["base_resolution"] ** d for d in range(dims)]
        self.entries = min(-(-self.dense // 8) * 8, 1 << settings["log2_hashmap_size"])
        width = settings["n_features_per_level"]
        self.params = torch.nn.Parameter(torch.full((self.entries * width,), torch.nan))

    def forward(self, positions):
        place = positions * self.scale + 0.5
        low = place.detach().floor()
        share, low = place - low, low.long()
        rows = self.params.view(self.entries, WIDTH)
        total = 0
        for corner in range(1 << positions.shape[1]):
            beyond = [corner >> d & 1 for d in range(positions.shape[1])]
            weight, summed, hashed = 1, 0, 0
            for d, (more, stride) in enumerate(zip(beyond, self.strides, strict=True)):
                weight = weight * (share[:, d] if more else 1 - share[:, d])
                vertex = (low[:, d] + more) % 2**32
                summed = summed + vertex * stride
                hashed = hashed ^ vertex * PRIMES[d] % 2**32
            index = hashed if self.entries < self.dense else summed % 2**32
            total = total + weight[:, None] * rows[index % self.entries]
        return total


@pytest.mark.parametrize("dims", [3, 4])
def test_tiny_cuda_nn_reads_our_table_as_we_do(dims, monkeypatch):
    monkeypatch.setitem(sys.modules, "tinycudann", SimpleNamespace(Encoding=TcnnLevel))
    monkeypatch.setattr(tcnn_backend, "_level", tcnn_backend._level.__wrapped__)  # not cached
    grid = make_grid(dims, levels=4, coarsest=2, finest=30, log2_entries=8)
    positions = torch.rand(300, dims, generator=torch.Generator().manual_seed(5))
    positions[:8] = positions[:8].round()  # corners of the cube
    slopes = torch.randn(300, grid.out_features, generator=torch.Generator().manual_seed(6))
    found = []
    for encode in (encode_tcnn, hash_encode_reference):
        places = positions.clone().requires_grad_()
        table = grid.table.detach().clone().requires_grad_()
        features = encode(places, table, grid.cells.tolist(), grid.offsets.tolist())
        features.backward(slopes)
        found.append((features.detach(), table.grad, places.grad[8:]))  # kinks lie in the corners
    for ours, twin in zip(*found, strict=True):
        torch.testing.assert_close(ours, twin, rtol=1e-3, atol=1e-3)
