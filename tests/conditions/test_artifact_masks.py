import dataclasses

import numpy as np
import pytest
from scipy.stats import chisquare

from geoevs.conditions.artifact_masks import (
    MaskLibrary,
    join_artifact_masks,
    make_artifact_masks,
    mask_arrays,
    read_artifact_masks,
    virtual_poses,
)
from geoevs.conditions.bits import pack_masks
from geoevs.core.errors import GeoEvsError
from geoevs.core.mapped import write_mapped
from geoevs.methods.tiny import MOUNT, STEP
from geoevs.projection import project_points, unproject_depth

POSES = {"yaw": [0, 0.5, 1], "lateral": [-1.0, 2.0]}


@pytest.fixture(scope="module")
def library(stage):
    return make_artifact_masks(stage.scene, stage.maps, POSES, lambda: None)


def counting(masks, height, width, origin="the mask library"):
    """A library of `masks` different masks: each shows its number in binary."""
    bits = (np.arange(masks)[:, None] >> np.arange(height * width)) & 1
    shown = bits.astype(bool).reshape(masks, height, width)
    labels = {"scene": np.full(masks, "s"), "frame": np.arange(masks)}
    labels |= {name: np.zeros(masks) for name in ("yaw", "lateral")}
    support = shown.mean(axis=(1, 2))
    return MaskLibrary(height, width, pack_masks(shown), **labels, support=support, origin=origin)


def test_poses_by_hand(stage):
    poses = list(virtual_poses(stage.scene, 1, POSES))
    # Straight ahead once, half-way and all the way to both sides, each at two shifts.
    yaws = [0.0, 0.0, 22.5, 22.5, 45.0, 45.0, -22.5, -22.5, -45.0, -45.0]
    np.testing.assert_allclose([pose.yaw for pose in poses], yaws)
    assert [pose.lateral for pose in poses] == [-1.0, 2.0] * 5
    for camera, yaw, lateral in poses:
        assert camera.yaw == pytest.approx(yaw)
        # All cameras of the tiny rig share a centre, and the car heads along +x.
        np.testing.assert_allclose(camera.centre, MOUNT + STEP + [0, lateral, 0], atol=1e-12)


def test_a_mask_for_every_frame_and_pose(library):
    assert len(library) == 2 * 10
    assert library.frame.tolist() == [0] * 10 + [1] * 10
    assert set(library.scene) == {"tiny"}
    masks = library.masks(np.arange(20))
    assert masks.shape == (20, 48, 72)
    np.testing.assert_allclose(library.support, masks.mean(axis=(1, 2)))
    assert 0.3 < library.support.min() < library.support.max() < 1


def test_a_mask_is_where_some_pixel_of_any_source_lands(stage, library):
    """An independent reference: sources sampled 8 x 8 times as finely, and no z-buffer at all."""
    number = 3  # half-way to the left, 2 m to the left, frame 0
    camera = list(virtual_poses(stage.scene, 0, POSES))[number].camera
    landed = np.zeros((48, 72), bool)
    for name in stage.scene.cameras:
        depth = stage.maps.depth(name, 0)
        fine = stage.scene.camera(name, 0).resized(48 * 8, 72 * 8)
        points, _ = unproject_depth(np.repeat(np.repeat(depth, 8, axis=0), 8, axis=1), fine)
        uv, _ = project_points(points, camera)
        column, row = np.floor(uv[(uv >= 0).all(axis=1) & (uv < [72, 48]).all(axis=1)]).T
        landed[row.astype(int), column.astype(int)] = True
    differ = (library.masks(np.arange(len(library))) != landed).mean(axis=(1, 2))
    # The library samples 2 x 2, and that leaves some pixels of slanted surfaces empty.
    assert differ.argmin() == number
    assert differ[number] < 0.01


def test_a_wider_shift_hides_more(library):
    ahead = library.yaw == 0
    near, far = (library.support[ahead & (library.lateral == shift)] for shift in (-1.0, 2.0))
    assert (far < near).all()


def test_draws_are_uniform_and_repeatable():
    library = counting(12, 2, 3)
    drawn = library.draw(np.random.default_rng(0), 6000)
    assert drawn.shape == (6000, 2, 3)
    assert drawn.dtype == bool
    numbers = (drawn.reshape(6000, 6) << np.arange(6)).sum(axis=1)
    counts = np.bincount(numbers, minlength=12)
    assert len(counts) == 12
    assert chisquare(counts).pvalue > 0.01
    np.testing.assert_array_equal(drawn, library.draw(np.random.default_rng(0), 6000))
    assert (drawn != library.draw(np.random.default_rng(1), 6000)).any()


def test_a_library_survives_a_round_trip(library, tmp_path):
    write_mapped(tmp_path / "a.npz", mask_arrays(library))
    again = read_artifact_masks(tmp_path / "a.npz")
    assert again.origin == str(tmp_path / "a.npz")
    for field in dataclasses.fields(MaskLibrary):
        if field.name != "origin":
            expected = getattr(library, field.name)
            np.testing.assert_array_equal(getattr(again, field.name), expected)


def test_the_same_library_is_the_same_bytes(stage, library, tmp_path):
    write_mapped(tmp_path / "a.npz", mask_arrays(library))
    again = make_artifact_masks(stage.scene, stage.maps, POSES, lambda: None)
    write_mapped(tmp_path / "b.npz", mask_arrays(again))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_parts_are_joined_in_the_order_given():
    parts = [counting(3, 2, 3), counting(5, 2, 3)]
    joined = join_artifact_masks(parts)
    assert joined.frame.tolist() == [0, 1, 2, 0, 1, 2, 3, 4]
    np.testing.assert_array_equal(joined.masks(np.array([7])), parts[1].masks(np.array([4])))


def test_what_cannot_be_a_library_is_one_sentence(tmp_path):
    sentence = r"holds no masks; name training scenes under partitions\.train of a data set$"
    with pytest.raises(GeoEvsError, match=f"^the mask library {sentence}"):
        join_artifact_masks([])
    path = tmp_path / "none.npz"
    empty = {name: np.zeros(0) for name in ("yaw", "lateral", "support")}
    empty |= {"scene": np.zeros(0, "U1"), "frame": np.zeros(0, int)}
    arrays = empty | {"size": np.array([2, 3]), "masks": np.zeros((0, 1), np.uint8)}
    write_mapped(path, {f"masks/{name}": array for name, array in arrays.items()})
    with pytest.raises(GeoEvsError, match=f"^{path} {sentence}"):
        read_artifact_masks(path)
    write_mapped(path, {"masks/size": np.array([2, 3])})
    with pytest.raises(GeoEvsError, match=r"none.npz has no array 'masks'"):
        read_artifact_masks(path)
    with pytest.raises(GeoEvsError, match=r"^the masks of b are 3 x 2 but those of a are 2 x 3; "):
        join_artifact_masks([counting(3, 2, 3, "a"), counting(3, 3, 2, "b")])
