import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json
from geoevs.methods.tiny import write_tiny_scene
from geoevs.protocol.provenance import target_settings
from geoevs.protocol.targets import (
    FRONT_SIDE,
    make_targets,
    read_targets,
    source_cameras,
    without_usual,
    write_targets,
)
from geoevs.scenes.camera import angle_between

PROTOCOL = {
    "lateral": [-1.0, 1.0],
    "pose_sweep": {"angles": [0.0, 10.0], "every": 2},
    "masked": {"yaw": [15.0, 20.0], "lateral": [-2.0, 2.0], "every": 2},
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("tiny") / "scene")


def test_every_split_of_a_scene(scene):
    targets = make_targets(scene, PROTOCOL, seed=0)
    count = {split: sum(t.split == split for t in targets) for split in {t.split for t in targets}}
    # Two frames, three cameras; 2 sides x 2 shifts; 2 angles x 2 sides x 2 shifts in every 2nd;
    # masks on three cameras and 2 sides x 2 shifts of every 2nd.
    plain = {"observed": 6, "interpolation": 2, "extrapolation": 8, "pose-sweep": 8}
    assert count == {**plain, "masked-observed": 3, "masked-extrapolation": 4}
    assert len({target.key for target in targets}) == len(targets)
    for target in targets:
        front = scene.camera("front", target.frame)
        offset = angle_between(target.camera.optical_axis, front.optical_axis)
        assert target.pose_offset == pytest.approx(offset)
        if target.split == "extrapolation":
            assert target.pose_offset == pytest.approx(22.5)
            assert abs(target.lateral_shift) == 1.0


def described(target):
    mask = target.mask_camera.name if target.masked else ""
    return target.key, target.split, target.camera.world_from_camera.tolist(), mask


@pytest.mark.parametrize("split", ["observed", "extrapolation"])
def test_a_split_may_leave_out_frames(scene, split):
    whole = make_targets(scene, PROTOCOL, seed=0)
    thinned = make_targets(scene, {**PROTOCOL, "every": {split: 2}}, seed=0)
    # Frame 1 has none of the split; what is left is what it was, masks included.
    left = [target for target in whole if (target.split, target.frame) != (split, 1)]
    assert list(map(described, thinned)) == list(map(described, left))
    assert {target.frame for target in thinned if target.split == split} == {0}


def test_masked_targets_are_of_targets_that_there_are(scene):
    masked = {**PROTOCOL["masked"], "every": 1}
    protocol = {**PROTOCOL, "masked": masked, "every": {"observed": 1, "extrapolation": 2}}
    targets = make_targets(scene, protocol, seed=0)
    keys = {target.key for target in targets}
    assert all(target.unmasked.key in keys for target in targets)
    assert {t.frame for t in targets if t.split == "masked-extrapolation"} == {0}
    assert {t.frame for t in targets if t.split == "masked-observed"} == {0, 1}


def test_leaving_out_no_frame_is_the_same_protocol():
    once = {"observed": 1, "extrapolation": 1}
    assert without_usual({**PROTOCOL, "every": once}) == without_usual(PROTOCOL) == PROTOCOL
    assert without_usual({**PROTOCOL, "every": {"observed": 2}})["every"] == {"observed": 2}
    assert target_settings({**PROTOCOL, "every": once}, 0) == target_settings(PROTOCOL, 0)
    thinned = target_settings({**PROTOCOL, "every": {"observed": 2}}, 0)
    assert thinned != target_settings(PROTOCOL, 0)


@pytest.mark.parametrize(
    "change",
    [
        {"lateral": [1.0, 1.0000001]},
        {"lateral": [-1.0, 1.0, 1.0]},
        {"pose_sweep": {"angles": [10.0, 10.00000001], "every": 1}},
        {"masked": {"yaw": [15.0, 15.0], "lateral": [2.0], "every": 1}},
    ],
)
def test_shifts_and_angles_whose_names_collide_are_refused(scene, change):
    with pytest.raises(GeoEvsError, match=r"scene 'tiny' has \d targets or masks called '"):
        make_targets(scene, {**PROTOCOL, **change}, seed=0)


