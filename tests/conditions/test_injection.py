import numpy as np
import pytest
from scipy.stats import binomtest, chisquare, ks_2samp

from geoevs.conditions.artifact_masks import MaskLibrary
from geoevs.conditions.bits import pack_masks
from geoevs.conditions.injection import INJECTIONS, ArtifactInjection
from geoevs.core.errors import GeoEvsError

HEIGHT, WIDTH = 32, 48


@pytest.fixture(scope="module")
def library():
    """Forty masks whose columns from some place on are hidden: 1 to 40 of 48."""
    hidden = np.arange(1, 41)
    masks = np.arange(WIDTH) < WIDTH - hidden[:, None, None]
    masks = np.broadcast_to(masks, (40, HEIGHT, WIDTH))
    labels = {"scene": np.full(40, "s"), "frame": np.arange(40)}
    labels |= {name: np.zeros(40) for name in ("yaw", "lateral")}
    support = masks.mean(axis=(1, 2))
    return MaskLibrary(HEIGHT, WIDTH, pack_masks(masks), **labels, support=support)


def injected(library, kind, probability, count, seed=0):
    """(count,) hidden shares of a batch."""
    injection = ArtifactInjection(kind, probability, HEIGHT, WIDTH, library)
    keep = injection.inject(np.random.default_rng(seed), count)
    assert keep.shape == (count, HEIGHT, WIDTH)
    assert keep.dtype == bool
    return 1 - keep.mean(axis=(1, 2))


@pytest.mark.parametrize("kind", ["reprojected", "boxes", "boxes-unmatched"])
def test_the_gate_opens_as_often_as_it_should(library, kind):
    hidden = injected(library, kind, 0.4, 1000)
    # Every mask of the library, and every box, hides something.
    assert binomtest(np.count_nonzero(hidden), 1000, 0.4).pvalue > 0.01


@pytest.mark.parametrize("kind", INJECTIONS)
def test_a_shut_gate_hides_nothing(library, kind):
    assert not injected(library, kind, 0.0, 50).any()


@pytest.mark.parametrize("kind", ["reprojected", "boxes", "boxes-unmatched"])
def test_an_open_gate_always_hides(library, kind):
    assert injected(library, kind, 1.0, 50).all()


def test_none_hides_nothing_and_draws_nothing(library):
    rng = np.random.default_rng(0)
    assert ArtifactInjection("none", 0.4, HEIGHT, WIDTH).inject(rng, 20).all()
    assert rng.bit_generator.state == np.random.default_rng(0).bit_generator.state


def test_masks_are_drawn_uniformly_behind_the_gate(library):
    hidden = injected(library, "reprojected", 0.4, 10000)
    columns = np.rint(hidden[hidden > 0] * WIDTH).astype(int)
    counts = np.bincount(columns, minlength=41)[1:]
    assert len(counts) == 40
    assert chisquare(counts).pvalue > 0.01


def test_boxes_hide_as_much_as_the_librarys_masks(library):
    wanted = 1 - library.support
    boxes = injected(library, "boxes", 1.0, 800)
    # The mean of 800 draws, five standard errors wide.
    assert abs(boxes.mean() - wanted.mean()) < 5 * wanted.std() / np.sqrt(800)
    # Boxes hide whole shares only to half a row or column: the same grid for both.
    grid = np.arange(0.5, WIDTH + 1) / WIDTH
    found, expected = (np.digitize(shares, grid) for shares in (boxes, wanted))
    assert ks_2samp(found, expected).pvalue > 0.01
    erased = np.digitize(injected(library, "boxes-unmatched", 1.0, 800), grid)
    assert ks_2samp(erased, expected).pvalue < 1e-6  # so the test can tell


@pytest.mark.parametrize("kind", ["reprojected", "boxes", "boxes-unmatched"])
def test_the_same_generator_injects_the_same_masks(library, kind):
    injection = ArtifactInjection(kind, 0.5, HEIGHT, WIDTH, library)
    first, again, other = (injection.inject(np.random.default_rng(s), 8) for s in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_mistakes_are_one_sentence(library):
    with pytest.raises(GeoEvsError, match=r"no artifact injection 'box'; did you mean 'boxes'\?"):
        ArtifactInjection("box", 0.4, HEIGHT, WIDTH, library)
    with pytest.raises(GeoEvsError, match=r"the probability 1.5; choose one from 0 to 1"):
        ArtifactInjection("boxes", 1.5, HEIGHT, WIDTH, library)
    with pytest.raises(GeoEvsError, match=r"'reprojected' draws from a mask library; make one "):
        ArtifactInjection("reprojected", 0.4, HEIGHT, WIDTH)
    sentence = r"^the masks of the mask library are 32 x 48 but the training pairs are 64 x 96; "
    with pytest.raises(GeoEvsError, match=sentence):
        ArtifactInjection("reprojected", 0.4, 64, 96, library)
