import io

import numpy as np
import pytest
from PIL import Image

from geoevs import layout
from geoevs.conditions.artifact_masks import MaskLibrary
from geoevs.conditions.bits import pack_masks
from geoevs.protocol.reference import References
from geoevs.protocol.targets import read_targets
from geoevs.results.figures import BACKGROUND, HEADER, MARGIN, UNSUPPORTED
from geoevs.results.mask_figure import (
    COLUMNS,
    ROWS,
    SUPPORTED,
    TILE_WIDTH,
    library_picture,
    support_shares,
    target_support,
)

TILE_HEIGHT = TILE_WIDTH // 2


def library(hidden):
    """Masks of 10 x 20 pixels whose first columns are hidden."""
    masks = np.arange(20) >= np.asarray(hidden)[:, None, None]
    masks = np.broadcast_to(masks, (len(hidden), 10, 20))
    zeros = np.zeros(len(hidden))
    labels = {"scene": np.full(len(hidden), "s"), "frame": zeros, "yaw": zeros, "lateral": zeros}
    support = masks.mean(axis=(1, 2))
    return MaskLibrary(10, 20, pack_masks(masks), **labels, support=support)


def drawn(hidden):
    png = library_picture(library(hidden), np.array([0.9, 0.95]))
    return np.asarray(Image.open(io.BytesIO(png)))


def tile(picture, place):
    row, column = divmod(place, COLUMNS)
    top, left = MARGIN + row * (TILE_HEIGHT + HEADER), MARGIN + column * (TILE_WIDTH + MARGIN)
    return picture[top : top + TILE_HEIGHT, left : left + TILE_WIDTH]


def hidden_columns(picture, place):
    shown = tile(picture, place)
    hidden = (shown == UNSUPPORTED).all(axis=-1)
    assert ((shown == SUPPORTED).all(axis=-1) | hidden).all()
    return hidden.mean() * 20


def test_masks_stand_from_the_least_support_to_the_most():
    picture = drawn([4, 18, 1])
    for place, hidden in enumerate([18, 4, 1]):
        assert hidden_columns(picture, place) == pytest.approx(hidden, abs=0.1)
    assert (tile(picture, 3) == BACKGROUND).all()


def test_a_large_library_is_shown_from_end_to_end():
    count = COLUMNS * ROWS
    picture = drawn(np.repeat(np.arange(20), 50))
    assert hidden_columns(picture, 0) == pytest.approx(19, abs=0.1)
    assert hidden_columns(picture, count - 1) == pytest.approx(0, abs=0.1)
    shown = [hidden_columns(picture, place) for place in range(count)]
    assert shown == sorted(shown, reverse=True)


def test_shares_by_hand():
    shares = support_shares({"a": np.array([0.91, 0.95, 0.951, 1.0]), "b": np.array([0.97])})
    assert shares["of"].unique().tolist() == ["a (mean 0.95)", "b (mean 0.97)"]
    np.testing.assert_allclose(shares["low"], [0.9, 0.92, 0.94, 0.96, 0.98] * 2)
    np.testing.assert_allclose(shares["high"], [0.92, 0.94, 0.96, 0.98, 1.0] * 2)
    assert shares["share"].tolist() == [0.25, 0, 0.5, 0, 0.25, 0, 0, 0, 1, 0]


def test_support_of_the_tests_extrapolation_targets(run):
    support = target_support(run, [("d", "s")])
    place = {"dataset": "d", "scene": "s"}
    references = References(run / layout.REFERENCES.format(**place))
    targets = read_targets(run / layout.TARGETS.format(**place))
    names = [target.key for target in targets if target.key.startswith("extrapolation-")]
    assert len(names) == 8
    expected = [np.count_nonzero(references[name].reprojected) / (48 * 72) for name in names]
    np.testing.assert_allclose(support, expected)


def test_the_same_bytes_every_time():
    arguments = (library([1, 2, 3]), np.array([0.9]))
    assert library_picture(*arguments) == library_picture(*arguments)
