"""Stressed stores: as hard as asked, pure functions of seed and level, the rest untouched."""

import filecmp

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.projection import zbuffer
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.stressors import STRESSORS, write_stressed
from geoevs.scenes.camera import angle_between
from geoevs.scenes.store import Scene

HARD = {
    "support": 0.02,
    "beams": 0.5,
    "rotation": 1.0,
    "translation": 0.1,
    "cameras": 1,
    "exposure": 2.0,
}


@pytest.fixture
def stressed(stage, tmp_path):
    def make(stressor, level, seed=0, name="stressed"):
        write_stressed(tmp_path / name, stage.store, stressor, level, seed)
        return Scene(tmp_path / name)

    return make


def conditioning(scene, frame):
    points = scene.points(frame)
    return points.select(~scene.info.rig.scores(points))


def support(scene):
    return np.mean(
        [
            zbuffer(conditioning(scene, frame).xyz, scene.camera(name, frame)).mask.mean()
            for frame in scene.frames
            for name in scene.cameras
        ]
    )


def linear(image):
    return np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)


def test_stressors_have_what_their_kind_needs():
    stores = [name for name, stressor in STRESSORS.items() if stressor.kind == "store"]
    assert stores == list(HARD)
    for stressor in STRESSORS.values():
        assert stressor.kind in ("store", "world", "targets", "pixels")
        assert (stressor.change is not None) == (stressor.kind == "store")
        assert (stressor.option != "") == (stressor.kind == "world")
        assert set(stressor.metrics) <= set(METRICS)


def test_levels_get_harder():
    for stressor in STRESSORS.values():
        assert list(stressor.levels) == sorted(set(stressor.levels), reverse=stressor.falling)


@pytest.mark.parametrize("stressor", HARD)
def test_a_seed_decides_everything(stressed, stressor):
    stores = [
        stressed(stressor, HARD[stressor], seed, name)
        for seed, name in ((3, "one"), (3, "same"), (4, "other"))
    ]
    files = [
        str(path.relative_to(stores[0].folder))
        for path in stores[0].folder.rglob("*")
        if path.is_file()
    ]
    one, same, other = (store.folder for store in stores)
    assert filecmp.cmpfiles(one, same, files, shallow=False) == (files, [], [])
    assert filecmp.cmpfiles(one, other, files, shallow=False)[0] != files


@pytest.mark.parametrize("level", [0.05, 0.02, 0.005])
def test_support_is_thinned_to_the_level(stressed, level):
    assert support(stressed("support", level)) == pytest.approx(level, rel=0.03)


def test_a_lower_support_is_a_part_of_a_higher_one(stressed):
    more, less = stressed("support", 0.05, name="more"), stressed("support", 0.01, name="less")
    kept = set(map(tuple, more.points(0).xyz.tolist()))
    assert set(map(tuple, less.points(0).xyz.tolist())) < kept


def test_lost_beams_are_those_that_condition(stage, stressed):
    clean, store = stage.store, stressed("beams", 0.5)
    before = {*conditioning(clean, 0).beam.tolist()}
    after = {*conditioning(store, 0).beam.tolist()}
    assert after < before
    assert len(after) == round(len(before) / 2)
    points, stay = clean.points(0), store.points(0)
    scores = clean.info.rig.scores
    assert scores(stay).sum() == scores(points).sum()


@pytest.mark.parametrize("level", [0.1, 2.0])
def test_cameras_are_turned_by_the_level(stage, stressed, level):
    store = stressed("rotation", level)
    for name in store.cameras:
        true, believed = stage.store.camera(name, 1), store.camera(name, 1)
        between = true.world_from_camera[:3, :3].T @ believed.world_from_camera[:3, :3]
        turned = np.degrees(np.arccos((np.trace(between) - 1) / 2))
        assert turned == pytest.approx(level, rel=1e-4)
        assert np.array_equal(true.centre, believed.centre)
        assert angle_between(true.optical_axis, believed.optical_axis) <= level + 1e-6


def test_errors_keep_their_direction_and_differ_by_camera(stage, stressed):
    ways = []
    for level, name in ((0.2, "far"), (0.05, "near")):
        store = stressed("translation", level, name=name)
        moved = [store.camera(c, 0).centre - stage.store.camera(c, 0).centre for c in store.cameras]
        assert np.linalg.norm(moved, axis=1) == pytest.approx([level] * 3)
        ways.append(np.array(moved) / level)
    np.testing.assert_allclose(*ways, atol=1e-9)
    assert not np.allclose(ways[0][0], ways[0][1])


def test_lost_cameras_leave_the_front_one(stressed):
    store = stressed("cameras", 2)
    assert store.cameras == ("front",)
    assert set(store.points(0).camera.tolist()) == {-1, 0}


def test_exposures_are_spread_over_the_stops(stage, stressed):
    store = stressed("exposure", 1.0)
    stops = []
    for name in store.cameras:
        before, after = linear(stage.store.image(name, 0)), linear(store.image(name, 0))
        stops.append(np.median(np.log2(after / before)))
    assert sorted(stops) == pytest.approx([-0.5, 0.0, 0.5], abs=0.02)


def test_points_are_coloured_by_what_is_left(stage, stressed):
    brightest = stressed("exposure", 2.0)
    changed = brightest.points(0).rgb - stage.store.points(0).rgb
    assert np.abs(changed).max() > 0.1


@pytest.mark.parametrize(
    ("stressor", "level", "sentence"),
    [
        ("suport", 0.1, "did you mean 'support'"),
        ("motion", 5, "'motion' changes no scene store"),
        ("support", 0.9, "its LiDAR fills"),
        ("beams", 1.0, "leaves none"),
        ("cameras", 3, "2 cameras beside the front one"),
        ("cameras", 1.5, "a whole number"),
    ],
)
def test_what_cannot_be_is_one_sentence(stage, tmp_path, stressor, level, sentence):
    with pytest.raises(GeoEvsError, match=sentence):
        write_stressed(tmp_path / "none", stage.store, stressor, level, 0)
    assert not (tmp_path / "none").exists()
