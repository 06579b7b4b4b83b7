import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from geoevs.diffusion.push_pull import push_pull


@st.composite
def scattered(draw):
    """Two images, some pixels known: odd sizes and single rows, columns and pixels too."""
    height, width = draw(st.tuples(st.integers(1, 19), st.integers(1, 19)))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    known = rng.random((2, 1, height, width)) < draw(st.sampled_from([0.02, 0.3, 0.9]))
    known.reshape(2, -1)[:, draw(st.integers(0, height * width - 1))] = True
    values = rng.uniform(-1, 1, (2, draw(st.integers(1, 3)), height, width))
    return torch.from_numpy(values.astype(np.float32)), torch.from_numpy(known)


@given(scattered())
def test_known_pixels_keep_their_value_and_others_stay_between(case):
    values, known = case
    filled = push_pull(values, known)
    assert filled.dtype == values.dtype
    assert torch.equal(torch.where(known, filled, 0), torch.where(known, values, 0))
    low = torch.where(known, values, 2.0).amin(dim=(2, 3), keepdim=True)
    high = torch.where(known, values, -2.0).amax(dim=(2, 3), keepdim=True)
    assert torch.all((low - 1e-5 <= filled) & (filled <= high + 1e-5))


@given(scattered(), st.floats(-1, 1, width=32))
def test_a_constant_stays_one(case, constant):
    values, known = case
    filled = push_pull(torch.full_like(values, constant), known)
    torch.testing.assert_close(filled, torch.full_like(values, constant), atol=1e-5, rtol=0)


@given(scattered())
def test_unknown_values_and_other_images_do_not_count(case):
    values, known = case
    filled = push_pull(values, known)
    assert torch.equal(filled, push_pull(torch.where(known, values, 5.0), known))
    alone = push_pull(values[:1], known[:1])
    torch.testing.assert_close(filled[:1], alone, atol=1e-6, rtol=0)


def test_an_image_without_known_pixels_is_zero():
    filled = push_pull(torch.ones(1, 3, 5, 7), torch.zeros(1, 1, 5, 7, dtype=bool))
    assert torch.equal(filled, torch.zeros(1, 3, 5, 7))


def test_a_hole_continues_what_is_around_it():
    ramp = torch.linspace(0, 1, 64).expand(1, 1, 64, 64)
    known = torch.ones(1, 1, 64, 64, dtype=bool)
    known[..., 24:40, 24:40] = False
    filled = push_pull(ramp, known)
    # A ramp is the membrane that its own border spans.
    assert (filled - ramp).abs().max() < 0.03
    assert filled.diff(dim=3).abs().max() < 0.03  # no seam
