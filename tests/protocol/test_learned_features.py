"""Features are computed once a picture, whichever metric asks, and kept ones are not computed."""

import numpy as np
import pytest

from geoevs.core import efficientnet_weights
from geoevs.core.errors import GeoEvsError
from geoevs.core.mapped import write_mapped
from geoevs.protocol import learned_features as module
from geoevs.protocol.learned_features import kept_features, learned_features, write_features
from geoevs.protocol.metrics import EfficientNetLayers
from geoevs.protocol.set_metrics import efficientnet_features

pytestmark = pytest.mark.skipif(
    bool(efficientnet_weights.missing()), reason=efficientnet_weights.missing()
)


@pytest.fixture
def computed(monkeypatch):
    """Pictures whose features were computed, from an empty memory on."""
    pictures = []

    def compute(image, real=module._computed):
        pictures.append(image)
        return real(image)

    monkeypatch.setattr(module, "_computed", compute)
    monkeypatch.setattr(module, "_recent", {})
    return pictures


@pytest.fixture(scope="module")
def images():
    return list(np.random.default_rng(0).random((3, 16, 24, 3), np.float32))


def layers(preds, target, mask=None):
    metric = EfficientNetLayers()
    metric.update(preds, target, np.ones(target.shape[:2], bool) if mask is None else mask)
    return metric.compute()


def test_a_picture_is_seen_once_by_all_metrics(computed, images):
    first, second, _ = images
    assert layers(first, second) > 0.1
    assert layers(first, first.copy()) == 0
    assert efficientnet_features(first).shape == (1280,)
    assert efficientnet_features(second).dtype == np.float64
    assert len(computed) == 2


def test_memory_holds_the_latest_alone(computed, images, monkeypatch):
    monkeypatch.setattr(module, "RECENT", 2)
    for number in (0, 1, 0, 2, 0):  # what is asked for again stays
        learned_features(images[number])
    assert len(computed) == 3
    learned_features(images[1])
    assert len(computed) == 4


def test_kept_features_are_those_that_would_be_computed(computed, images, tmp_path):
    write_features(tmp_path / "kept", [images[0], images[1], images[0]])
    assert len(list((tmp_path / "kept").glob("*.npz"))) == 2
    fresh = layers(images[2], images[0]), efficientnet_features(images[0])
    module._recent.clear()
    computed.clear()
    with kept_features(tmp_path / "kept"):
        kept = layers(images[2], images[0]), efficientnet_features(images[0])
    assert len(computed) == 1  # of the picture that is not kept
    assert kept[0] == fresh[0]
    np.testing.assert_array_equal(kept[1], fresh[1])
    module._recent.clear()
    learned_features(images[0])
    assert len(computed) == 2  # outside the block nothing is read


def test_pictures_of_other_shapes_have_other_features(images):
    wide = images[0].reshape(8, 48, 3)
    assert not np.array_equal(efficientnet_features(wide), efficientnet_features(images[0]))


def test_a_damaged_file_is_refused_in_one_sentence(computed, images, tmp_path):
    write_features(tmp_path / "kept", images[:1])
    (path,) = (tmp_path / "kept").glob("*.npz")
    write_mapped(path, {"other": np.zeros(3)})
    module._recent.clear()
    with (
        kept_features(tmp_path / "kept"),
        pytest.raises(GeoEvsError, match="holds no features of a picture; delete its folder"),
    ):
        learned_features(images[0])


def test_invalid_pixels_count_in_no_distance(images):
    preds, target = images[0].copy(), images[1]
    mask = np.ones((16, 24), bool)
    mask[:, 16:] = False
    before = layers(preds, target, mask)
    preds[:, 16:] = np.nan
    assert layers(preds, target, mask) == before < layers(images[0], target)
    assert np.isnan(layers(preds, target, np.zeros_like(mask)))
    metric = EfficientNetLayers(data_range=255)
    metric.update(255 * images[0], 255 * target, np.ones_like(mask))
    assert metric.compute() == pytest.approx(layers(images[0], target), rel=1e-4)