def test_interpolation_never_shows_the_front_camera(scene):
    assert source_cameras(scene, FRONT_SIDE) == ("left", "right")
    (target, *_) = [t for t in make_targets(scene, PROTOCOL, seed=0) if t.split == "interpolation"]
    assert target.sources == FRONT_SIDE
    front = scene.camera("front", target.frame)
    np.testing.assert_array_equal(target.camera.world_from_camera, front.world_from_camera)


def test_a_misspelt_set_of_sources_shows_no_camera(scene):
    with pytest.raises(GeoEvsError, match=r"no set of sources 'frontside'; did you mean 'front-si"):
        source_cameras(scene, "frontside")


def test_targets_survive_a_round_trip(scene, tmp_path):
    targets = make_targets(scene, PROTOCOL, seed=0)
    write_targets(tmp_path / "targets.json", targets)
    for target, again in zip(targets, read_targets(tmp_path / "targets.json"), strict=True):
        assert again.key == target.key
        assert (again.split, again.sources) == (target.split, target.sources)
        np.testing.assert_array_equal(again.camera.K, target.camera.K)
        pose = target.camera.world_from_camera
        np.testing.assert_array_equal(again.camera.world_from_camera, pose)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda t: t.update(name="../../x"), "target '../../x' is not an allowed name"),
        (lambda t: t.update(name="/tmp/x"), "target '/tmp/x' is not an allowed name"),
        (lambda t: t.update(name=None), "target 'None' is not an allowed name"),
        (lambda t: t.update(frame=-1), "frame -1 is no whole number"),
        (lambda t: t.update(frame="0"), "frame '0' is no whole number"),
        (lambda t: t.update(split="observd"), "no split 'observd'; did you mean 'observed'?"),
        (lambda t: t.update(split=["observed"]), "no split '['observed']'"),
        (lambda t: t.update(sources="all"), "there is no sources 'all'; one of: all-cameras"),
        (lambda t: t.update(pose_offset=180.1), "a pose_offset is 180.1, not from 0 to 180"),
        (lambda t: t.update(lateral_shift=-5e6), "a lateral_shift is -5e+06, not from -1000 to"),
        (lambda t: t.update(pose_offset=float("nan")), "a pose_offset is nan, no finite"),
        (lambda t: t.update(lateral_shift="1"), "a lateral_shift is '1', no finite"),
        (lambda t: t.pop("mask_camera"), "is no target list (one lacks 'mask_camera')"),
        (lambda t: t.update(mask_camera={}), "must have a mask_camera if its split begins with"),
        (lambda t: t.update(w=10**7), "side of 10000000 pixels"),
        (lambda t: t.update(k1=0.1), "the lens distortion k1 = 0.1"),
    ],
)
def test_a_target_that_cannot_be_is_refused(scene, tmp_path, change, sentence):
    path = tmp_path / "targets.json"
    write_targets(path, make_targets(scene, PROTOCOL, seed=0))
    entries = read_json(path)
    change(next(entry for entry in entries if entry["split"] == "observed"))
    write_json(path, entries)
    with pytest.raises(GeoEvsError) as caught:
        read_targets(path)
    assert str(path) in str(caught.value)
    assert sentence in str(caught.value)


def test_mask_cameras_and_repeated_targets_are_checked_too(scene, tmp_path):
    path = tmp_path / "targets.json"
    write_targets(path, make_targets(scene, PROTOCOL, seed=0))
    entries = read_json(path)
    masked = next(entry for entry in entries if entry["mask_camera"])
    for change, sentence in (
        ({"mask_camera": None}, "must have a mask_camera"),
        ({"mask_camera": masked["mask_camera"] | {"name": "a/b"}}, "mask camera 'a/b' is not an"),
        ({"mask_camera": masked["mask_camera"] | {"cx": -1.0}}, "outside its image"),
        ({"mask_camera": {"w": 1}}, "one lacks 'name'"),
    ):
        write_json(path, [masked | change])
        with pytest.raises(GeoEvsError, match=sentence):
            read_targets(path)
    write_json(path, [masked, masked])
    with pytest.raises(GeoEvsError, match="has 2 targets or masks called 'masked-"):
        read_targets(path)
