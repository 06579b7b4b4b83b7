import io
import shutil

import numpy as np
import pytest
from PIL import Image

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.protocol.condition_masks import ConditionMask
from geoevs.protocol.reference import SparseReference
from geoevs.protocol.targets import read_targets, write_targets
from geoevs.results.figures import (
    BACKGROUND,
    HEADER,
    MARGIN,
    NEW,
    REMOVED,
    SUPPORTED,
    TILE_WIDTH,
    UNSUPPORTED,
    VALID,
    Row,
    draw_grid,
    mask_picture,
    table_grid,
    validity_picture,
)
from geoevs.results.table_specs import TABLES

KEEPS = [1.0, 0.5, 0.2]
TILE_HEIGHT = round(TILE_WIDTH * 48 / 72)


def plain(colour, height=48, width=72):
    return np.full((height, width, 3), colour, np.uint8)


def tile(grid, row, column):
    top = HEADER + row * (TILE_HEIGHT + HEADER) + HEADER
    left = MARGIN + column * (TILE_WIDTH + MARGIN)
    return grid[top : top + TILE_HEIGHT, left : left + TILE_WIDTH]


def test_every_picture_has_its_place():
    colours = [[(9, 0, 0), (0, 9, 0), (0, 0, 9)], [(99, 0, 0), (0, 99, 0), (0, 0, 99)]]
    rows = [Row("r", [plain(colour) for colour in line]) for line in colours]
    grid = draw_grid(["a", "b", "c"], rows)
    height = HEADER + 2 * (TILE_HEIGHT + HEADER) + MARGIN
    assert grid.shape == (height, 3 * (TILE_WIDTH + MARGIN) + MARGIN, 3)
    for row, line in enumerate(colours):
        for column, colour in enumerate(line):
            assert (tile(grid, row, column) == colour).all()
    gap = grid[:, MARGIN + TILE_WIDTH : 2 * MARGIN + TILE_WIDTH]
    assert (gap[HEADER + HEADER : -MARGIN] == BACKGROUND).all()


def test_pixels_stay_sharp_when_enlarged_and_blend_when_reduced():
    board = np.indices((48, 72)).sum(axis=0) % 2 * 200
    picture = np.repeat(board[..., None], 3, axis=2).astype(np.uint8)
    assert set(np.unique(tile(draw_grid(["a"], [Row("", [picture])]), 0, 0))) == {0, 200}
    fine = np.tile(picture, (16, 16, 1))  # 1152 pixels wide, hence 4.5 to one
    reduced = tile(draw_grid(["a"], [Row("", [fine])]), 0, 0)
    assert np.abs(reduced.astype(int) - 100).max() < 25


def test_a_missing_picture_leaves_its_tile_white():
    grid = draw_grid(["a", "b"], [Row("", [None, plain(7)])])
    assert (tile(grid, 0, 1) == 7).all()
    assert (tile(grid, 0, 0)[40:] == BACKGROUND).all()
    assert (tile(grid, 0, 0)[:40] != BACKGROUND).any()  # says none


def test_a_grid_without_rows_has_its_headings():
    width = 2 * (TILE_WIDTH + MARGIN) + MARGIN
    assert draw_grid(["a", "b"], []).shape == (HEADER + MARGIN, width, 3)


def test_colours_of_validity_by_hand():
    reference = SparseReference(
        pixels=np.array([0, 2, 4]),
        rgb=np.zeros((3, 3), np.float32),
        footprint=np.ones(3, bool),
        rank=np.array([0.0, 0.3, 0.6], np.float32),
        reprojected=np.array([[True, True, False, False, True]]),
    )
    expected = [VALID, SUPPORTED, NEW, UNSUPPORTED, VALID]
    assert [tuple(pixel) for pixel in validity_picture(reference)[0]] == expected
    thinned = [VALID, SUPPORTED, UNSUPPORTED, UNSUPPORTED, SUPPORTED]
    assert [tuple(pixel) for pixel in validity_picture(reference, 0.2)[0]] == thinned


def test_colours_of_a_mask_by_hand():
    mask = ConditionMask(
        keep=np.array([[True, True, False, False]]),
        reprojected=np.array([[True, False, True, False]]),
    )
    expected = [SUPPORTED, UNSUPPORTED, REMOVED, UNSUPPORTED]
    assert [tuple(pixel) for pixel in mask_picture(mask)[0]] == expected


