import numpy as np
import pytest

from geoevs.conditions.pairs import condition_map, make_pairs, pair_arrays, read_pairs
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_arrays
from geoevs.core.images import to_uint8
from geoevs.core.mapped import write_mapped
from geoevs.methods.tiny import MOUNT, tiny_camera, tiny_truth

FIELDS = ("rgb", "valid", "target", "scene", "camera", "frame")


@pytest.fixture(scope="module")
def pairs(stage):
    return make_pairs(stage.scene, stage.maps, lambda: None)


def test_every_frame_and_camera_has_its_pair(stage, pairs):
    keys = list(zip(pairs.frame.tolist(), pairs.camera.tolist(), strict=True))
    assert keys == [(f, c) for f in (0, 1) for c in ("front", "left", "right")]
    assert set(pairs.scene) == {"tiny"}
    for number, (frame, camera) in enumerate(keys):
        expected = to_uint8(stage.scene.image(camera, frame))
        np.testing.assert_array_equal(pairs.target[number], expected)


def test_a_condition_is_its_own_view_projected_back(pairs):
    assert pairs.rgb.dtype == pairs.target.dtype == np.uint8
    assert pairs.valid.mean() > 0.99
    # Each pixel shows one of its points, at most a quarter of a pixel from its centre; the smooth
    # texture makes that less than 0.01, which is 2.6 levels. Another view would differ by more.
    error = np.abs(pairs.rgb.astype(int) - pairs.target)
    own = [error[n][pairs.valid[n]].mean() for n in range(len(pairs))]
    assert max(own) < 2.6
    others = [
        np.abs(pairs.rgb[n].astype(int) - pairs.target[m])[pairs.valid[n]].mean()
        for n in range(len(pairs))
        for m in range(len(pairs))
        if m != n
    ]
    assert min(others) > max(own)


def test_only_the_views_own_depth_supports_it():
    camera = tiny_camera("front", 0.0, MOUNT)
    rgb, depth = tiny_truth(camera)
    depth[:, :36] = 0
    raster = condition_map(rgb / np.float32(255), depth, camera)
    assert not raster.mask[:, :36].any()
    assert (raster.image[~raster.mask] == 0).all()
    assert raster.mask[:, 36:].mean() > 0.99


def test_pairs_survive_a_round_trip(pairs, tmp_path):
    write_mapped(tmp_path / "pairs.npz", pair_arrays(pairs))
    again = read_pairs([tmp_path / "pairs.npz"])
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(again, name), getattr(pairs, name))
        assert getattr(again, name).dtype == getattr(pairs, name).dtype
    picked = np.array([4, 0, 4])
    np.testing.assert_array_equal(again.valid[picked], pairs.valid[picked])
    with np.load(tmp_path / "pairs.npz") as file:
        assert file["pairs/valid"].nbytes == 6 * 48 * 72 / 8


def test_the_same_pairs_are_the_same_bytes(stage, pairs, tmp_path):
    write_mapped(tmp_path / "a.npz", pair_arrays(pairs))
    write_mapped(tmp_path / "b.npz", pair_arrays(make_pairs(stage.scene, stage.maps, lambda: None)))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def cut(pairs, keep, height=48):
    """Some of the pairs, at fewer rows."""
    parts = {name: getattr(pairs, name)[keep] for name in FIELDS}
    for name in ("rgb", "valid", "target"):
        parts[name] = parts[name][:, :height]
    return type(pairs)(**parts)


def test_files_are_joined_in_the_order_given(pairs, tmp_path):
    for name, keep in (("late", slice(4, 6)), ("early", slice(0, 3))):
        write_mapped(tmp_path / f"{name}.npz", pair_arrays(cut(pairs, keep)))
    joined = read_pairs([tmp_path / "late.npz", tmp_path / "early.npz"])
    order = [4, 5, 0, 1, 2]
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(joined, name), getattr(pairs, name)[order])


def test_what_cannot_be_joined_is_one_sentence(pairs, tmp_path):
    with pytest.raises(GeoEvsError, match=r"there are no training pairs; .*partitions\.train"):
        read_pairs([])
    write_mapped(tmp_path / "a.npz", pair_arrays(pairs))
    write_mapped(tmp_path / "b.npz", pair_arrays(cut(pairs, slice(None), height=40)))
    with pytest.raises(GeoEvsError, match=r"b.npz are 40 x 72 but those of .*a.npz are 48 x 72; "):
        read_pairs([tmp_path / "a.npz", tmp_path / "b.npz"])
    with pytest.raises(GeoEvsError, match=r"none.npz is missing"):
        read_pairs([tmp_path / "none.npz"])
    write_mapped(tmp_path / "c.npz", {"pairs/rgb": pairs.rgb})
    with pytest.raises(GeoEvsError, match=r"c.npz has no array 'target'; delete it and make it ag"):
        read_pairs([tmp_path / "c.npz"])
    write_arrays(tmp_path / "d.npz", pair_arrays(pairs))
    with pytest.raises(GeoEvsError, match=r"d.npz: pairs/rgb.npy is compressed; make the file aga"):
        read_pairs([tmp_path / "d.npz"])


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("rgb", lambda array: array[:, :-1]),
        ("rgb", lambda array: array.astype(np.int8)),
        ("valid", lambda array: array[:-1]),
        ("scene", lambda array: np.arange(6)),
        ("frame", lambda array: array[:, None]),
    ],
)
def test_arrays_of_another_kind_are_refused(pairs, tmp_path, name, change):
    arrays = pair_arrays(pairs)
    write_mapped(tmp_path / "a.npz", arrays | {f"pairs/{name}": change(arrays[f"pairs/{name}"])})
    with pytest.raises(GeoEvsError, match=rf"^{tmp_path}/a.npz: the array '{name}' is .*; delete"):
        read_pairs([tmp_path / "a.npz"])
