import dataclasses
import shutil

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_arrays, write_arrays
from geoevs.methods.contract import Views
from geoevs.methods.tiny import tiny_camera, tiny_truth, write_tiny_scene
from geoevs.protocol.condition_masks import (
    ConditionMask,
    ConditionMasks,
    RawReprojection,
    make_condition_masks,
)
from geoevs.protocol.records import write_records
from geoevs.protocol.reference import (
    References,
    make_references,
    sparse_reference,
    write_references,
)
from geoevs.protocol.targets import Target, make_targets
from geoevs.scenes.scene import PointCloud
from geoevs.scenes.store import Scene

PROTOCOL = {
    "lateral": [-1.0, 1.0],
    "pose_sweep": {"angles": [10.0], "every": 1},
    "masked": {"yaw": [20.0], "lateral": [2.0], "every": 2},
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("tiny") / "scene")


def cloud(xyz, colours, camera):
    points = PointCloud.uncoloured(np.array(xyz), np.zeros(len(xyz)), np.zeros(len(xyz)))
    return PointCloud(
        points.xyz,
        np.array(colours, np.float32),
        np.array(camera, np.int8),
        points.sensor,
        points.beam,
    )


def target_at(camera):
    return Target("extrapolation", 0, camera, "all-cameras", 0.0, 0.0)


def reference_of(points, camera, seed=0):
    reprojected = np.zeros((camera.height, camera.width), bool)
    rng = np.random.default_rng(seed)
    return sparse_reference(points, target_at(camera), reprojected, rng)


def test_the_nearest_point_gives_the_colour():
    camera = tiny_camera("target", 0.0, np.zeros(3))
    points = cloud([[9, 0, 0], [4, 0, 0]], [[1, 0, 0], [0, 1, 0]], [0, 0])
    reference = reference_of(points, camera)
    assert reference.mask().sum() == 1
    row, column = np.argwhere(reference.mask())[0]
    assert (row, column) == (24, 36)  # the principal point of 48 x 72
    np.testing.assert_array_equal(reference.image()[row, column], [0, 1, 0])


def test_a_point_without_colour_hides_but_never_scores():
    camera = tiny_camera("target", 0.0, np.zeros(3))
    points = cloud([[9, 0, 0], [4, 0, 0]], [[1, 0, 0], [0, 0, 0]], [0, -1])
    assert not reference_of(points, camera).mask().any()


def test_permuting_the_points_changes_nothing(scene):
    camera = make_targets(scene, PROTOCOL, seed=0)[5].camera
    points = scene.points(0)
    order = np.random.default_rng(0).permutation(len(points))
    before, after = (reference_of(cloud, camera) for cloud in (points, points.select(order)))
    np.testing.assert_array_equal(before.image(), after.image())
    np.testing.assert_array_equal(before.mask(), after.mask())


def test_thinned_masks_are_nested_and_of_the_asked_size(scene):
    camera = scene.camera("front", 0)
    reference = reference_of(scene.points(0), camera)
    half, fifth = reference.mask(0.5), reference.mask(0.2)
    assert not (fifth & ~half).any()
    assert half.sum() == pytest.approx(0.5 * reference.mask().sum(), abs=1)
    assert not (reference.footprint_mask() & ~reference.mask()).any()


def test_scoring_points_never_condition(scene):
    points = scene.points(0)
    given = Views(scene, scene.cameras, needs=("lidar",)).lidar(0)
    scoring = points.select(scene.info.rig.scores(points))
    assert len(given) + len(scoring) == len(points)
    assert not set(map(tuple, given.xyz)) & set(map(tuple, scoring.xyz))


def test_the_reference_agrees_with_truth(scene):
    targets = make_targets(scene, PROTOCOL, seed=0)
    references = make_references(scene, targets, RawReprojection(scene), seed=0)
    assert set(references) == {
        target.key for target in targets if target.split in ("extrapolation", "pose-sweep")
    }
    for target in targets:
        if target.split != "extrapolation":
            continue
        reference = references[target.key]
        truth = tiny_truth(target.camera).rgb / 255.0
        error = np.abs(reference.image() - truth)[reference.mask()]
        assert np.median(error) < 0.01


