import numpy as np
from hypothesis import given
from hypothesis.extra.numpy import array_shapes, arrays

from geoevs.conditions.bits import pack_masks, unpack_masks


@given(arrays(bool, array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=9)))
def test_masks_survive_packing(masks):
    packed = pack_masks(masks)
    _, height, width = masks.shape
    assert packed.shape == (len(masks), -(-height * width // 8))
    np.testing.assert_array_equal(unpack_masks(packed, height, width), masks)


def test_bits_by_hand():
    masks = np.array([[[True, False, True], [False, False, True]]])
    assert pack_masks(masks).tolist() == [[0b10100100]]
