"""What only some sources know: it comes back from the store, and what cannot be is refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import HEIGHT, WIDTH, write_tiny_scene
from geoevs.scenes.extras import MAP, SYNCED, ZONES, read_map
from geoevs.scenes.road_map import ARRAYS, Polygon, RoadMap, map_arrays
from geoevs.scenes.scene import NO_EXTRAS, Exposure, Frame, SceneExtras
from geoevs.scenes.store import Scene, write_scene

BONNET = np.zeros((HEIGHT, WIDTH), bool)
BONNET[40:] = True


def tracks_of(camera: str) -> pd.DataFrame:
    box = {"frame": 0, "track": "a", "label": "car", "x": 7.5, "y": 2.0, "z": 0.7}
    size = {"length": 2.0, "width": 2.0, "height": 1.4, "yaw": 3.0, "moving": True}
    return pd.DataFrame([{**box, **size, "camera": camera}])


TRIANGLE = np.array([[1.0, 2, 0], [3, 2, 0], [3, 4, 0.25]])
ROAD_MAP = RoadMap([Polygon("crossing", [TRIANGLE]), Polygon("drivable", [2 * TRIANGLE, TRIANGLE])])
EXTRAS = SceneExtras(
    ego_masks={"front": BONNET},
    road_map=ROAD_MAP,
    no_label_zones={1: [np.array([[0.0, 0], [9, 0], [9, 9]])]},
    synced_tracks=tracks_of("left"),
)


def test_a_store_gives_back_what_its_source_knew(tmp_path):
    scene = write_tiny_scene(tmp_path / "s", extras=EXTRAS)
    assert list(scene.ego_masks) == ["front"]
    np.testing.assert_array_equal(scene.ego_masks["front"], BONNET)
    for found, given in zip(scene.road_map.polygons, ROAD_MAP.polygons, strict=True):
        assert found.surface == given.surface
        for ring, drawn in zip(found.rings, given.rings, strict=True):
            np.testing.assert_array_equal(ring, drawn)
    assert list(scene.no_label_zones) == [1]
    np.testing.assert_array_equal(scene.no_label_zones[1][0], EXTRAS.no_label_zones[1][0])
    pd.testing.assert_frame_equal(scene.synced_tracks, EXTRAS.synced_tracks)
    stamp = scene.stamp
    (scene.folder / MAP).unlink()
    assert Scene(scene.folder).stamp != stamp
    some = scene.extras(("front",))
    assert list(some.ego_masks) == ["front"]
    assert some.road_map is scene.road_map
    assert some.synced_tracks.empty


def test_a_store_without_them_has_no_files_of_them(tmp_path):
    scene = write_tiny_scene(tmp_path / "s", extras=NO_EXTRAS)
    assert scene.extras(scene.cameras).synced_tracks is None
    assert (scene.ego_masks, scene.road_map, scene.no_label_zones) == ({}, None, {})
    assert {path.name for path in scene.folder.iterdir()} >= {"scene.json", "tracks.parquet"}
    assert not {"ego", MAP, ZONES, SYNCED} & {path.name for path in scene.folder.iterdir()}


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"ego_masks": {"rear": BONNET}}, "names camera 'rear'; one of"),
        ({"ego_masks": {"front": BONNET[1:]}}, r"camera 'front' is bool of shape \(47, 72\)"),
        ({"ego_masks": {"front": BONNET.astype(int)}}, "camera 'front' is int64"),
        ({"ego_masks": {"front": BONNET | True}}, "sees nothing but the ego car"),
        ({"road_map": RoadMap([])}, "the road map has no polygon"),
        ({"road_map": RoadMap([Polygon("markings", [TRIANGLE])])}, "did you mean 'marking'"),
        (
            {"road_map": RoadMap([Polygon("marking", [TRIANGLE[:2]])])},
            "a ring without three corners",
        ),
        (
            {"road_map": RoadMap([Polygon("marking", [TRIANGLE[:, :2]])])},
            "a ring without three corners",
        ),
        ({"road_map": RoadMap([Polygon("marking", [TRIANGLE * 1e4])])}, "beyond 10 km"),
        ({"road_map": RoadMap([Polygon("marking", [TRIANGLE * np.nan])])}, "NaN"),
        ({"no_label_zones": {0: [np.array([[0.0, np.nan]])]}}, "NaN or infinite"),
        ({"no_label_zones": {-1: [np.ones((3, 2))]}}, "frame -1 is no whole number"),
        ({"synced_tracks": tracks_of("rear")}, "a box names camera 'rear'"),
        ({"synced_tracks": tracks_of("left").assign(length=-1.0)}, "'length' of 1 boxes"),
    ],
)
def test_what_cannot_be_is_not_written(tmp_path, changed, sentence):
    with pytest.raises(GeoEvsError, match=sentence):
        write_tiny_scene(tmp_path / "s", extras=replace(EXTRAS, **changed))
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("file", "content", "sentence"),
    [
        (MAP, "nothing", "map.npz"),
        (ZONES, '{"1": [["a"]]}', "no lists of numbers"),
        (ZONES, '{"1": [[["a", 2]]]}', "no finite number"),
        (ZONES, "[]", "lists no zones"),
        (ZONES, '{"x": []}', "no frame's"),
        (ZONES, '{"1": [[]]}', "several lengths"),
        (ZONES, '{"12345678": []}', "no whole number"),
        (SYNCED, "nothing", SYNCED),
        ("ego/front.png", "nothing", "front.png"),
    ],
)
def test_a_damaged_file_is_one_sentence(tmp_path, file, content, sentence):
    scene = write_tiny_scene(tmp_path / "s", extras=EXTRAS)
    (scene.folder / file).write_text(content, encoding="utf-8")
    scene = Scene(scene.folder)
    with pytest.raises(GeoEvsError, match=re.escape(str(scene.folder / file))) as error:
        scene.extras(scene.cameras)
    assert sentence in str(error.value)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        *(({name: None}, f"no '{name}' of a road map") for name, *_ in ARRAYS),
        ({"corners": np.ones((9, 2))}, "no 'corners'"),
        ({"corners": np.ones((9, 3), np.float32)}, "no 'corners'"),
        ({"lengths": np.int64(9)}, "no 'lengths'"),
        ({"lengths": np.array([3, 3, 4])}, "'lengths' do not add up to the 9"),
        ({"lengths": np.array([12, 3, -6])}, "'lengths' do not add up"),
        ({"lengths": np.array([2**62, 2**62, 2**62])}, "'lengths' do not add up"),
        ({"lengths": np.array([3, 2, 4])}, "polygon 1 of the road map has a ring without three"),
        ({"rings": np.array([2, 2])}, "'rings' do not add up to the 3"),
        ({"rings": np.array([1, 1, 1])}, "of no known surface"),
        ({"surfaces": np.array([1, 4], np.uint8)}, "of no known surface"),
        ({"corners": np.full((9, 3), np.inf)}, "NaN or beyond 10 km"),
        ({name: np.zeros((0, *shape), kind) for name, kind, shape in ARRAYS}, "has no polygon"),
    ],
)
def test_a_map_that_cannot_be_is_not_read(tmp_path, changed, sentence):
    arrays = {k: v for k, v in (map_arrays(ROAD_MAP) | changed).items() if v is not None}
    np.savez(tmp_path / MAP, **arrays)
    with pytest.raises(GeoEvsError, match=re.escape(str(tmp_path / MAP))) as error:
        read_map(tmp_path)
    assert sentence in str(error.value)


def test_exposures_come_back_and_must_be_in_order(tmp_path):
    tiny = write_tiny_scene(tmp_path / "tiny")
    when = {"front": Exposure(0.02, 0.0, 0.04)}
    cameras = {name: tiny.camera(name, 0) for name in tiny.cameras}
    images = {name: tiny.image(name, 0) for name in tiny.cameras}
    frame = Frame(0, 0.0, cameras, images, tiny.points(0), exposures=when)
    write_scene(tmp_path / "s", tiny.info, tiny.tracks, iter([frame]))
    scene = Scene(tmp_path / "s")
    assert scene.exposure("front", 0) == when["front"]
    assert scene.exposure("left", 0) is None
    path = tmp_path / "s/transforms.json"
    text = path.read_text(encoding="utf-8")
    for exposure, sentence in ([0.05, 0.0, 0.04], "does not lie"), ([0.0], "no list of time"):
        described = json.loads(text)
        described["frames"][0]["exposure"] = exposure
        path.write_text(json.dumps(described), encoding="utf-8")
        with pytest.raises(GeoEvsError, match=f"camera 'front' in frame 0.*{sentence}"):
            Scene(tmp_path / "s")
