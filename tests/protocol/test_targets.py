import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import write_tiny_scene
from geoevs.protocol.targets import (
    FRONT_SIDE,
    make_targets,
    read_targets,
    source_cameras,
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