def test_the_masked_grid_shows_truth_and_masks(run):
    grid = drawn("masked", run)
    for line in range(4):
        assert share(tile(grid, line, 1), SUPPORTED, REMOVED, UNSUPPORTED) == 1
        assert share(tile(grid, line, 1), REMOVED) > 0.01
        known = (tile(grid, line, 0)[40:] != BACKGROUND).any()
        assert known == (line < 2)  # the run has no truth of virtual views


def share(picture, *colours):
    """The share of pixels that have one of the colours."""
    return sum((picture == colour).all(axis=-1).mean() for colour in colours)


def drawn(table, run, keeps=KEEPS, labels=("grey",), scenes=(("d", "s"),), count=None):
    png = table_grid(table, run, scenes, labels, keeps, count)
    return np.asarray(Image.open(io.BytesIO(png)))


# Rows: one target; two targets; one a share; the angles to the left; two targets;
# two of each split. Columns: what
# scores them (the run has no truth), and the renders.
@pytest.mark.parametrize(
    ("table", "lines", "columns"),
    [
        ("interpolation", 1, 2),
        ("observed", 2, 2),
        ("sparsity", 3, 3),
        ("pose_offset", 2, 3),
        ("extrapolation", 2, 3),
        ("masked", 4, 3),
    ],
)
def test_every_table_has_its_grid(run, table, lines, columns):
    assert table in TABLES
    grid = drawn(table, run)
    assert (grid.shape[0] - HEADER - MARGIN) / (TILE_HEIGHT + HEADER) == lines
    assert (grid.shape[1] - MARGIN) / (TILE_WIDTH + MARGIN) == columns
    for line in range(lines):
        assert (tile(grid, line, columns - 1) == 99).all()


def test_random_targets_are_the_same_ones_every_time(run):
    def lines(count):
        grid = drawn("observed", run, count=count)
        return [tile(grid, line, 0).tobytes() for line in range(_count(grid))]

    every = lines(1000)
    assert len(every) > 3
    three = lines(3)
    assert len(three) == 3
    assert set(three) < set(every)
    assert three == lines(3)


def _count(grid):
    return (grid.shape[0] - HEADER - MARGIN) // (TILE_HEIGHT + HEADER)


def test_the_sparsity_grid_shows_ever_fewer_pixels(run):
    grid = drawn("sparsity", run)
    scoring = [share(tile(grid, line, 1), VALID, NEW) for line in range(3)]
    assert scoring[0] > scoring[1] > scoring[2] > 0


def test_the_same_bytes_every_time(run):
    arguments = ("extrapolation", run, [("d", "s")], ["grey"], KEEPS)
    assert table_grid(*arguments) == table_grid(*arguments)


def test_a_column_without_pictures_is_left_out(run):
    grid = drawn("extrapolation", run, labels=("gone", "grey"))
    assert grid.shape == drawn("extrapolation", run).shape
    assert (tile(grid, 0, 2) == 99).all()


def test_dropped_renders_have_a_column_that_says_so(run):
    grid = drawn("observed", run, labels=())
    assert grid.shape == drawn("observed", run).shape
    assert share(tile(grid, 0, 1), BACKGROUND) > 0.95  # but for the word `none`
    assert share(tile(grid, 0, 0), BACKGROUND) < 0.5


def test_a_run_without_the_split_has_no_rows(run):
    assert drawn("extrapolation", run, scenes=()).shape == (HEADER + MARGIN, MARGIN, 3)


def test_a_sweep_without_angles_has_no_rows(run, tmp_path):
    shutil.copytree(run, tmp_path / "run")
    path = tmp_path / "run" / layout.TARGETS.format(dataset="d", scene="s")
    write_targets(path, [t for t in read_targets(path) if t.split != "pose-sweep"])
    grid = drawn("pose_offset", tmp_path / "run")
    assert grid.shape == (HEADER + MARGIN, MARGIN, 3)


def test_unknown_tables_are_named(run):
    with pytest.raises(GeoEvsError, match=r"^there is no table 'sparse'; did you mean"):
        drawn("sparse", run)