def test_another_target_leaves_the_thinning_of_this_one_alone(scene):
    targets = make_targets(scene, PROTOCOL, seed=0)
    (some, *_) = [target for target in targets if target.split == "pose-sweep"]
    reprojection = RawReprojection(scene)
    alone = make_references(scene, [some], reprojection, seed=0)[some.key]
    together = make_references(scene, targets, RawReprojection(scene), seed=0)[some.key]
    np.testing.assert_array_equal(alone.mask(0.5), together.mask(0.5))
    assert not np.array_equal(
        alone.mask(0.5), make_references(scene, [some], reprojection, seed=1)[some.key].mask(0.5)
    )


def test_references_survive_a_round_trip(scene, tmp_path):
    targets = make_targets(scene, PROTOCOL, seed=0)
    references = make_references(scene, targets, RawReprojection(scene), seed=0)
    write_records(tmp_path / "references.npz", references)
    read = References(tmp_path / "references.npz")
    for key, reference in references.items():
        np.testing.assert_array_equal(read[key].image(), reference.image())
        np.testing.assert_array_equal(read[key].reprojected, reference.reprojected)


def test_references_and_masks_are_written_together(scene, tmp_path):
    targets = make_targets(scene, PROTOCOL, seed=0)
    write_references(tmp_path / "r.npz", tmp_path / "m.npz", scene, targets, seed=5)
    reprojection = RawReprojection(scene)
    references, masks = References(tmp_path / "r.npz"), ConditionMasks(tmp_path / "m.npz")
    for key, reference in make_references(scene, targets, reprojection, seed=5).items():
        np.testing.assert_array_equal(references[key].mask(0.5), reference.mask(0.5))
    masked = make_condition_masks(targets, reprojection)
    assert set(masked) == {target.key for target in targets if target.masked}
    for key, mask in masked.items():
        np.testing.assert_array_equal(masks[key].keep, mask.keep)


def test_a_truncated_file_is_named(tmp_path):
    path = tmp_path / "references.npz"
    path.write_bytes(b"PK\x03\x04 not a whole archive")
    with pytest.raises(GeoEvsError, match=r"references.npz is not whole"):
        References(path)["any"]


@pytest.mark.parametrize(
    ("field", "change", "sentence"),
    [
        ("pixels", lambda a: a.astype(float), "'pixels' is float64"),
        ("pixels", lambda a: a[::-1], "out of range"),
        ("pixels", lambda a: a + 10**6, "out of range"),
        ("rgb", lambda a: a * np.nan, "'rgb' is float32"),
        ("rgb", lambda a: a * 255, "out of range"),
        ("footprint", lambda a: a[:-1], "'footprint' is bool of shape"),
        ("rank", lambda a: a - 1, "out of range"),
        ("reprojected", lambda a: a.ravel(), "'reprojected' is bool of shape"),
    ],
)
def test_a_reference_that_cannot_be_is_refused_where_it_is_read(
    scene, tmp_path, field, change, sentence
):
    reference = reference_of(scene.points(0), scene.camera("front", 0))
    path = tmp_path / "references.npz"
    write_records(path, {"a": reference})
    assert (References(path)["a"].pixels == reference.pixels).all()
    broken = dataclasses.replace(reference, **{field: change(getattr(reference, field))})
    write_records(path, {"a": broken})
    with pytest.raises(GeoEvsError, match=f"references.npz is not whole .*{sentence}"):
        References(path)["a"]


@pytest.mark.parametrize(
    ("keep", "reprojected"),
    [
        (np.ones(4), np.ones((2, 2), bool)),
        (np.ones((2, 2), bool), np.ones((2, 3), bool)),
        (np.ones((2, 2)), np.ones((2, 2), bool)),
    ],
)
def test_a_mask_that_cannot_be_is_refused_where_it_is_read(tmp_path, keep, reprojected):
    write_records(tmp_path / "masks.npz", {"a": ConditionMask(keep, reprojected)})
    with pytest.raises(GeoEvsError, match=r"masks.npz is not whole \(its array"):
        ConditionMasks(tmp_path / "masks.npz")["a"]


def test_a_lidar_that_cannot_score_leaves_neither_file(scene, tmp_path):
    folder = tmp_path / "scene"
    shutil.copytree(scene.folder, folder)
    path = folder / "lidar/000001.npz"
    arrays = read_arrays(path)
    write_arrays(path, arrays | {"beam": 2 * (arrays["beam"] // 2)})
    targets = make_targets(scene, PROTOCOL, seed=0)
    out = tmp_path / "out"
    with pytest.raises(GeoEvsError, match=r"frame 1: no LiDAR point is of odd beams"):
        write_references(out / "r.npz", out / "m.npz", Scene(folder), targets, 0)
    assert not out.exists()
